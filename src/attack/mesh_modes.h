// A mesh by few numbers: large changes of the whole, for a search without gradients (attack/evolution.h).
//
// Modes are products of Legendre polynomials of u = x / half lengths of the box, of low total degree. A
// vertex of the start goes to
//     x' = exp(s) ∘ x + half ∘ Σ_k a_k P_k(u),
// clamped into the box, a texel at u to sigmoid(logit(start) + Σ_k c_k P_k(u)), each channel its own c_k. The
// mesh stays its own mirror image across the plane y = 0, as cars are: along x and z, and in colour, k runs
// over polynomials that are even in y, along y over odd ones. exp(s) stands for those that stretch an axis.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "attack/adversary.h"
#include "attack/attack_settings.h"

namespace mirage {

/// How numbers make a mesh of a start.
class MeshModes {
 public:
  /// `texture`: whether anything sees colours. `parts` says which numbers there are: size alone its three,
  /// shape those and the warp's, texture its own.
  MeshModes(const TexturedMesh& start, const AdversaryLimits& limits, AttackParts parts, bool texture);
  /// How many numbers.
  std::size_t size() const { return size_; }
  /// The start changed by `numbers` (size() of them), within the limits. Each is in units of what a search
  /// draws at first.
  TexturedMesh mesh(std::span<const double> numbers) const;

 private:
  TexturedMesh start_;
  AdversaryLimits limits_;
  bool sizes_, warps_, paints_;
  std::size_t size_ = 0;
  std::vector<std::array<std::vector<double>, 3>> warp_;  ///< of each vertex: the modes along x, y, z
  std::vector<std::vector<double>> paint_;                ///< of each texel: those of a colour
};

}  // namespace mirage
