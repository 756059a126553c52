#include "exchange/gltf_document.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <Eigen/LU>
#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <numbers>
#include <utility>

#include "base/error.h"
#include "base/files.h"
#include "base/sizes.h"
#include "base/types.h"

namespace mirage {

namespace fs = std::filesystem;

namespace {

const char* kCheckPath = "check the path and its permissions";

/// The first `most` bytes of a regular file, opened without following a link at its end and without waiting.
std::string read_regular_file(const fs::path& file, std::size_t most) {
  const int handle = ::open(file.c_str(), O_RDONLY | O_NONBLOCK | O_NOFOLLOW | O_CLOEXEC);
  struct stat about {};
  if (handle < 0 || ::fstat(handle, &about) != 0 || !S_ISREG(about.st_mode)) {
    const std::string reason = handle < 0 ? std::strerror(errno) : "is not a regular file";
    if (handle >= 0) ::close(handle);
    throw InputError(file.string(), "", reason, kCheckPath);
  }
  std::string bytes(std::min(most, as_size(about.st_size)), '\0');
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n = ::read(handle, bytes.data() + done, bytes.size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) break;
    done += as_size(n);
  }
  const int reason = errno;
  ::close(handle);
  if (done < bytes.size()) throw InputError(file.string(), "", std::strerror(reason), kCheckPath);
  return bytes;
}

constexpr std::size_t kHeader = 20, kChunkHeader = 8;  // bytes; the former with the first chunk's
/// Bytes of the JSON of a .glb, whose data lie behind it.
constexpr std::size_t kMaxGlbJsonBytes = std::size_t{1} << 24;

/// Bytes of the JSON, a .glb's first chunk, by the file's `head` and size.
std::size_t json_size(std::string_view head, std::uintmax_t size, const std::string& file) {
  const auto fail = [&](const char* field, const std::string& problem, const char* fix) {
    throw InputError(file, field, problem, fix);
  };
  const auto u32 = [&](std::size_t at) {
    std::uint32_t value = 0;
    std::memcpy(&value, head.data() + at, sizeof value);
    return value;
  };
  if (head.size() < kHeader)
    fail("header", fmt::format("{} bytes are too few for a .glb file", head.size()), "export the file again");
  if (!head.starts_with("glTF")) fail("magic", "is not \"glTF\"", "give a binary glTF 2.0 file (.glb)");
  if (u32(4) != 2) fail("version", fmt::format("{}", u32(4)), "give a glTF 2.0 file");
  if (u32(8) > size)
    fail("length", fmt::format("truncated: {} of {} bytes", size, u32(8)),
         "restore the file or export it again");
  if (u32(16) != 0x4E4F534A || u32(12) > size - kHeader)
    fail("JSON", "the first chunk is not whole", "restore the file or export it again");
  if (u32(12) > kMaxGlbJsonBytes)
    fail("JSON", fmt::format("is larger than {} bytes", kMaxGlbJsonBytes),
         "export the file again, with its data in the binary chunk");
  return u32(12);
}

/// Of a document: ours have some thousands, and numbers of vertices lie in buffers.
constexpr std::size_t kMaxValues = 200000;
/// Of a file, and of all buffers together: a photograph and thirty objects of a million faces.
constexpr std::size_t kMaxBytesInMemory = std::size_t{1} << 28;

// The demands of glTF 2.0 on a document (Khronos, glTF 2.0 specification, chapter 5) as far as a reader
// relies on them, and the limits of gltf_document.h.

using nlohmann::json;
using namespace gltf_limits;

constexpr double kMaxBytes = 4294967296.0;  // a .glb's own lengths have 32 bits

class Checker {
 public:
  Checker(const json& document, std::string file) : document_(document), file_(std::move(file)) {}

