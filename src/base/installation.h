// Where the program's own parts stand: beside it in a build tree, below the same prefix when installed. Both
// are found from the executable's place alone, so that a prefix can be moved, and no variable need be set.
#pragma once

#include <filesystem>
#include <string>

namespace mirage {

/// A part of the program that the build makes, e.g. "plugins/fusion.so": in the executable's folder (a build
/// tree), else in lib/mirage beside the executable's folder (an installed prefix). Where it should be in the
/// former if it is in neither.
std::filesystem::path built_file(const std::string& relative);

}  // namespace mirage
