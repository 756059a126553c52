#include "sensors/gloss.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

namespace mirage {
namespace {

constexpr double kAlpha2 = kRoughness * kRoughness * kRoughness * kRoughness;

/// Of numbers or Eigen's arrays of them.
template <class A>
A reflectance(const A& cosine) {
  using S = typename A::Scalar;
  const A g = (static_cast<S>(kRefractiveIndex * kRefractiveIndex - 1) + cosine.square()).sqrt(),
          a = (g - cosine) / (g + cosine), b = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1);
  return S(0.5) * a.square() * (1 + b.square());
}

/// 1 + 2Λ of Smith's shadowing for GGX.
template <class A>
A shadowing(const A& cosine) {
  using S = typename A::Scalar;
  return (1 + static_cast<S>(kAlpha2) * (1 / cosine.square() - 1)).sqrt();
}

/// π f_s max(0, n·l), wherever n·l and n·v are positive.
template <class A>
A response(const A& nl, const A& nv, const A& lv) {
  using S = typename A::Scalar;
  const A sum2 = (2 + 2 * lv).max(std::numeric_limits<S>::min()),  // |l + v|²
      spread = 1 + (nl + nv).square() / sum2 * static_cast<S>(kAlpha2 - 1),
          d = static_cast<S>(kAlpha2) / spread.square(), g = 2 / (shadowing(nl) + shadowing(nv)),
          half = (sum2.sqrt() / 2).min(S(1));
  return d * g * reflectance(half) / (4 * nv);
}

using One = Eigen::Array<double, 1, 1>;

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
  return reflectance(One(cosine)).value();
}

double specular_response(double nl, double nv, double lv) {
  return nl > 0 && nv > 0 ? response(One(nl), One(nv), One(lv)).value() : 0;
}

void specular_response(std::span<const float> nl, std::span<const float> nv, std::span<const float> lv,
                       std::span<float> responses) {
  using Eight = Eigen::Array<float, 8, 1>;
  constexpr std::size_t kEight = 8;
  for (std::size_t at = 0; at < responses.size(); at += kEight) {
    const std::size_t count = std::min(kEight, responses.size() - at);
    Eight n_l = Eight::Zero(), n_v = n_l, l_v = n_l;
    std::copy_n(&nl[at], count, n_l.data());
    std::copy_n(&nv[at], count, n_v.data());
    std::copy_n(&lv[at], count, l_v.data());
    const Eight of = (n_l > 0 && n_v > 0).select(response(n_l, n_v, l_v), 0);
    std::copy_n(of.data(), count, &responses[at]);
  }
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