  void run() {
    if (!document_.is_object()) fail("JSON", "is not an object");
    const json& asset = member(document_, "asset");
    if (!asset.is_object() || !member(asset, "version").is_string() ||
        !member(asset, "version").get_ref<const std::string&>().starts_with("2."))
      fail("asset.version", "is not 2.0", "give a glTF 2.0 file");
    check_demands(asset);
    for (const char* name : {"buffers", "bufferViews", "accessors", "images", "materials", "meshes",
                             "cameras", "nodes", "scenes"})
      each(name, [&](const json& entry, const std::string& field) {
        if (!entry.is_object()) fail(field, "is not an object");
      });
    each("buffers", [&](const json& buffer, const std::string& field) {
      whole(buffer, "byteLength", field, 1, kMaxBytes, true);
      text(buffer, "uri", field);
    });
    each("bufferViews", [&](const json& view, const std::string& field) { check_view(view, field); });
    each("accessors", [&](const json& accessor, const std::string& field) {
      index(accessor, "bufferView", field, "bufferViews");
      whole(accessor, "byteOffset", field, 0, kMaxBytes);
      whole(accessor, "count", field, 0, 2147483647, true);
      whole(accessor, "componentType", field, 5120, 5126, true);
    });
    each("images", [&](const json& image, const std::string& field) {
      index(image, "bufferView", field, "bufferViews");
      text(image, "uri", field);
    });
    each("materials", [&](const json& material, const std::string& field) {
      const json& model = member(material, "pbrMetallicRoughness");
      if (model.is_null()) return;
      if (!model.is_object()) fail(field + ".pbrMetallicRoughness", "is not an object");
      numbers(model, "baseColorFactor", 4, field + ".pbrMetallicRoughness", 0, 1);
    });
    each("meshes", [&](const json& mesh, const std::string& field) { check_mesh_entry(mesh, field); });
    each("cameras", [&](const json& camera, const std::string& field) {
      const json& lens = member(camera, "perspective");
      if (lens.is_null()) return;
      if (!lens.is_object()) fail(field + ".perspective", "is not an object");
      const json& angle = member(lens, "yfov");
      if (!angle.is_number() || !(angle.get<double>() > 0 && angle.get<double>() < std::numbers::pi))
        fail(field + ".perspective.yfov", "is not an angle between 0 and π");
    });
    check_lights();
    check_nodes();
  }

 private:
  [[noreturn]] void fail(const std::string& field, const std::string& problem,
                         const std::string& fix = "export the file again") const {
    throw InputError(file_, field, problem, fix);
  }

  static const json& member(const json& parent, const char* key) {
    static const json nothing;
    if (!parent.is_object()) return nothing;
    const auto entry = parent.find(key);
    return entry == parent.end() ? nothing : *entry;
  }

  std::size_t size(const char* array) const { return member(document_, array).size(); }

  template <class Check>
  void list(const json& parent, const char* key, const std::string& field, const Check& check) const {
    const json& entries = member(parent, key);
    if (entries.is_null()) return;
    if (!entries.is_array()) fail(field, "is not a list");
    for (std::size_t i = 0; i < entries.size(); ++i) check(entries[i], fmt::format("{}[{}]", field, i));
  }
  template <class Check>
  void each(const char* array, const Check& check) const {
    list(document_, array, array, check);
  }

  /// An absent member passes unless it is `needed`.
  void whole(const json& parent, const char* key, const std::string& field, double low, double high,
             bool needed = false) const {
    const json& value = member(parent, key);
    if (value.is_null() && !needed) return;
    const double number = value.is_number() ? value.get<double>() : NAN;
    if (!(number >= low && number <= high) || number != std::floor(number))
      fail(field + "." + key, value.is_number() ? fmt::format("is {}", number) : "is not a number",
           fmt::format("write a whole number from {:.0f} to {:.0f}", low, high));
  }

  void index(const json& parent, const char* key, const std::string& field, const char* array,
             bool needed = false) const {
    const json& value = member(parent, key);
    if (value.is_null() && !needed) return;
    entry_of(value, field + "." + key, array);
  }

  std::size_t entry_of(const json& value, const std::string& field, const char* array) const {
    const double number = value.is_number() ? value.get<double>() : -1;
    if (!(number >= 0 && number < static_cast<double>(size(array))) || number != std::floor(number))
      fail(field, fmt::format("is not one of the file's {} {}", size(array), array));
    return static_cast<std::size_t>(number);
  }

  void text(const json& parent, const char* key, const std::string& field) const {
    const json& value = member(parent, key);
    if (!value.is_null() && !value.is_string()) fail(field + "." + key, "is not a text");
  }

