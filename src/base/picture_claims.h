// Parts of a picture's file that claim more bytes than the file has, or become a thousand times what they
// are, found before a decoder sets memory aside for them.
#pragma once

#include <OpenImageIO/filesystem.h>

#include <string>
#include <string_view>

namespace mirage {

/// What is wrong; empty if nothing is, or nothing that the decoder does not find by itself. `format`: "png",
/// "openexr", or another, of which nothing is looked at.
std::string claim_beyond_file(OIIO::Filesystem::IOProxy& file, std::string_view format);

}  // namespace mirage
