// A checked glTF file in tinygltf's terms, and what its nodes hold as meshes in `velo`.
#pragma once

#include <fmt/format.h>
#include <tiny_gltf.h>

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "base/interrupt.h"
#include "geometry/mesh.h"

namespace mirage {

/// A checked glTF file and what Mirage reads from it.
class GltfModel {
 public:
  /// Opens a .glb or .gltf (open_gltf) and reads it. InputError as there.
  explicit GltfModel(std::filesystem::path file);

  /// As tinygltf has it.
  const tinygltf::Model& model() const { return model_; }
  /// As it was given.
  const std::filesystem::path& file() const { return file_; }
  [[noreturn]] void fail(const std::string& field, const std::string& problem,
                         const std::string& fix = "export the file again") const;

  /// Bytes of a buffer view.
  std::pair<const unsigned char*, std::size_t> view(int index, const std::string& field) const;

  /// Mirage's own mesh, from `extras`: float64 vertices and texels, int32 faces.
  TexturedMesh exact(const tinygltf::Value& source, const std::string& field) const;
  /// The triangles of a node's mesh, each face with its material's base colour, placed and added to `out`.
  void append_mesh(const tinygltf::Node& node, const std::string& field,
                   const Eigen::Affine3d& gltf_from_node, TexturedMesh& out) const;
  /// All triangles of the default scene in `velo`, one texel a face.
  TexturedMesh triangles() const;
  /// Mirage's own mesh, the file's first with its extras; else all triangles.
  TexturedMesh object() const;
  /// One warning that names what changes the colours of foreign meshes and is not read, if there is such.
  void warn_of_what_is_left_out() const;
  /// InputError if a vertex from `first` on lies further than gltf_limits::kFurthest.
  void check_reach(const Mesh& mesh, std::size_t first, const std::string& field) const;

  /// Calls enter(node, field, gltf_from_node) for every node of the default scene. Interrupted after Ctrl-C.
  template <class Enter>
  void walk(const Enter& enter) const {
    const std::size_t scene = scene_index();
    if (scene >= model_.scenes.size()) return;
    for (int root : model_.scenes[scene].nodes) walk(root, Eigen::Affine3d::Identity(), enter);
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

  std::size_t scene_index() const { return model_.defaultScene >= 0 ? model_.defaultScene : 0; }
  static Eigen::Affine3d transform(const tinygltf::Node& node);
  /// Each node has one parent and the tree's depth is bounded: open_gltf has looked.
  template <class Enter>
  void walk(int index, const Eigen::Affine3d& parent, const Enter& enter) const {
    throw_if_interrupted("nothing was written");
    const tinygltf::Node& node = model_.nodes.at(static_cast<std::size_t>(index));
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
