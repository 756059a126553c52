#include "sensors/gloss.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace mirage {
namespace {

/// Smith's Λ of GGX.
double shadowing(double cosine, double alpha) {
  const double cosine2 = cosine * cosine;
  return (std::sqrt(1 + alpha * alpha * (1 - cosine2) / cosine2) - 1) / 2;
}

double schlick_weight(double cosine) {
  return std::pow(std::clamp(1 - cosine, 0.0, 1.0), 5);
}

constexpr int kTable = 64;

}  // namespace

double fresnel(double cosine) {
  const double g = std::sqrt(kRefractiveIndex * kRefractiveIndex - 1 + cosine * cosine),
               a = (g - cosine) / (g + cosine), b = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1);
  return 0.5 * a * a * (1 + b * b);
}

double specular_response(const Vec3d& n, const Vec3d& l, const Vec3d& v) {
  const double nl = n.dot(l), nv = n.dot(v);
  if (nl <= 0 || nv <= 0) return 0;
  const Vec3d h = (l + v).normalized();
  const double alpha = kRoughness * kRoughness, nh = n.dot(h), spread = 1 + nh * nh * (alpha * alpha - 1),
               d = alpha * alpha / (std::numbers::pi * spread * spread),
               g = 1 / (1 + shadowing(nl, alpha) + shadowing(nv, alpha));
  return std::numbers::pi * d * g * fresnel(std::min(1.0, h.dot(v))) / (4 * nv);
}

namespace {

/// The integral by a raster of the half space, which is fine enough for a lobe this wide.
double integrated_albedo(double cosine) {
  constexpr int kRings = 48, kTurns = 96;
  const double nv = std::max(cosine, 1e-3);
  const Vec3d n = Vec3d::UnitZ(), v(std::sqrt(std::max(0.0, 1 - nv * nv)), 0, nv);
  double sum = 0;
  for (int i = 0; i < kRings; ++i) {
    const double z = (i + 0.5) / kRings, r = std::sqrt(1 - z * z);
    for (int k = 0; k < kTurns; ++k) {
      const double turn = 2 * std::numbers::pi * (k + 0.5) / kTurns;
      sum += specular_response(n, Vec3d(r * std::cos(turn), r * std::sin(turn), z), v);
    }
  }
  return 2 * sum / (kRings * kTurns);  // π f_s n·l over π, times the solid angle 2π a sample
}

}  // namespace

double specular_albedo(double cosine) {
  static const std::vector<double> table = [] {
    std::vector<double> values;
    for (int i = 0; i <= kTable; ++i) values.push_back(integrated_albedo(static_cast<double>(i) / kTable));
    return values;
  }();
  const double at = kTable * std::clamp(cosine, 0.0, 1.0);
  const auto i = std::min(kTable - 1, static_cast<int>(at));
  return std::lerp(table[static_cast<std::size_t>(i)], table[static_cast<std::size_t>(i) + 1], at - i);
}

double diffuse_response(const Vec3d& n, const Vec3d& l, const Vec3d& v) {
  const double nl = n.dot(l), nv = n.dot(v);
  if (nl <= 0 || nv <= 0) return 1;
  const double d90 = 0.5 + kRoughness * (1 + l.dot(v));  // 2 cos² of half the angle between them
  return (1 + (d90 - 1) * schlick_weight(nl)) * (1 + (d90 - 1) * schlick_weight(nv));
}

}  // namespace mirage
