// Files that a mesh file names (glTF's buffers, OBJ's materials). Such a file may come from anybody, so it
// reaches no further than the folder it lies in.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

namespace mirage {

/// The files that may be read because one file names them.
class FolderFiles {
 public:
  /// `file`: the one that names others. Its folder (symbolic links resolved) and what is below it can be
  /// read. InputError if it can't be opened or is no regular file (a pipe would be waited for, a device read
  /// for ever).
  explicit FolderFiles(const std::filesystem::path& file);

  /// Where the file that names the others really is.
  const std::filesystem::path& file() const { return file_; }
  /// What `name` leads to: relative to the folder, never to the working directory. InputError, with `field`
  /// of the naming file, unless that is a regular file in the folder once all links are resolved.
  std::filesystem::path find(const std::string& name, const std::string& field) const;
  /// Its content, at most `most` bytes of it. InputError as find.
  std::string read(const std::string& name, const std::string& field, std::size_t most) const;

 private:
  std::filesystem::path given_, file_, folder_;
};

/// ".glb" of a.GLB: a file's kind does not depend on how its ending is spelt.
std::string lower_extension(const std::filesystem::path& file);

/// "%20" → " " and so on (RFC 3986, section 2.1). None for a broken sequence or a zero byte.
std::optional<std::string> percent_decoded(const std::string& uri);

}  // namespace mirage
