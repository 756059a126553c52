#include "sensors/gloss.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace mirage {
namespace {

constexpr double kAlpha2 = kRoughness * kRoughness * kRoughness * kRoughness;

/// 1 + 2Λ of Smith's shadowing for GGX.
double shadowing(double cosine) {
  return std::sqrt(1 + kAlpha2 * (1 / (cosine * cosine) - 1));
}

double schlick_weight(double cosine) {
  const double m = std::clamp(1 - cosine, 0.0, 1.0);
  return m * m * m * m * m;
}

/// The mean over the half space of what `response` gives for a direction l about the normal z and a camera at
/// that cosine, by a raster that is fine enough for lobes this wide.
template <class Response>
double half_space_mean(double cosine, const Response& response) {
  constexpr int kRings = 48, kTurns = 96;
  const double nv = std::max(cosine, 1e-3);
  const Vec3d v(std::sqrt(std::max(0.0, 1 - nv * nv)), 0, nv);
  double sum = 0;
  for (int i = 0; i < kRings; ++i) {
    const double z = (i + 0.5) / kRings, r = std::sqrt(1 - z * z);
    for (int k = 0; k < kTurns; ++k) {
      const double turn = 2 * std::numbers::pi * (k + 0.5) / kTurns;
      sum += response(Vec3d(r * std::cos(turn), r * std::sin(turn), z), v);
    }
  }
  return sum / (kRings * kTurns);
}

/// A function of a cosine in [0, 1], between its values at even steps.
class CosineTable {
 public:
  template <class Function>
  explicit CosineTable(const Function& function) {
    for (std::size_t i = 0; i < values_.size(); ++i) values_[i] = function(static_cast<double>(i) / kSteps);
  }
  double operator()(double cosine) const {
    const double at = kSteps * std::clamp(cosine, 0.0, 1.0);
    const std::size_t i = std::min<std::size_t>(kSteps - 1, static_cast<std::size_t>(at));
    return std::lerp(values_[i], values_[i + 1], at - static_cast<double>(i));
  }

 private:
  static constexpr std::size_t kSteps = 64;
  std::array<double, kSteps + 1> values_{};
};

}  // namespace

double fresnel(double cosine) {
  const double g = std::sqrt(kRefractiveIndex * kRefractiveIndex - 1 + cosine * cosine),
               a = (g - cosine) / (g + cosine), b = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1);
  return 0.5 * a * a * (1 + b * b);
}

double specular_response(double nl, double nv, double lv) {
  if (nl <= 0 || nv <= 0) return 0;
  const double sum2 = std::max(2 + 2 * lv, 1e-300),  // |l + v|²
      nh2 = (nl + nv) * (nl + nv) / sum2, spread = 1 + nh2 * (kAlpha2 - 1), d = kAlpha2 / (spread * spread),
               g = 2 / (shadowing(nl) + shadowing(nv));
  return d * g * fresnel(std::min(1.0, std::sqrt(sum2) / 2)) / (4 * nv);
}

double specular_response(const Vec3d& n, const Vec3d& l, const Vec3d& v) {
  return specular_response(n.dot(l), n.dot(v), l.dot(v));
}

double diffuse_response(const Vec3d& n, const Vec3d& l, const Vec3d& v) {
  const double nl = n.dot(l), nv = n.dot(v);
  if (nl <= 0 || nv <= 0) return 1;
  const double d90 = 0.5 + kRoughness * (1 + l.dot(v));  // 2 cos² of half the angle between them
  return (1 + (d90 - 1) * schlick_weight(nl)) * (1 + (d90 - 1) * schlick_weight(nv));
}

double specular_albedo(double cosine) {
  // π f_s n·l over π, times the solid angle 2π.
  static const CosineTable table([](double at) {
    return 2 * half_space_mean(at, [](const Vec3d& l, const Vec3d& v) {
             return specular_response(Vec3d::UnitZ(), l, v);
           });
  });
  return table(cosine);
}

double diffuse_albedo(double cosine) {
  static const CosineTable table([](double at) {
    return 2 * half_space_mean(at, [](const Vec3d& l, const Vec3d& v) {
             return l.z() * diffuse_response(Vec3d::UnitZ(), l, v);
           });
  });
  return table(cosine);
}

}  // namespace mirage
