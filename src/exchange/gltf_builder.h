// Where the texels of a mesh lie in a picture. Each triangle of geometry/texel_grid.h with all its UVs
// at its texel's centre is exact in every viewer (src/README.md).
#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/types.h"

namespace mirage {

/// Where the texels of a mesh lie in its picture: row-major, texel t at pixel (t mod width, t / width).
struct TextureLayout {
  int width = 1, height = 1;
  /// The smallest near-square picture that holds so many texels.
  explicit TextureLayout(std::size_t texels);
  /// UV (origin top left, as glTF has it) of the texel's centre.
  Vec2d centre(std::size_t texel) const;
};

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
  /// float32 vectors of `components` values a vertex; bounds are written for positions.
  int add_floats(const std::vector<float>& values, int components, bool with_bounds);
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

}  // namespace mirage
