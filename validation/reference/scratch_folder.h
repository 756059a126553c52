// What the studies work with below their output folder, and remove at the end.
#pragma once

namespace mirage {

/// A folder below --out. It goes with its contents: its name is one that no user gives a folder.
inline constexpr const char* kScratchFolder = ".mirage-scratch";

}  // namespace mirage
