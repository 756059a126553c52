// Files: whole-file reading and atomic writing (write beside, fsync, rename, fsync of the folder), so that a
// killed or failing run, or a machine that loses its power, leaves either the old file or the new one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "base/error.h"

namespace mirage {

// The file that Mirage runs from. Shipped files are looked for beside it, and cached results
// (base/disk_cache.h) are keyed by its content.

/// The executable, or the file that set_program_file() named.
std::filesystem::path program_file();
/// Sets program_file() for a host program other than `mirage` (Python): the library that holds Mirage's code.
void set_program_file(const std::filesystem::path& file);

/// Bytes of the largest JSON that holds some dozens of fields: its values take thirty times that.
inline constexpr std::uintmax_t kMaxRecordBytes = std::uintmax_t{1} << 19;
/// Bytes of the largest file that is read whole where its reader knows of no smaller bound.
inline constexpr std::uintmax_t kMaxFileBytes = std::uintmax_t{1} << 30;
/// The whole file. InputError if it can't be read, or holds more than `most` bytes: it says so before any of
/// them is in memory.
std::string read_file(const std::filesystem::path& path, std::uintmax_t most = kMaxFileBytes);
/// Bytes of the mark (U+FEFF) that some editors put before a text: 3, or 0 without one. InputError naming the
/// file `where` for the marks of UTF-16 and UTF-32, whose letters are not single bytes.
std::size_t byte_order_mark(std::string_view head, const std::string& where);
/// read_file of a text in UTF-8, without the byte order mark that it may begin with. InputError for UTF-16.
std::string read_text(const std::filesystem::path& path, std::uintmax_t most = kMaxFileBytes);
/// Writes atomically; makes the parent folder. Failure on a full disk or a read-only folder.
void write_file(const std::filesystem::path& path, std::string_view bytes);
/// 64-bit FNV-1a of the bytes, 16 hexadecimal digits: tells whether content changed, nothing more.
std::string content_hash(std::string_view bytes);
/// Bytes of the largest file that is only hashed, such as another author's network.
inline constexpr std::uintmax_t kMaxHashedBytes = std::uintmax_t{1} << 34;
/// content_hash of a file, which is read in parts. InputError as read_file; Interrupted if a signal comes
/// during a large one.
std::string file_hash(const std::filesystem::path& path, std::uintmax_t most = kMaxHashedBytes);
/// The fix for a failed system call, by its errno: a full disk, permissions, a name too long, …
std::string fix_for(int error);
/// Moves a finished temporary file to its place (same folder). Failure if it can't.
void replace_file(const std::filesystem::path& temporary, const std::filesystem::path& path);
/// Makes the folder (and parents). Failure, naming the folder, if it can't be made or written to.
void make_output_folder(const std::filesystem::path& folder);

/// Bytes of the largest JSON that is read whole; for larger ones there is for_each_json_row.
inline constexpr std::uintmax_t kMaxJsonBytes = std::uintmax_t{1} << 26;
/// InputError naming file and byte when it is not JSON, or holds more than `most_values`; and as read_file.
nlohmann::json read_json(const std::filesystem::path& path, std::uintmax_t most = kMaxJsonBytes,
                         std::size_t most_values = kMaxJsonBytes);
/// Parses the text of a file `where`, without values that `keep` refuses, if given. InputError as read_json.
nlohmann::json parse_json(std::string_view text, const std::string& where,
                          const nlohmann::json::parser_callback_t& keep = nullptr);
/// Writes with two-space indent, atomically.
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

/// Another process holds the folder.
struct FolderInUse : Failure {
  using Failure::Failure;
};

/// Holds FOLDER/.mirage-lock while it lives. The kernel's lock on the file counts, not the file's existence:
/// a killed process's lock is free and is taken over. The file names its holder for other processes' errors.
class FolderLock {
 public:
  /// FolderInUse naming the holder's process and machine if another process has the folder. A folder that
  /// this process already holds is not locked again; nor is a folder on a file system without locks.
  /// Temporary files of dead processes in the folder and `levels` levels below are removed
  /// (remove_stale_files).
  explicit FolderLock(const std::filesystem::path& folder, int levels = kFoldersBelow);
  ~FolderLock();
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  int descriptor_ = -1;
  std::filesystem::path file_, key_;
};

/// Removes write_file's temporary files (NAME.mirage-PID.tmp) in `folder` and `levels` levels below if their
/// processes no longer live on this machine. `own`: also files with this process's number, from an earlier
/// process with the same number (common in containers); this process must not be writing there.
void remove_stale_files(const std::filesystem::path& folder, bool own = false, int levels = kFoldersBelow);

// Bounds on a JSON text, checked before any parser reads it. Parsers recurse: a text of 20 000 "[" would
// overflow the stack. Each value takes up to eighty bytes: "[],[],[]" takes thirty times its own size.

/// Most levels of nested arrays and objects. Our files have 8, exported scenes of other programs below 30.
inline constexpr int kMaxJsonDepth = 128;

/// InputError with `where` as the file and `field` ("" for the whole file) if the text nests deeper. Says
/// nothing about whether it is JSON.
void check_json_depth(std::string_view text, const std::string& where, const std::string& field = "");
/// InputError if the text holds more than `most` values (keys, lists and objects count, too), or more lists
/// and objects than `most_lists`.
void check_json_values(std::string_view text, const std::string& where, std::size_t most,
                       std::size_t most_lists = std::numeric_limits<std::size_t>::max());

/// A regular file that is read in parts. InputError, also from the constructor, for a file that cannot be
/// read: a folder, a pipe, a device, a disk that fails.
class OpenFile {
 public:
  /// Opens the file to be read.
  explicit OpenFile(std::filesystem::path path);
  ~OpenFile();
  OpenFile(const OpenFile&) = delete;
  OpenFile& operator=(const OpenFile&) = delete;

