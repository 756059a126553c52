// A checked glTF file in tinygltf's terms, and what its nodes hold as meshes in `velo`.
#pragma once

#include <fmt/format.h>
#include <tiny_gltf.h>

#include <algorithm>
#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "base/error.h"
#include "base/image.h"
#include "base/sizes.h"
#include "base/types.h"
#include "geometry/mesh.h"

namespace mirage {

// Where the texels of a mesh lie in a picture. Each triangle of geometry/mesh.h with all its UVs
// at its texel's centre is exact in every viewer (src/README.md).

/// Where the texels of a mesh lie in its picture: row-major, texel t at pixel (t mod width, t / width).
struct TextureLayout {
  int width = 1, height = 1;
  /// The smallest near-square picture that holds `texels` texels.
  explicit TextureLayout(std::size_t texels);
  /// UV (origin top left, as glTF has it) of the texel's centre.
  Vec2d centre(std::size_t texel) const;
};
/// The texels as that picture: scene-linear, white after the last texel.
ImageF texel_picture(const TexelAtlas& atlas);

// Assembles a binary glTF 2.0 file (Khronos, glTF 2.0 specification, section 4.4: GLB).

/// Collects the buffers and the objects of one .glb file.
class GltfBuilder {
 public:
  GltfBuilder();

  /// Appends bytes (8-aligned) and returns the index of their buffer view. `target`: 0 or the GL target.
  int add_view(const void* data, std::size_t bytes, int target = 0);
  /// The same of a vector's values, which are written as they lie in memory.
  template <class T>
  int add_view(const std::vector<T>& values, int target = 0) {
    return add_view(values.data(), values.size() * sizeof(T), target);
  }
  /// float32 vectors of `components` values a vertex: 2, or 3 for positions, whose bounds are written too.
  int add_floats(const std::vector<float>& values, int components);
  /// The vertices of the faces' corners, as uint32.
  int add_corners(const std::vector<Face>& faces);
  /// Appends to json[array] and returns the index.
  int add(const char* array, nlohmann::json value);
  /// Appends a node that stands at the scene's root.
  int add_node(nlohmann::json value);

  /// The glTF object, to add to.
  nlohmann::json& json() { return json_; }
  /// The finished file.
  std::string glb() const;

 private:
  nlohmann::json json_;
  std::string binary_;
};

/// glTF has y up: `velo` (x forward, y left, z up) → (x, z, −y). Blender turns that back into `velo`.
inline Eigen::Matrix3d gltf_from_velo() {
  Eigen::Matrix3d m;
  m << 1, 0, 0, 0, 0, 1, 0, -1, 0;
  return m;
}

/// The list's entry `index`; null if there is none.
template <class T>
const T* entry(const std::vector<T>& list, int index) {
  return index >= 0 && as_size(index) < list.size() ? &list[as_size(index)] : nullptr;
}

/// A checked glTF file and what Mirage reads from it.
class GltfModel {
 public:
  /// Opens a .glb or .gltf (open_gltf) and reads it. InputError as there.
  explicit GltfModel(std::filesystem::path file);

  /// The document as tinygltf parsed it.
  const tinygltf::Model& model() const { return model_; }
  /// The path as the caller gave it.
  const std::filesystem::path& file() const { return file_; }
  [[noreturn]] void fail(const std::string& field, const std::string& problem,
                         const std::string& fix = "export the file again") const;

  /// Bytes of a buffer view.
  std::string_view view(int index, const std::string& field) const;

  /// Mirage's exact mesh from the extras of the node's mesh, if present, placed by the node. InputError if
  /// the triangles or colours that viewers draw, and editors change, differ from it.
  std::optional<TexturedMesh> exact(const tinygltf::Node& node, const std::string& field,
                                    const Eigen::Affine3d& gltf_from_node) const;
  /// The triangles of a node's mesh, each face with its material's base colour, placed and added to `out`.
  void append_mesh(const tinygltf::Node& node, const std::string& field,
                   const Eigen::Affine3d& gltf_from_node, TexturedMesh& out) const;
  /// All triangles of the default scene in `velo`, one texel a face.
  TexturedMesh triangles() const;
  /// Mirage's exact mesh, the scene's first; otherwise all triangles. InputError if the scene has other
  /// meshes beside it, unless Mirage wrote the scene.
  TexturedMesh object() const;
  /// Logs one warning that names unsupported features that colour foreign meshes, if there are any.
  void warn_of_what_is_left_out() const;
  /// InputError if a vertex from `first` on lies further than gltf_limits::kMaxCoordinate.
  void check_reach(const Mesh& mesh, std::size_t first, const std::string& field) const;

  /// Calls enter(node, field, gltf_from_node) for every node of the default scene. Interrupted after Ctrl-C.
  template <class Enter>
  void walk(const Enter& enter) const {
    if (const tinygltf::Scene* scene = default_scene())
      for (int root : scene->nodes) walk(root, Eigen::Affine3d::Identity(), enter);
  }
  /// Mirage's extras of the default scene, or null.
  const tinygltf::Value* scene_extras() const;

  /// A finite number of an extras object. InputError naming `field`.
  double number(const tinygltf::Value& parent, const char* key, const std::string& field) const;
  /// A list of `count` finite numbers. InputError naming `field`.
  std::vector<double> numbers(const tinygltf::Value& parent, const char* key, std::size_t count,
                              const std::string& field) const;
  /// Three numbers in [low, high].
  Vec3d triple(const tinygltf::Value& parent, const char* key, const std::string& field, double low,
               double high) const;

 private:
  struct Column;

  /// From extras: float64 vertices and texels, int32 faces.
  TexturedMesh exact(const tinygltf::Value& source, const std::string& field) const;
  void check_unchanged(const TexturedMesh& exact, const tinygltf::Node& node, const std::string& field,
                       const Eigen::Affine3d& gltf_from_node) const;
  /// Whether the primitive's material draws these texels, to 8 bits. `field`: the mesh's.
  bool draws(const TexelAtlas& atlas, const tinygltf::Primitive& primitive, const std::string& field) const;

  const tinygltf::Scene* default_scene() const {
    return entry(model_.scenes, std::max(0, model_.defaultScene));
  }
  static Eigen::Affine3d transform(const tinygltf::Node& node);
  /// Each node has one parent and the tree's depth is bounded: open_gltf has checked both.
  template <class Enter>
  void walk(int index, const Eigen::Affine3d& parent, const Enter& enter) const {
    throw_if_interrupted("nothing was written");
    const tinygltf::Node& node = model_.nodes.at(as_size(index));
    const Eigen::Affine3d gltf_from_node = parent * transform(node);
    enter(node, fmt::format("nodes[{}]", index), gltf_from_node);
    for (int child : node.children) walk(child, gltf_from_node, enter);
  }
  Column column(int index, int components, bool floating, const std::string& field) const;
  void append_primitive(const tinygltf::Primitive& primitive, const std::string& field,
                        const Eigen::Affine3d& gltf_from_node, TexturedMesh& out) const;
  template <class T>
  std::vector<T> values(const tinygltf::Value& parent, const std::string& key,
                        const std::string& field) const;

  std::filesystem::path file_;
  tinygltf::Model model_;
};

}  // namespace mirage
