#include "sensors/material.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

namespace mirage {
namespace {

constexpr double kAlpha2 = kRoughness * kRoughness * kRoughness * kRoughness;

/// For numbers or Eigen arrays.
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

/// π f_s max(0, n·l) for positive n·l and n·v.
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

/// Mean over the half space of `response` for a direction l about the normal z and a camera at that cosine,
/// on a raster fine enough for lobes this wide.
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

/// A function of a cosine in [0, 1], interpolated between values at even steps.
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

// Integer lattice hash → [0, 1). A texture, not a random stream: it must be a pure function of position.
float lattice(int x, int y, int z, std::uint32_t seed) {
  std::uint32_t h = seed * 0x9e3779b9u + static_cast<std::uint32_t>(x) * 0x85ebca6bu;
  h = (h ^ (h >> 15)) * 0x2c1b3c6du + static_cast<std::uint32_t>(y) * 0xc2b2ae35u;
  h = (h ^ (h >> 13)) * 0x297a2d39u + static_cast<std::uint32_t>(z) * 0x27d4eb2fu;
  h = (h ^ (h >> 16)) * 0x45d9f3bu;
  return static_cast<float>((h ^ (h >> 16)) >> 8) * 0x1p-24f;
}

// Tri-linear value noise in [0, 1].
float noise(const Vec3f& p, std::uint32_t seed) {
  const float fx = std::floor(p.x()), fy = std::floor(p.y()), fz = std::floor(p.z());
  const int x = static_cast<int>(fx), y = static_cast<int>(fy), z = static_cast<int>(fz);
  const auto smooth = [](float t) { return t * t * (3 - 2 * t); };
  const float u = smooth(p.x() - fx), v = smooth(p.y() - fy), w = smooth(p.z() - fz);
  const auto row = [&](int dy, int dz) {
    return std::lerp(lattice(x, y + dy, z + dz, seed), lattice(x + 1, y + dy, z + dz, seed), u);
  };
  return std::lerp(std::lerp(row(0, 0), row(1, 0), v), std::lerp(row(0, 1), row(1, 1), v), w);
}

// Detail of a given size fades once a pixel covers it.
float keep(float size, float footprint) {
  return std::clamp(1.5f - footprint / size, 0.f, 1.f);
}

float wave(const Vec3f& p, float size, std::uint32_t seed, float footprint) {
  const float k = keep(size, footprint);
  return k > 0 ? (noise(p / size, seed) - 0.5f) * k : 0.f;
}

float cell(float x, float period) {
  return x - period * std::floor(x / period);
}

// Position of a point of a facade: its window, and its distance from the pane's edge.
struct FacadePlace {
  float v;        // height over the ground (m)
  float x, z;     // from the window's middle, from its sill (m)
  float w, h;     // the pane's size (m)
  float outside;  // distance to the pane: below 0 within
  int column, row;
  float storey;
};

FacadePlace facade_place(const Material& m, const Vec3f& p, const Vec3f& n) {
  FacadePlace a;
  const Vec3f side = Vec3f(-n.y(), n.x(), 0).normalized();
  const float u = p.dot(side), width = 2.2f + 1.4f * lattice(1, 0, 0, m.variant);
  a.v = p.z() - m.foot;
  a.storey = 2.9f + 0.8f * lattice(2, 0, 0, m.variant);
  a.w = width * (0.35f + 0.25f * lattice(3, 0, 0, m.variant)), a.h = a.storey * 0.55f;
  a.x = cell(u, width) - 0.5f * width, a.z = cell(a.v - 0.9f, a.storey);
  a.outside = std::max(std::abs(a.x) - 0.5f * a.w, std::max(-a.z, a.z - a.h));
  a.column = static_cast<int>(std::floor(u / width));
  a.row = static_cast<int>(std::floor((a.v - 0.9f) / a.storey));
  return a;
}

constexpr float kFrame = 0.07f, kReveal = 0.13f;  // m

Vec3f facade(const Material& m, const Vec3f& p, const Vec3f& n, float footprint) {
  if (std::abs(n.z()) > 0.5f) return 0.6f * m.albedo;  // roofs and sills
  const FacadePlace a = facade_place(m, p, n);
  Vec3f wall = m.albedo * (1 + 0.25f * wave(p, 1.5f, m.variant, footprint) +
                           0.2f * wave(p, 0.2f, m.variant + 7, footprint));
  // Occasionally a door instead of the ground floor's window.
  if (a.v < 2.25f && lattice(a.column, 0, 9, m.variant) > 0.82f && std::abs(a.x) < 0.55f) {
    if (std::abs(a.x) > 0.45f || a.v > 2.15f) return Vec3f::Constant(0.4f);
    const float tone = 0.06f + 0.2f * lattice(a.column, 1, 9, m.variant);
    const bool panel = std::abs(a.x) < 0.3f && cell(a.v - 0.2f, 0.9f) < 0.65f;
    return (panel ? 0.7f : 1.f) * Vec3f(tone, 0.7f * tone, 0.5f * tone);
  }
  if (a.v < 0.7f) return 0.6f * wall;  // plinth
  if (a.outside < 0) {
    // The pane is recessed in the wall: lintel and reveal shade its upper edge.
    const float shade = a.z > a.h - kReveal ? 0.35f : 1.f;
    if (a.outside > -kFrame || std::abs(a.x) < 0.03f) return Vec3f::Constant(0.55f * shade);  // frame
    const float curtain = lattice(a.column, a.row, 5, m.variant);
    if (curtain > 0.75f && a.z > a.h * (curtain - 0.2f)) return Vec3f::Constant(0.3f * shade);
    return m.second * (0.5f + curtain) * shade;
  }
  if (a.z > a.storey - 0.07f && std::abs(a.x) < 0.5f * a.w + 0.1f) return Vec3f::Constant(0.4f);  // sill
  if (a.outside < 0.12f) return 0.8f * wall + Vec3f::Constant(0.08f);                             // surround
  if (cell(a.v, a.storey) < 0.12f) return 0.75f * wall;
  return wall;
}

Vec3f brick(const Material& m, const Vec3f& p, const Vec3f& n, float footprint) {
  if (std::abs(n.z()) > 0.5f) return m.albedo;
  const Vec3f side = Vec3f(-n.y(), n.x(), 0).normalized();
  const float k = keep(0.06f, footprint);
  const int row = static_cast<int>(std::floor(p.z() / 0.075f));
  const float u = p.dot(side) + (row & 1 ? 0.12f : 0.f);
  const int column = static_cast<int>(std::floor(u / 0.24f));
  const bool joint = cell(p.z(), 0.075f) < 0.012f || cell(u, 0.24f) < 0.012f;
  const Vec3f mean = 0.75f * m.albedo + 0.25f * m.second;
  const Vec3f here = joint ? m.second : Vec3f(m.albedo * (0.8f + 0.4f * lattice(column, row, 0, m.variant)));
  return (mean + k * (here - mean)) * (1 + 0.3f * wave(p, 0.8f, m.variant, footprint));
}

Vec3f paving(const Material& m, const Vec3f& p, float footprint) {
  const float size = m.variant % 3 == 0 ? 0.2f : 0.45f;
  const int row = static_cast<int>(std::floor(p.y() / size));
  const float u = p.x() + (row & 1 ? 0.5f * size : 0.f);
  const bool joint = cell(p.y(), size) < 0.02f || cell(u, size) < 0.02f;
  const float tone = 0.85f + 0.3f * lattice(static_cast<int>(std::floor(u / size)), row, 0, m.variant);
  const float k = keep(size * 0.5f, footprint);
  const float pattern = std::lerp(0.97f, joint ? 0.55f : tone, k);
  return m.albedo * pattern * (1 + 0.4f * wave(p, 2.f, m.variant, footprint));
}

Vec3f asphalt(const Material& m, const Vec3f& p, float footprint) {
  float tone =
      1 + 0.25f * wave(p, 6.f, m.variant, footprint) + 0.2f * wave(p, 1.1f, m.variant + 1, footprint) +
      0.25f * wave(p, 0.12f, m.variant + 2, footprint) + 0.35f * wave(p, 0.03f, m.variant + 3, footprint);
  // Repaired patches and tar-sealed cracks.
  if (lattice(static_cast<int>(std::floor(p.x() / 7)), static_cast<int>(std::floor(p.y() / 1.9f)), 0,
              m.variant) > 0.9f)
    tone *= 0.75f;
  const float crack =
      std::abs(noise(p * 0.22f, m.variant + 9) - 0.5f + 0.25f * (noise(p * 1.3f, m.variant + 10) - 0.5f));
  if (m.variant % 3 == 0 && crack < 0.006f * keep(0.1f, 0.5f * footprint)) tone *= 0.55f;
  return m.albedo * std::max(tone, 0.2f);
}

// Cartons, bales or crates in rows, staggered from layer to layer; on top as laid on the ground.
Vec3f stack(const Material& m, const Vec3f& p, const Vec3f& n, float footprint) {
  const float across = 0.3f + 0.35f * lattice(1, 0, 0, m.variant),
              high = 0.2f + 0.25f * lattice(2, 0, 0, m.variant);
  const bool top = std::abs(n.z()) > 0.75f;
  const float step = top ? across : high, v = top ? p.y() : p.z();
  const int row = static_cast<int>(std::floor(v / step));
  const float u =
      (top || std::abs(n.y()) > std::abs(n.x()) ? p.x() : p.y()) + (row & 1 ? 0.5f * across : 0.f);
  const int column = static_cast<int>(std::floor(u / across));
  const bool joint = cell(v, step) < 0.025f || cell(u, across) < 0.025f;
  const Vec3f mean = 0.85f * m.albedo + 0.15f * m.second;
  const Vec3f here = joint ? m.second : Vec3f(m.albedo * (0.75f + 0.5f * lattice(column, row, 0, m.variant)));
  return (mean + keep(0.12f, footprint) * (here - mean)) * (1 + 0.35f * wave(p, 0.05f, m.variant, footprint));
}

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

float surface_gloss(const Material& m, const Vec3f& p, const Vec3f& n) {
  if (m.veiled) return 0;
  if (m.pattern != Pattern::facade || std::abs(n.z()) > 0.5f) return m.gloss;
  const FacadePlace a = facade_place(m, p, n);
  const bool pane = a.outside < -kFrame && a.v > 0.7f && std::abs(a.x) > 0.03f;
  return pane ? 0.07f : m.gloss;
}

Vec3f surface_albedo(const Material& m, const Vec3f& p, const Vec3f& n, float footprint) {
  switch (m.pattern) {
    case Pattern::plain:
      return m.albedo;
    case Pattern::asphalt:
      return asphalt(m, p, footprint);
    case Pattern::paving:
      return paving(m, p, footprint);
    case Pattern::facade:
      return facade(m, p, n, footprint);
    case Pattern::brick:
      return brick(m, p, n, footprint);
    case Pattern::stack:
      return stack(m, p, n, footprint);
    case Pattern::cloth: {  // folds that hang down, dirt and faded places
      const Vec3f hanging(p.x() * 6, p.y() * 6, p.z() * 1.1f);
      const float folds = (noise(hanging, m.variant) - 0.5f) * keep(0.17f, footprint);
      const float tone = 1 + 0.7f * folds + 0.35f * wave(p, 0.8f, m.variant + 1, footprint) +
                         0.3f * wave(p, 0.1f, m.variant + 2, footprint);
      return m.albedo * std::max(tone, 0.2f);
    }
    case Pattern::grass: {
      const float tone =
          1 + 0.9f * wave(p, 0.07f, m.variant, footprint) + 0.5f * wave(p, 0.6f, m.variant + 1, footprint);
      const float dry = std::clamp(0.5f + 1.6f * wave(p, 3.f, m.variant + 2, footprint), 0.f, 1.f);
      return (m.albedo + dry * (m.second - m.albedo)) * std::max(tone, 0.1f);
    }
    case Pattern::foliage: {
      const float tone =
          1 + 1.1f * wave(p, 0.12f, m.variant, footprint) + 0.7f * wave(p, 0.7f, m.variant + 1, footprint);
      const float mix = std::clamp(0.5f + 1.5f * wave(p, 1.6f, m.variant + 2, footprint), 0.f, 1.f);
      return (m.albedo + mix * (m.second - m.albedo)) * std::max(tone, 0.1f);
    }
    case Pattern::bark: {
      const Vec3f stretched(p.x() * 12, p.y() * 12, p.z() * 2);
      return m.albedo * (0.6f + 0.8f * noise(stretched, m.variant) * keep(0.1f, footprint) +
                         0.4f * (1 - keep(0.1f, footprint)));
    }
    case Pattern::grille: {
      const float k = keep(0.03f, footprint);
      return m.albedo * (1 + k * (cell(p.z(), 0.045f) < 0.012f ? 1.5f : -0.5f));
    }
  }
  return m.albedo;
}

}  // namespace mirage
