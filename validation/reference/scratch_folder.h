// What the studies work with below their output folder, and remove at the end.
#pragma once

#include <fmt/format.h>

#include <filesystem>

#include "base/ranks.h"

namespace mirage {

/// A folder below --out. It goes with its contents: its name is one that no user gives a folder.
inline constexpr const char* kScratchFolder = ".mirage-scratch";

/// This process's own below `out`, which others that work there leave alone (base/ranks.h).
inline std::filesystem::path scratch_folder(const std::filesystem::path& out) {
  std::filesystem::path folder = out / kScratchFolder;
  if (rank() > 0) folder += fmt::format("-{}", rank());
  return folder;
}

}  // namespace mirage