  /// `count` numbers in [low, high]; empty if the member is absent.
  std::vector<double> numbers(const json& parent, const char* key, std::size_t count,
                              const std::string& field, double low, double high) const {
    const json& value = member(parent, key);
    std::vector<double> result;
    if (value.is_null()) return result;
    const std::string name = field + "." + key;
    if (!value.is_array() || value.size() != count)
      fail(name, fmt::format("is not a list of {} numbers", count));
    for (const json& entry : value) {
      const double number = entry.is_number() ? entry.get<double>() : NAN;
      if (!(number >= low && number <= high))
        fail(name, fmt::format("holds {}", entry.is_number() ? fmt::format("{}", number) : "no number"),
             fmt::format("write numbers from {:g} to {:g}", low, high));
      result.push_back(number);
    }
    return result;
  }

  /// Checks the features that the file demands of its reader (section 3.12; the version by section 3.2).
  void check_demands(const json& asset) const {
    text(asset, "minVersion", "asset");
    if (const json& least = member(asset, "minVersion"); !least.is_null() && least != "2.0")
      fail("asset.minVersion", fmt::format("is {}: glTF 2.0 is read", least.get<std::string>()),
           "export the file as glTF 2.0");
    list(document_, "extensionsRequired", "extensionsRequired",
         [&](const json& name, const std::string& field) {
           if (!name.is_string()) fail(field, "is not a text");
           if (name != "KHR_lights_punctual")
             fail(field, fmt::format("{} is not read", name.get<std::string>()),
                  "export the file without it");
         });
  }

  /// Refuses features that move, multiply or hide a mesh beyond transforms: without them it would have
  /// another shape.
  void check_shape(const json& node, const std::string& field) const {
    const json& mesh = member(node, "mesh");
    const json& extensions = member(node, "extensions");
    const char* kInstances = "EXT_mesh_gpu_instancing";
    if (!member(extensions, kInstances).is_null())
      fail(fmt::format("{}.extensions.{}", field, kInstances), "is not read: one copy would be left of many",
           "export the copies as nodes of their own");
    if (member(member(extensions, "KHR_node_visibility"), "visible") == false)
      fail(field + ".extensions.KHR_node_visibility", "hides what would be drawn", "leave the node away");
    if (mesh.is_null()) return;
    if (!member(node, "skin").is_null())
      fail(field + ".skin", "bends its mesh by a skeleton, which is not read",
           "apply the armature before exporting");
    const json& shape = member(document_, "meshes")[mesh.get<std::size_t>()];
    const bool own = !member(node, "weights").is_null();
    const json& weights = member(own ? node : shape, "weights");
    const auto moves = [](const json& weight) { return !weight.is_number() || weight != 0; };
    if (weights.is_array() && std::any_of(weights.begin(), weights.end(), moves))
      fail(own ? field + ".weights" : fmt::format("meshes[{}].weights", mesh.get<std::size_t>()),
           "mixes morph targets, which are not read", "apply the shape keys before exporting");
  }

  void check_view(const json& view, const std::string& field) const {
    index(view, "buffer", field, "buffers", true);
    whole(view, "byteOffset", field, 0, kMaxBytes);
    whole(view, "byteLength", field, 0, kMaxBytes, true);
    whole(view, "byteStride", field, 0, 252);
    const json& buffer = member(document_, "buffers")[member(view, "buffer").get<std::size_t>()];
    const double offset = member(view, "byteOffset").is_null() ? 0 : member(view, "byteOffset").get<double>();
    if (offset + member(view, "byteLength").get<double>() > member(buffer, "byteLength").get<double>())
      fail(field, "runs past its buffer");
  }

