// How finely texels divide each face of a mesh. All faces of a TexelAtlas are divided alike; what is drawn of
// them need not be (light varies within some texels: sensors/visible_light.h).
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

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

}  // namespace mirage