  /// Its size in bytes by its folder entry; 0 for system files that report no size.
  std::uintmax_t size() const;
  /// InputError if `bytes` are more than `most`.
  void check(std::uintmax_t bytes, std::uintmax_t most) const;
  /// Reads up to `size` bytes; 0 at the end.
  std::size_t read(char* to, std::size_t size) const;

 private:
  [[noreturn]] void fail(const char* what) const;

  std::filesystem::path path_;
  int file_ = -1;
};

/// The first `most` bytes, or all of a shorter file, so that a file of another kind is refused before it is
/// read whole. InputError as read_file's.
std::string read_head(const std::filesystem::path& path, std::size_t most);

/// A file's characters in order, a part of them in memory at a time: for readers of files that may be large
/// and need not be good.
class FileCharacters {
 public:
  /// At the first character behind a byte order mark. InputError as OpenFile, for UTF-16, and, then or while
  /// it is read, if the file holds more than `most` bytes.
  explicit FileCharacters(const std::filesystem::path& file,
                          std::uintmax_t most = std::numeric_limits<std::uintmax_t>::max());

  /// Whether all characters have been passed.
  bool at_end() const { return held_ == 0; }
  /// The current character; the file must not be at its end.
  char current() const { return part_[at_]; }
  /// Moves to the next character. Interrupted if a signal has come.
  void next() {
    if (++at_ == held_) fill();
  }
  /// Number of characters before the current one.
  std::uintmax_t place() const { return before_ + at_; }
  /// Number of characters from the current one on, by the file's size.
  std::uintmax_t left() const { return size_ > place() ? size_ - place() : 0; }

 private:
  void fill();

  OpenFile file_;
  std::uintmax_t most_, size_, before_ = 0;  // of the file; before the part in memory
  std::size_t at_ = 0, held_ = 0;
  char part_[1 << 14];
};

/// A part of the program that the build makes, e.g. "plugins/fusion.so": in the executable's folder (a build
/// tree), else in lib/mirage beside the executable's folder (an installed prefix, which can be moved). If
/// neither has it, its path in the executable's folder.
std::filesystem::path built_file(const std::string& relative);

}  // namespace mirage