  void check_mesh_entry(const json& mesh, const std::string& field) const {
    list(mesh, "primitives", field + ".primitives", [&](const json& primitive, const std::string& name) {
      if (!primitive.is_object()) fail(name, "is not an object");
      whole(primitive, "mode", name, 0, 6);
      index(primitive, "indices", name, "accessors");
      index(primitive, "material", name, "materials");
      const json& attributes = member(primitive, "attributes");
      if (attributes.is_null()) return;
      if (!attributes.is_object()) fail(name + ".attributes", "is not an object");
      for (const auto& [key, value] : attributes.items())
        entry_of(value, name + ".attributes." + key, "accessors");
      const char* kDraco = "KHR_draco_mesh_compression";
      if (member(member(primitive, "extensions"), kDraco).is_null() || !attributes.contains("POSITION"))
        return;
      const auto positions = member(attributes, "POSITION").get<std::size_t>();
      if (member(member(document_, "accessors")[positions], "bufferView").is_null())
        fail(fmt::format("{}.extensions.{}", name, kDraco), "is not read, and there is no uncompressed copy",
             "export the file without compression");
    });
  }

  void check_lights() const {
    const json& lights = member(member(document_, "extensions"), "KHR_lights_punctual");
    list(
        lights, "lights", "extensions.KHR_lights_punctual.lights",
        [&](const json& light, const std::string& field) {
          numbers(light, "color", 3, field, 0, 1);
          const json& strength = member(light, "intensity");
          if (strength.is_null()) return;
          if (!strength.is_number() || !(strength.get<double>() >= 0 && strength.get<double>() <= kBrightest))
            fail(field + ".intensity", fmt::format("is not a strength from 0 to {:g}", kBrightest));
        });
  }

