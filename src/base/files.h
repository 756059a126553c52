// Files: whole-file reading and atomic writing (write beside, fsync, rename, fsync of the folder), so that a
// killed or failing run, or a machine that loses its power, leaves either the old file or the new one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "base/error.h"

namespace mirage {

/// Bytes of the largest JSON that holds some dozens of fields: its values take thirty times that.
inline constexpr std::uintmax_t kLargestRecord = std::uintmax_t{1} << 19;
/// Bytes of the largest file that is read whole where its reader knows of no smaller bound.
inline constexpr std::uintmax_t kLargestFile = std::uintmax_t{1} << 30;
/// The whole file. InputError if it can't be read, or holds more than `most` bytes: it says so before any of
/// them is in memory.
std::string read_file(const std::filesystem::path& path, std::uintmax_t most = kLargestFile);
/// Bytes of the mark (U+FEFF) that some editors put before a text: 3, or 0 without one. InputError naming the
/// file `where` for the marks of UTF-16 and UTF-32, whose letters are no bytes.
std::size_t byte_order_mark(std::string_view head, const std::string& where);
/// read_file of a text in UTF-8, without the byte order mark that it may begin with. InputError for UTF-16.
std::string read_text(const std::filesystem::path& path, std::uintmax_t most = kLargestFile);
/// Writes atomically; makes the parent folder. Failure on a full disk or a read-only folder.
void write_file(const std::filesystem::path& path, std::string_view bytes);
/// 64-bit FNV-1a of the bytes, 16 hexadecimal digits: tells whether content changed, nothing more.
std::string content_hash(std::string_view bytes);
/// Bytes of the largest file of which only a hash is asked: a network of somebody else's, say.
inline constexpr std::uintmax_t kLargestHashed = std::uintmax_t{1} << 34;
/// content_hash of a file's bytes, of which few are in memory at a time. InputError as read_file; Interrupted
/// if a signal comes during a large one.
std::string file_hash(const std::filesystem::path& path, std::uintmax_t most = kLargestHashed);
/// Ends the name of a temporary file, before its process's number and ".tmp" (files.h cleans up).
inline constexpr std::string_view kTemporaryMark = ".mirage-";
/// NAME.mirage-PID.tmp in the same folder: what becomes `path` once it is whole.
std::filesystem::path temporary_beside(const std::filesystem::path& path);
/// How to mend what a system call failed with (errno): a full disk, permissions, a name too long, …
std::string fix_for(int error);
/// Moves a finished temporary file to its place (same folder). Failure if it can't.
void replace_file(const std::filesystem::path& temporary, const std::filesystem::path& path);
/// Makes the folder (and parents). Failure, naming the folder, if it can't be made or written to.
void make_output_folder(const std::filesystem::path& folder);

/// Bytes of the largest JSON that is read whole; for larger ones there is for_each_json_row.
inline constexpr std::uintmax_t kLargestJson = std::uintmax_t{1} << 26;
/// InputError naming file and byte when it is not JSON, or holds more than `most_values` (json_depth.h); and
/// as read_file.
nlohmann::json read_json(const std::filesystem::path& path, std::uintmax_t most = kLargestJson,
                         std::size_t most_values = kLargestJson);
/// Of a file `where` that has been read. Without what `keep` refuses, if it is given. InputError as
/// read_json's.
nlohmann::json parse_json(std::string_view text, const std::string& where,
                          const nlohmann::json::parser_callback_t& keep = nullptr);
/// Two-space indent, atomic.
void write_json(const std::filesystem::path& path, const nlohmann::json& value);

/// The folder that holds the running executable.
std::filesystem::path executable_folder();
/// A file that ships with the program, e.g. "scenes/rigs/kitti64.toml": looked for in MIRAGE_HOME, in
/// share/mirage beside the executable's folder (an installed prefix), then in the executable's folder and its
/// parents (a build tree). InputError if there is none.
std::filesystem::path shipped_file(const std::string& relative);

// One program at a time in an output folder.

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
