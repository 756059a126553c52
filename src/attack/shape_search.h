// Shapes found without a gradient: large changes of the whole, which no slope at the start foretells, and all
// there is where a detector cannot say what a return is worth.
//
// A shape is a start warped as a whole: free-form deformation (Sederberg & Parry, SIGGRAPH 1986) with n³
// control points of the box, x' = x + Σ_ijk B_i(x) B_j(y) B_k(z) d_ijk, B the Bernstein polynomials of degree
// n − 1 over the box; clamped into it. The search is the cross-entropy method (Rubinstein 1999): shapes are
// drawn from a normal distribution, which moves to the best quarter of them.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "attack/adversary.h"
#include "geometry/mesh.h"

namespace mirage {

/// Control points along a side of the box.
inline constexpr int kWarpPoints = 3;
/// Displacements of the control points, three numbers each.
inline constexpr std::size_t kWarpNumbers = 3 * kWarpPoints * kWarpPoints * kWarpPoints;

/// `start` warped by displacements (m; x, y, z of each control point, its number along x first), within the
/// limits.
TexturedMesh warped(const TexturedMesh& start, const AdversaryLimits& limits,
                    std::span<const double> displacements);

/// The lowest of a function of many numbers, given values only. What it draws depends on the seed and on the
/// values that it was told, so that it is restored by telling it the same values again.
class CrossEntropy {
 public:
  /// From zero, drawing `samples` (≥ 4) a generation with a standard deviation of `sigma` at first.
  CrossEntropy(std::size_t numbers, int samples, double sigma, std::uint64_t seed);
  /// Where the function is to be looked at now.
  std::vector<double> next() const;
  /// The function there.
  void add(double value);
  /// The centre of what is drawn now: of the best quarter of the last whole generation.
  const std::vector<double>& centre() const { return centre_; }
  /// How many values it was told.
  std::size_t told() const { return told_; }

 private:
  int samples_;
  std::uint64_t seed_;
  std::size_t told_ = 0;
  std::vector<double> centre_, sigma_;
  std::vector<std::pair<double, std::vector<double>>> generation_;
};

}  // namespace mirage