  void check_placement(const json& node, const std::string& field) const {
    numbers(node, "translation", 3, field, -kMaxCoordinate, kMaxCoordinate);
    const auto scale = numbers(node, "scale", 3, field, -kMaxCoordinate, kMaxCoordinate);
    if (!scale.empty() && Eigen::Map<const Vec3d>(scale.data()).cwiseAbs().minCoeff() == 0)
      fail(field + ".scale", "is zero: it flattens what it places", "leave the node away");
    const auto turn = numbers(node, "rotation", 4, field, -1e3, 1e3);
    if (!turn.empty() && Eigen::Map<const Eigen::Vector4d>(turn.data()).norm() < 1e-3)
      fail(field + ".rotation", "has no length", "write a unit quaternion");
    const auto values = numbers(node, "matrix", 16, field, -kMaxCoordinate, kMaxCoordinate);
    if (values.empty()) return;
    const Eigen::Map<const Eigen::Matrix4d> matrix(values.data());  // by columns, as glTF has it
    if ((matrix.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() > 1e-6)
      fail(field + ".matrix", "is projective: its last row is not 0 0 0 1", "write an affine transform");
    if (!(std::abs(matrix.topLeftCorner<3, 3>().determinant()) > 1e-30))
      fail(field + ".matrix", "is singular: it flattens what it places", "write an invertible transform");
  }

  /// Vertices, corners and texels that a mesh brings, from the lengths that the file claims.
  std::size_t corners(std::size_t mesh) const {
    double sum = 0;
    const auto count = [&](const json& accessor) {
      if (accessor.is_null()) return;
      sum += member(member(document_, "accessors")[accessor.get<std::size_t>()], "count").get<double>();
    };
    const json& entry = member(document_, "meshes")[mesh];
    for (const json& primitive : member(entry, "primitives")) {
      count(member(member(primitive, "attributes"), "POSITION"));
      count(member(primitive, "indices"));
    }
    // Mirage's exact mesh: three float64 a vertex, an int32 a corner.
    const json& exact = member(member(entry, "extras"), "mirage");
    for (const auto& [key, bytes] :
         {std::pair{"vertices", 24.0}, std::pair{"texels", 24.0}, std::pair{"faces", 4.0}})
      if (const json& view = member(exact, key);
          view.is_number_unsigned() && view.get<std::size_t>() < size("bufferViews"))
        sum += member(member(document_, "bufferViews")[view.get<std::size_t>()], "byteLength").get<double>() /
               bytes;
    return static_cast<std::size_t>(sum);
  }

  /// Each node has at most one parent, so that a walk from the roots meets every node at most once
  /// (section 3.5.2).
  void check_nodes() const {
    const std::size_t count = size("nodes");
    std::vector<int> depth(count, 0);
    std::vector<bool> child(count, false);
    std::vector<std::size_t> queue;
    std::size_t total = 0;
    each("nodes", [&](const json& node, const std::string& field) {
      index(node, "mesh", field, "meshes");
      index(node, "camera", field, "cameras");
      check_placement(node, field);
      check_shape(node, field);
      list(node, "children", field + ".children", [&](const json& value, const std::string& name) {
        const std::size_t below = entry_of(value, name, "nodes");
        if (child[below])
          fail(name, fmt::format("node {} has two parents", below), "give each node one parent");
        child[below] = true;
      });
      if (const json& mesh = member(node, "mesh"); !mesh.is_null()) total += corners(mesh.get<std::size_t>());
      if (total > kMaxCorners)
        fail(field + ".mesh", fmt::format("more than {} vertices, corners and texels in all", kMaxCorners),
             "simplify the meshes");
    });
    each("scenes", [&](const json& scene, const std::string& field) {
      std::vector<bool> listed(count, false);
      list(scene, "nodes", field + ".nodes", [&](const json& value, const std::string& name) {
        const std::size_t root = entry_of(value, name, "nodes");
        if (child[root] || listed[root])
          fail(name, fmt::format("node {} is {}", root, child[root] ? "no root" : "named twice"),
               "name each root once");
        listed[root] = true;
      });
    });
    if (const json& scene = member(document_, "scene"); !scene.is_null()) entry_of(scene, "scene", "scenes");
    for (std::size_t n = 0; n < count; ++n)
      if (!child[n]) queue.push_back(n);
    for (std::size_t at = 0; at < queue.size(); ++at)
      for (const json& value : member(member(document_, "nodes")[queue[at]], "children")) {
        const auto below = value.get<std::size_t>();
        depth[below] = depth[queue[at]] + 1;
        if (depth[below] >= kMaxNodeDepth)
          fail(fmt::format("nodes[{}]", below), fmt::format("is {} nodes deep", depth[below]),
               "flatten the tree");
        queue.push_back(below);
      }
    if (queue.size() == count) return;
    std::vector<bool> reached(count, false);
    for (std::size_t n : queue) reached[n] = true;
    for (std::size_t n = 0; n < count; ++n)
      if (!reached[n])
        fail(fmt::format("nodes[{}].children", n), "go round in a circle", "give each node one parent");
  }

  const json& document_;
  std::string file_;
};

}  // namespace

ConfinedFiles::ConfinedFiles(const fs::path& file) : given_(file) {
  std::error_code error;
  file_ = fs::canonical(file, error);
  if (error) throw InputError(file.string(), "", error.message(), kCheckPath);
  if (!fs::is_regular_file(file_, error))
    throw InputError(file.string(), "", "is not a regular file", "give the mesh or scene as a file");
  // Of the path as given: a link to a file elsewhere stands for a file in the link's own folder.
  folder_ = fs::canonical(fs::absolute(file).parent_path(), error);
  if (error) throw InputError(file.string(), "", error.message(), kCheckPath);
}

std::string ConfinedFiles::read(const std::string& name, const std::string& field, std::size_t most) const {
  const auto bad = [&](const char* problem, const char* fix = "put it beside the file that names it") {
    return InputError(given_.string(), field, problem, fix);
  };
  if (name.empty() || name.find('\0') != std::string::npos) throw bad("names no file");
  std::error_code error;
  const fs::path path = fs::canonical(folder_ / name, error);  // an absolute name replaces the folder
  const bool inside =
      !error &&
      std::mismatch(folder_.begin(), folder_.end(), path.begin(), path.end()).first == folder_.end();
  // One answer for both: whether a file exists elsewhere is no business of the naming file's author.
  if (!inside) throw bad("names a file that is not in its folder");
  if (!fs::is_regular_file(path, error)) throw bad("names something that is not a regular file");
  try {
    return read_regular_file(path, most);
  } catch (const InputError&) {
    throw bad("names a file that cannot be read", "check its permissions");
  }
}

std::string lower_extension(const fs::path& file) {
  std::string extension = file.extension().string();
  for (char& c : extension)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return extension;
}

std::optional<std::string> percent_decoded(const std::string& uri) {
  const auto digit = [](char c) {
    if (c >= '0' && c <= '9') return c - '0';
    const char lower = static_cast<char>(c | 0x20);
    return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : -1;
  };
  std::string text;
  for (std::size_t i = 0; i < uri.size(); ++i) {
    if (uri[i] != '%') {
      text.push_back(uri[i]);
      continue;
    }
    if (i + 2 >= uri.size()) return std::nullopt;
    const int high = digit(uri[i + 1]), low = digit(uri[i + 2]);
    if (high < 0 || low < 0 || high + low == 0) return std::nullopt;
    text.push_back(static_cast<char>(16 * high + low));
    i += 2;
  }
  return text;
}

bool looks_like_json(std::string_view head) {
  if (head.starts_with("\xEF\xBB\xBF")) head.remove_prefix(3);  // a byte order mark
  const std::size_t first = head.find_first_not_of(" \t\r\n");
  return first != std::string_view::npos && head[first] == '{';
}

GltfDocument open_gltf(const fs::path& file) {
  const ConfinedFiles folder(file);
  GltfDocument document;
  // Judged by content, because the name may be wrong; only a file that is neither is judged by its name.
  const std::string head = read_head(folder.file(), kHeader);
  const bool binary = document.binary =
      head.starts_with("glTF") || (!looks_like_json(head) && lower_extension(file) != ".gltf");
  std::string text;
  if (binary) {
    // The JSON alone first: an error there is found before the rest is in memory.
    const std::uintmax_t size = OpenFile(folder.file()).size();
    const std::size_t length = json_size(head, size, file.string());
    text = read_head(folder.file(), kHeader + length).substr(kHeader);
  } else {
    text = read_text(folder.file(), kMaxBytesInMemory);
  }
  check_json_depth(text, file.string(), "JSON");
  check_json_values(text, file.string(), kMaxValues);
  try {
    document.json = nlohmann::json::parse(text);
  } catch (const nlohmann::json::parse_error& error) {
    throw InputError(file.string(), "JSON", fmt::format("byte {}: not valid JSON", error.byte),
                     "export the file again");
  } catch (const nlohmann::json::exception&) {
    throw InputError(file.string(), "JSON", "holds a number beyond all limits", "export the file again");
  }
  Checker(document.json, file.string()).run();
  const std::size_t behind = kHeader + text.size() + kChunkHeader;  // where a .glb's data begin
  if (binary) {
    document.bytes = read_file(folder.file(), kMaxBytesInMemory);
    if (std::string_view(document.bytes).substr(std::min(kHeader, document.bytes.size()), text.size()) !=
        text)
      throw InputError(file.string(), "JSON", "changed while it was read", "try again");
  } else {
    document.bytes = std::move(text);
  }
  if (!document.json.contains("buffers")) return document;
  const nlohmann::json& buffers = document.json["buffers"];
  document.buffers.resize(buffers.size());
  std::size_t all = 0;
  for (std::size_t b = 0; b < buffers.size(); ++b) {
    const std::string field = fmt::format("buffers[{}]", b);
    const auto bad = [&](const std::string& problem) {
      throw InputError(file.string(), field, problem, "export the file again");
    };
    const auto length = buffers[b]["byteLength"].get<std::size_t>();
    if (length > kMaxBytesInMemory - std::min(all, kMaxBytesInMemory))
      bad(fmt::format("with those before it, holds more than {} bytes", kMaxBytesInMemory));
    all += length;
    if (!buffers[b].contains("uri")) {
      if (b > 0 || !binary) bad("has no uri and is not the first of a .glb");
      if (document.bytes.size() < behind || length > document.bytes.size() - behind)
        bad(fmt::format("{} bytes are more than the file holds", length));
      continue;
    }
    const auto uri = buffers[b]["uri"].get<std::string>();
    if (uri.starts_with("data:")) continue;
    const auto name = percent_decoded(uri);
    if (!name) bad("uri: is not a well-formed URI");
    document.buffers[b] = folder.read(*name, field + ".uri", length);
    if (document.buffers[b].size() < length)
      bad(fmt::format("uri: the file has {} bytes of {}", document.buffers[b].size(), length));
  }
  return document;
}

}  // namespace mirage
