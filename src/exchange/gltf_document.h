// Files that a mesh file names (glTF's buffers, OBJ's materials). Such a file may come from anybody, so it
// reaches no further than the folder it lies in.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace mirage {

/// The files that may be read because one file names them.
class ConfinedFiles {
 public:
  /// `file`: the file that names others. Its folder (symbolic links resolved) and what is below it can be
  /// read. InputError if it can't be opened or is no regular file (a pipe would be waited for, a device read
  /// for ever).
  explicit ConfinedFiles(const std::filesystem::path& file);

  /// The real path of the file that names the others.
  const std::filesystem::path& file() const { return file_; }
  /// At most `most` bytes of the file `name`, relative to the folder, never to the working directory.
  /// InputError, with `field` of the naming file, unless that is a regular file in the folder once all links
  /// are resolved.
  std::string read(const std::string& name, const std::string& field, std::size_t most) const;

 private:
  std::filesystem::path given_, file_, folder_;
};

/// ".glb" of a.GLB: a file's kind does not depend on how its ending is spelt.
std::string lower_extension(const std::filesystem::path& file);

// A glTF 2.0 file before a reader interprets it: container opened, JSON parsed and checked, files that it
// names read. Its reader (gltf_model: tinygltf) recurses along nodes and extras, and skips what it does not
// understand; these checks make both safe.

/// A glTF file as text and bytes, checked before anything is built from it.
struct GltfDocument {
  bool binary = false;  ///< a .glb
  nlohmann::json json;
  std::string bytes;                 ///< the whole file; a .glb's binary chunk is in it
  std::vector<std::string> buffers;  ///< content of each buffer in a separate file; empty for other buffers
};

/// Limits of a file, far above the program's own files, yet cheap to read.
namespace gltf_limits {
inline constexpr double kMaxCoordinate = 1e7;  ///< m, |coordinate| of a vertex or a node; also |scale|
inline constexpr std::size_t kMaxCorners =
    1 << 25;                               ///< vertices + corners + texels, a mesh counted at each node
inline constexpr int kMaxNodeDepth = 256;  ///< nodes below each other
inline constexpr double kBrightest = 1e6;  ///< radiance or lux of a light
}  // namespace gltf_limits

/// "%20" → " " and so on (RFC 3986, section 2.1). Empty for a broken sequence or a zero byte.
std::optional<std::string> percent_decoded(const std::string& uri);

/// Whether a file with this head is a text glTF, if it is glTF at all.
bool looks_like_json(std::string_view head);

/// Opens a binary (.glb) or text (.gltf) file, told apart by content. InputError naming file and field: not
/// glTF 2.0; JSON nested deeper than kMaxJsonDepth; an index, offset, length, mode, colour, transform or
/// field of view that glTF does not allow or that exceeds the limits; unsupported features that change
/// shapes, by name: a required extension, instancing, skins, morph weights, hidden nodes; a node with two
/// parents or a cycle of nodes; a buffer that is neither inside the file nor a regular file in its folder
/// (ConfinedFiles). Pictures in separate files are not opened: nothing uses them.
GltfDocument open_gltf(const std::filesystem::path& file);

}  // namespace mirage
