// The adversary's parameters: start, box, projection and optimiser (src/README.md, Adversary).
#pragma once

#include <cstdint>
#include <vector>

#include "base/fields.h"
#include "geometry/mesh.h"

namespace mirage {

/// Vertex box, metres: |x| ≤ half.x, |y| ≤ half.y, |z| ≤ half.z; texels stay in [0, 1].
struct AdversaryLimits {
  Vec3d half = kRoofBox;
  /// Set by --size; otherwise an attack takes the volume of its placement (fit_limits).
  bool is_explicit = false;
};

/// m; half lengths outside this range fit no object on a car's roof.
inline constexpr double kMinAdversarySize = kMinObject, kMaxAdversarySize = kMaxObject / 2;

template <class Visitor, FieldsOf<AdversaryLimits> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "half", .range = {kMinAdversarySize, kMaxAdversarySize}}, s.half);
}

/// The box of the paper's proportions (0.8 : 0.8 : 0.5) whose half length is `size` m.
AdversaryLimits limits_of_size(double size);
/// limits_of_size() of the number in `text`. FieldError if it is no number.
void set_from_text(const std::string& text, AdversaryLimits& value);
/// The half length along x (m), or "the placement's volume" if no size was set.
std::string text_of(const AdversaryLimits& value);

/// grey_ellipsoid (geometry/mesh.h: 162 vertices, 320 faces) that fills `share` of the box.
TexturedMesh initial_adversary(const AdversaryLimits& limits = {}, double share = 0.75);
/// The baseline: the same start with every vertex moved by up to `amplitude` m (projected) and random texels.
TexturedMesh random_adversary(std::uint64_t seed, const AdversaryLimits& limits = {}, double amplitude = 0.1);
/// Clamps vertices into the box and texels into [0, 1].
void project(TexturedMesh& adversary, const AdversaryLimits& limits);

/// m, half lengths of a mesh around the origin: the largest |x|, |y|, |z| of its vertices.
Vec3d half_lengths(const Mesh& mesh);
/// Gradient of the half lengths (`--parts size`): vertex v_i = h ∘ u_i, with h the half lengths (m) and u_i
/// the start vertex scaled to half lengths 1. Returns d loss / d h = Σ_i u_i ∘ d loss / d v_i.
Vec3d half_length_gradient(const std::vector<Vec3d>& unit, const std::vector<Vec3d>& d_vertices);

/// Adam (Kingma & Ba, ICLR 2015) over one group of parameters.
struct Adam {
  double learning_rate = 1e-3, beta1 = 0.9, beta2 = 0.999, epsilon = 1e-8;
  long step_count = 0;
  std::vector<double> first, second;  ///< moments, flat

  /// values −= learning_rate · m̂ / (√v̂ + ε); x, y, z (or r, g, b) flattened.
  void step(std::vector<Vec3d>& values, const std::vector<Vec3d>& gradient);
};

}  // namespace mirage
