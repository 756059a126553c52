// Where the texels of a mesh lie in a picture. Each triangle of geometry/atlas_triangles.h with all its UVs
// at its texel's centre is exact in every viewer (src/README.md).
#pragma once

#include <cstddef>

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

}  // namespace mirage
