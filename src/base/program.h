// Which file Mirage runs from: what ships with it is looked for beside that (base/files.h), and what it keeps
// on disk is kept under that file's content (base/disk_cache.h).
#pragma once

#include <filesystem>

namespace mirage {

/// The executable, or what set_program_file() named.
std::filesystem::path program_file();
/// For a host that is not `mirage` itself (Python): the library that Mirage's code is in.
void set_program_file(const std::filesystem::path& file);

}  // namespace mirage
