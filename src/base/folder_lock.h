// One program at a time in an output folder.
#pragma once

#include <filesystem>

#include "base/error.h"

namespace mirage {

/// Levels of folders below an output folder that a command writes to.
inline constexpr int kFoldersBelow = 2;

/// Another process has the folder.
struct FolderInUse : Failure {
  using Failure::Failure;
};

/// Holds FOLDER/.mirage-lock while it lives. The kernel's lock on the file counts, not the file's existence:
/// that of a killed process is free, and is taken over. The file names its holder for the others' error.
class FolderLock {
 public:
  /// FolderInUse naming the holder's process and machine if another process has the folder. A folder that
  /// this process has already is not locked again; nor is one on a file system without locks. Temporary files
  /// that dead processes left in the folder and so many levels below are removed (remove_stale_files).
  explicit FolderLock(const std::filesystem::path& folder, int levels = kFoldersBelow);
  ~FolderLock();
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  int descriptor_ = -1;
  std::filesystem::path file_, key_;
};

/// Removes the temporary files (temporary_beside) in `folder` and so many levels below whose processes no
/// longer live on this machine. `own`: also those with this process's number, which an earlier one had (in a
/// container it often has); this one must not be writing there.
void remove_stale_files(const std::filesystem::path& folder, bool own = false, int levels = kFoldersBelow);

}  // namespace mirage
