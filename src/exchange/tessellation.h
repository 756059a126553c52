// SoftRas's atlas as plain geometry: square texels cannot represent C² congruent triangles, but each of those
// triangles with all its UVs at one texel's centre is exact in every viewer (src/README.md).
#pragma once

#include <array>
#include <vector>

#include "geometry/mesh.h"

namespace mirage {

/// One of a face's C² congruent triangles: barycentrics (b0, b1) of its corners, wound as the face is, and
/// the index within the face of the texel that covers it (see TexelAtlas).
struct AtlasTriangle {
  std::array<Vec2d, 3> corners;
  int texel = 0;
};
/// The C² triangles of a face, C = `resolution`, row by row.
std::vector<AtlasTriangle> atlas_triangles(int resolution);

/// Where the texels of a mesh lie in its picture: row-major, texel t at pixel (t mod width, t / width).
struct TextureLayout {
  int width = 1, height = 1;
  /// The smallest near-square picture that holds so many texels.
  explicit TextureLayout(std::size_t texels);
  /// UV (origin top left, as glTF has it) of the texel's centre.
  Vec2d centre(std::size_t texel) const;
};

}  // namespace mirage
