// How TexelAtlas splits a face: SoftRas's square texels are C² congruent triangles.
#pragma once

#include <algorithm>
#include <array>
#include <limits>
#include <vector>

#include "base/types.h"

namespace mirage {

/// Index within a face of the texel at barycentrics (b0, b1) (see TexelAtlas).
template <class S>
int texel_index(S b0, S b1, int resolution) {
  const S x = b0 * S(resolution), y = b1 * S(resolution);
  const int last = resolution - 1;
  const int ix = std::clamp(static_cast<int>(x), 0, last), iy = std::clamp(static_cast<int>(y), 0, last);
  // On the far edge x + y − ix − iy is 1 up to rounding: a tolerance picks the lower half.
  if (x + y - S(ix) - S(iy) <= 1 + S(64) * std::numeric_limits<S>::epsilon() * S(resolution))
    return iy * resolution + ix;
  return (last - iy) * resolution + (last - ix);
}

/// One of a face's C² congruent triangles: barycentrics (b0, b1) of its corners, wound as the face is, and
/// the index within the face of the texel that covers it (texel_index of what lies inside).
struct AtlasTriangle {
  std::array<Vec2d, 3> corners;
  int texel = 0;
};
/// The C² triangles of a face, C = `resolution`, row by row.
std::vector<AtlasTriangle> atlas_triangles(int resolution);

}  // namespace mirage
