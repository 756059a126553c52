#include "attack/shape_search.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "base/random.h"

namespace mirage {
namespace {

/// How much of a generation's spread is taken over: less than all, so that a few samples do not narrow the
/// search at once.
constexpr double kSpreadShare = 0.4;

/// Bernstein polynomials of degree kWarpPoints − 1 at t in [0, 1].
std::array<double, kWarpPoints> bernstein(double t) {
  std::array<double, kWarpPoints> weights{1};
  for (int degree = 1; degree < kWarpPoints; ++degree)  // de Casteljau
    for (int i = degree; i >= 0; --i) {
      auto& weight = weights[static_cast<std::size_t>(i)];
      weight =
          (i < degree ? (1 - t) * weight : 0) + (i > 0 ? t * weights[static_cast<std::size_t>(i - 1)] : 0);
    }
  return weights;
}

}  // namespace

TexturedMesh warped(const TexturedMesh& start, const AdversaryLimits& limits,
                    std::span<const double> displacements) {
  TexturedMesh shape = start;
  for (Vec3d& v : shape.mesh.vertices) {
    const Vec3d t = (v.cwiseQuotient(limits.half) + Vec3d::Ones()) / 2;
    const auto bx = bernstein(t.x()), by = bernstein(t.y()), bz = bernstein(t.z());
    std::size_t at = 0;
    for (const double x : bx)
      for (const double y : by)
        for (const double z : bz)
          for (int c = 0; c < 3; ++c) v[c] += x * y * z * displacements[at++];
  }
  project(shape, limits);
  return shape;
}

CrossEntropy::CrossEntropy(std::size_t numbers, int samples, double sigma, std::uint64_t seed)
    : samples_(samples), seed_(seed), centre_(numbers, 0.0), sigma_(numbers, sigma) {}

std::vector<double> CrossEntropy::next() const {
  RandomStream random(seed_, "shape search", told_);
  std::vector<double> at = centre_;
  for (std::size_t i = 0; i < at.size(); ++i) at[i] += sigma_[i] * random.normal();
  return at;
}

void CrossEntropy::add(double value) {
  generation_.emplace_back(value, next());
  ++told_;
  if (generation_.size() < static_cast<std::size_t>(samples_)) return;
  std::sort(generation_.begin(), generation_.end());
  const auto best = static_cast<std::size_t>(samples_ / 4);
  for (std::size_t i = 0; i < centre_.size(); ++i) {
    double mean = 0, variance = 0;
    for (std::size_t k = 0; k < best; ++k) mean += generation_[k].second[i] / static_cast<double>(best);
    for (std::size_t k = 0; k < best; ++k)
      variance += std::pow(generation_[k].second[i] - mean, 2) / static_cast<double>(best);
    centre_[i] = mean;
    sigma_[i] = (1 - kSpreadShare) * sigma_[i] + kSpreadShare * std::sqrt(variance);
  }
  generation_.clear();
}

}  // namespace mirage
