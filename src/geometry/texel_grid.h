// How finely texels divide each face of a mesh. All faces of a TexelAtlas are divided alike; what is drawn of
// them need not be (light varies within some texels: sensors/visible_light.h).
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "base/types.h"

namespace mirage {

/// C of each face, and where its C² texels start in a list of all faces' texels, face-major; within a face in
/// TexelAtlas's order.
struct TexelGrid {
  int resolution = 1;            ///< C of every face, unless there are
  std::vector<int> resolutions;  ///< C of each face
  std::vector<int> first;        ///< where each face's texels start, and after the last where they end

  /// Every face alike.
  TexelGrid(int all = 1) : resolution(all) {}
  /// Each face its own.
  explicit TexelGrid(std::vector<int> of_faces) : resolutions(std::move(of_faces)), first(1, 0) {
    for (const int c : resolutions) first.push_back(first.back() + c * c);
  }

  /// C of a face.
  int resolution_of(std::size_t face) const { return resolutions.empty() ? resolution : resolutions[face]; }
  /// How many texels it has.
  std::size_t texels_of(std::size_t face) const {
    const auto c = static_cast<std::size_t>(resolution_of(face));
    return c * c;
  }
  /// Where they start.
  std::size_t first_texel(std::size_t face) const {
    return resolutions.empty() ? face * texels_of(face) : static_cast<std::size_t>(first[face]);
  }
  /// How many faces so many texels are of.
  std::size_t faces_with(std::size_t texels) const {
    return resolutions.empty() ? texels / texels_of(0) : resolutions.size();
  }
};

// How TexelAtlas splits a face: SoftRas's square texels are C² congruent triangles.

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
