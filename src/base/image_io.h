// Parts of a picture's file that claim more bytes than the file has, or become a thousand times what they
// are, found before a decoder sets memory aside for them.
#pragma once

#include <OpenImageIO/filesystem.h>

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include "base/image.h"

namespace mirage {

/// What is wrong; empty if nothing is, or nothing that the decoder does not find by itself. `format`: "png",
/// "openexr", or another, of which nothing is looked at.
std::string claim_beyond_file(OIIO::Filesystem::IOProxy& file, std::string_view format);

// Image files through OpenImageIO. PNG and JPEG hold 8-bit sRGB (16-bit PNG: depth), EXR scene-linear float.

/// Pixels of the largest picture that is read, given or recorded: 8192×8192. A header of a few bytes can
/// claim 60000×60000, so every reader looks at it before it reserves anything.
inline constexpr std::uint64_t kMostPixels = 1ull << 26;

/// What a picture's header has to say; 0: any size within kMostPixels.
struct PictureSize {
  int width = 0, height = 0;
};

/// Reads an 8-bit sRGB picture (PNG, JPEG) into scene-linear RGB (H×W×3), its colours as they are stored:
/// alpha is left out. InputError naming the file if it is unreadable, no regular file, larger than
/// kMostPixels, not of the `expected` size, or turned by its EXIF orientation (calibrations are of pixels as
/// they are stored).
ImageF read_srgb(const std::filesystem::path& path, PictureSize expected = {});
/// Writes scene-linear RGB (3 channels; or 1, as grey) as 8-bit sRGB PNG, atomically.
void write_srgb(const std::filesystem::path& path, const ImageF& linear);
/// The PNG file's bytes, for embedding.
std::string encode_srgb_png(const ImageF& linear);
/// The reverse of encode_srgb_png, for any picture in memory (PNG, JPEG): scene-linear RGB. InputError with
/// `where` as the file and `field`, as read_srgb.
ImageF decode_srgb(std::string_view bytes, const std::string& where, const std::string& field,
                   PictureSize expected = {});
/// Width and height from the file's header only; at most kMostPixels.
void read_image_size(const std::filesystem::path& path, int& width, int& height);

/// Depth (m, one channel) as KITTI's depth benchmark stores it: 16-bit PNG of round(256 · depth), 0 where
/// there is none. Quantised to 1/256 m; depths beyond 255.99 m are stored as that. Written atomically.
void write_depth_png(const std::filesystem::path& path, const ImageF& depth);
/// InputError if it is not a 16-bit grey PNG.
ImageF read_depth_png(const std::filesystem::path& path);

/// Whole numbers (one channel, 0 … 65535) as 16-bit grey PNG, atomically: which object each pixel shows.
void write_index_png(const std::filesystem::path& path, const Image<std::uint16_t>& indices);
/// InputError if it is not a 16-bit grey PNG.
Image<std::uint16_t> read_index_png(const std::filesystem::path& path);

/// Reads an EXR as it is: float, all channels of the first part.
ImageF read_exr(const std::filesystem::path& path);
/// Writes float channels unchanged (32-bit), atomically.
void write_exr(const std::filesystem::path& path, const ImageF& image);

}  // namespace mirage
