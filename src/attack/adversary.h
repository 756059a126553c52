// The adversary's parameters: start, box, projection and optimiser (DESIGN, section 4).
#pragma once

#include <cstdint>
#include <vector>

#include "geometry/mesh.h"

namespace mirage {

/// Vertex box, metres: |x| ≤ half.x, |y| ≤ half.y, |z| ≤ half.z; texels stay in [0, 1].
struct AdversaryLimits {
  Vec3d half = Vec3d(0.8, 0.8, 0.5);
};

/// m; half lengths outside are no object for a car's roof.
inline constexpr double kSmallestSize = 1e-3, kLargestSize = 10;

/// The box of the paper's proportions (0.8 : 0.8 : 0.5) whose half length is `size` m.
AdversaryLimits limits_of_size(double size);

/// Icosphere (162 vertices, 320 faces) stretched to `share` of the box, 5×5 mid-grey texels a face.
TexturedMesh initial_adversary(const AdversaryLimits& limits = {}, double share = 0.75);
/// The baseline: the same start with every vertex moved by up to `amplitude` m (projected) and random texels.
TexturedMesh random_adversary(std::uint64_t seed, const AdversaryLimits& limits = {}, double amplitude = 0.1);
/// Clamps vertices into the box and texels into [0, 1].
void project(TexturedMesh& adversary, const AdversaryLimits& limits);

/// Adam (Kingma & Ba, ICLR 2015) over one group of parameters.
struct Adam {
  double learning_rate = 1e-3, beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8;
  long step_count = 0;
  std::vector<double> first, second;  ///< moments, flat

  /// values −= learning_rate · m̂ / (√v̂ + ε); x, y, z (or r, g, b) flattened.
  void step(std::vector<Vec3d>& values, const std::vector<Vec3d>& gradient);
};

}  // namespace mirage
