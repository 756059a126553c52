#include "sensors/soft_rasterizer.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace mirage {
namespace {

/// Screen-space geometry of one face that does not depend on the pixel.
template <class S>
struct FaceSetup {
  bool usable = false;
  Vec2<S> v[3];
  S z[3];
  Eigen::Matrix<S, 3, 3> barycentric;  ///< rows (x, y, 1) coefficients: b = barycentric · (x, y, 1)
  S altitude = 0;                      ///< smallest altitude on screen, NDC
  S low_x, high_x, low_y, high_y;      ///< bounding box grown by √T
};

/// One (pixel, face) pair that counts.
template <class S>
struct Fragment {
  int face = -1;
  S sign = 1;                 ///< δ
  Vec2<S> offset;             ///< p − nearest boundary point
  int edge = 0;               ///< boundary edge (from vertex edge to edge + 1)
  S along = 0;                ///< position on it, [0, 1]
  S coverage = 0;             ///< D
  Vec3<S> clipped;            ///< clipped and normalised barycentrics
  Vec3<S> raw;                ///< barycentrics before clipping
  S z = 0, normalized_z = 0;  ///< z and z̄
  bool colored = false;       ///< near ≤ z ≤ far
  int texel = 0;              ///< index into texels
  S weight = 0;               ///< w (paper) or share among faces (silhouette)
};

template <class S>
S cutoff(const SoftRasterSettings<S>& settings) {
  return settings.sigma * std::log(1 / settings.dist_eps - 1);
}

template <class S>
FaceSetup<S> set_up(const std::array<Vec3<S>, 3>& face, const SoftRasterSettings<S>& settings) {
  FaceSetup<S> setup;
  for (int k = 0; k < 3; ++k) {
    if (!face[k].allFinite() || !(face[k].z() > 0)) return setup;
    setup.v[k] = face[k].template head<2>();
    setup.z[k] = face[k].z();
  }
  const Vec2<S>* v = setup.v;
  const S twice_area = (v[1] - v[0]).x() * (v[2] - v[0]).y() - (v[1] - v[0]).y() * (v[2] - v[0]).x();
  if (!settings.double_sided && twice_area <= 0) return setup;
  const S longest = std::sqrt(
      std::max({(v[1] - v[0]).squaredNorm(), (v[2] - v[1]).squaredNorm(), (v[0] - v[2]).squaredNorm()}));
  setup.altitude = longest > 0 ? std::abs(twice_area) / longest : 0;
  // A face without area on screen covers nothing and has no barycentrics.
  if (!(setup.altitude > std::numeric_limits<S>::epsilon() * S(16))) return setup;
  for (int k = 0; k < 3; ++k) {
    const Vec2<S>&a = v[(k + 1) % 3], &b = v[(k + 2) % 3];
    setup.barycentric.row(k) << (a.y() - b.y()) / twice_area, (b.x() - a.x()) / twice_area,
        (a.x() * b.y() - a.y() * b.x()) / twice_area;
  }
  const S reach = std::sqrt(cutoff(settings));
  setup.low_x = std::min({v[0].x(), v[1].x(), v[2].x()}) - reach;
  setup.high_x = std::max({v[0].x(), v[1].x(), v[2].x()}) + reach;
  setup.low_y = std::min({v[0].y(), v[1].y(), v[2].y()}) - reach;
  setup.high_y = std::max({v[0].y(), v[1].y(), v[2].y()}) + reach;
  setup.usable = true;
  return setup;
}

template <class S>
S sigmoid(S x) {
  return x >= 0 ? 1 / (1 + std::exp(-x)) : std::exp(x) / (1 + std::exp(x));
}

/// The fragment of `face` at pixel centre p, or false when it is skipped.
template <class S>
bool make_fragment(const FaceSetup<S>& setup, int face, const Vec2<S>& p, S limit, const ScreenMesh<S>& mesh,
                   const SoftRasterSettings<S>& settings, Fragment<S>& fragment) {
  if (p.x() < setup.low_x || p.x() > setup.high_x || p.y() < setup.low_y || p.y() > setup.high_y)
    return false;
  S nearest = std::numeric_limits<S>::infinity();
  for (int k = 0; k < 3; ++k) {
    const Vec2<S>& a = setup.v[k];
    const Vec2<S> edge = setup.v[(k + 1) % 3] - a;
    const S t = std::clamp((p - a).dot(edge) / edge.squaredNorm(), S(0), S(1));
    const Vec2<S> offset = p - (a + t * edge);
    if (offset.squaredNorm() < nearest) {
      nearest = offset.squaredNorm();
      fragment.edge = k;
      fragment.along = t;
      fragment.offset = offset;
    }
  }
  fragment.raw = setup.barycentric * Vec3<S>(p.x(), p.y(), 1);
  const bool inside = fragment.raw.minCoeff() >= 0;
  if (!inside && nearest >= cutoff(settings)) return false;
  fragment.face = face;
  fragment.sign = inside ? S(1) : S(-1);
  fragment.coverage = sigmoid(fragment.sign * nearest / settings.sigma);

  Vec3<S> clipped = fragment.raw.cwiseMax(S(0)).cwiseMin(S(1));
  clipped /= std::max(clipped.sum(), S(1e-5));
  fragment.clipped = clipped;
  const Vec3<S> over_z(clipped[0] / setup.z[0], clipped[1] / setup.z[1], clipped[2] / setup.z[2]);
  fragment.z = 1 / over_z.sum();
  if (fragment.z > limit) return false;
  fragment.normalized_z = (settings.far - fragment.z) / (settings.far - settings.near);
  fragment.colored = fragment.z >= settings.near && fragment.z <= settings.far;
  const Vec3<S> lookup = settings.perspective_texture ? Vec3<S>(over_z * fragment.z) : clipped;
  fragment.texel =
      face * mesh.resolution * mesh.resolution + texel_index(lookup[0], lookup[1], mesh.resolution);
  return true;
}

/// The soft blend at one pixel. Fills the fragments' weights.
template <class S>
struct Blend {
  S background_weight = 1;  ///< of the background (paper) or 1 − S (silhouette)
  S silhouette = 0;
  Vec3<S> color = Vec3<S>::Zero();        ///< I
  Vec3<S> among_faces = Vec3<S>::Zero();  ///< colour among faces (silhouette mode)
  S sum = 0;                              ///< normaliser, relative to exp(top)
  S top = 0;                              ///< running maximum of the logits
};

template <class S>
Blend<S> blend(std::vector<Fragment<S>>& fragments, const ScreenMesh<S>& mesh,
               const SoftRasterSettings<S>& settings, const Vec3<S>& background) {
  Blend<S> result;
  S transparent = 1;
  for (const auto& f : fragments) transparent *= 1 - f.coverage;
  result.silhouette = 1 - transparent;

  const bool logit_mode = settings.background != Background::silhouette;
  const S background_logit =
      (settings.background == Background::authors_logit ? 2 : 1) * settings.epsilon / settings.gamma;
  result.top = logit_mode ? background_logit : -std::numeric_limits<S>::infinity();
  for (const auto& f : fragments)
    if (f.colored) result.top = std::max(result.top, f.normalized_z / settings.gamma);
  S sum = logit_mode ? std::exp(background_logit - result.top) : S(0);
  const S background_mass = sum;
  for (auto& f : fragments) {
    f.weight = f.colored ? f.coverage * std::exp(f.normalized_z / settings.gamma - result.top) : S(0);
    sum += f.weight;
  }
  result.sum = sum;
  if (!(sum > 0)) {  // silhouette mode with no coloured fragment
    result.color = background;
    result.background_weight = 1;
    return result;
  }
  Vec3<S> color = Vec3<S>::Zero();
  for (auto& f : fragments) {
    f.weight /= sum;
    if (f.weight > 0) color += f.weight * mesh.texels[f.texel];
  }
  if (logit_mode) {
    result.background_weight = background_mass / sum;
    result.color = color + result.background_weight * background;
  } else {
    result.among_faces = color;
    result.background_weight = transparent;
    result.color = result.silhouette * color + transparent * background;
  }
  return result;
}

/// Calls visit(u, v, fragments) for every pixel of the window that meets a face, fragments in face order.
template <class S, class Visit>
void for_each_pixel(const ScreenMesh<S>& mesh, const std::vector<FaceSetup<S>>& setups,
                    const SoftRasterSettings<S>& settings, const RasterTarget<S>& target,
                    const Visit& visit) {
  const PixelRect& rect = target.rect;
  const S half_longer = S(std::max(target.width, target.height)) / 2;
  // Faces by row, so that a pixel looks only at faces whose rows include it.
  std::vector<std::vector<int>> rows(rect.height());
  for (std::size_t j = 0; j < setups.size(); ++j) {
    if (!setups[j].usable) continue;
    const S v_low = (S(target.height) - 1) / 2 - setups[j].high_y * half_longer;
    const S v_high = (S(target.height) - 1) / 2 - setups[j].low_y * half_longer;
    const int from = static_cast<int>(std::floor(std::clamp(v_low, S(rect.v0), S(rect.v1))));
    const int to = static_cast<int>(std::ceil(std::clamp(v_high, S(rect.v0) - 1, S(rect.v1) - 1)));
    for (int v = std::max(from, rect.v0); v <= std::min(to, rect.v1 - 1); ++v)
      rows[v - rect.v0].push_back(static_cast<int>(j));
  }
  std::vector<Fragment<S>> fragments;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u) {
      fragments.clear();
      const Vec2<S> p = ndc_from_pixel(S(u), S(v), target.width, target.height);
      const S limit = target.depth_limit.empty() ? std::numeric_limits<S>::infinity()
                                                 : target.depth_limit.at(u - rect.u0, v - rect.v0);
      Fragment<S> fragment;
      for (int j : rows[v - rect.v0])
        if (make_fragment(setups[j], j, p, limit, mesh, settings, fragment)) fragments.push_back(fragment);
      if (!fragments.empty()) visit(u - rect.u0, v - rect.v0, fragments);
    }
}

template <class S>
std::vector<FaceSetup<S>> set_up_all(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings) {
  std::vector<FaceSetup<S>> setups;
  setups.reserve(mesh.faces.size());
  for (const auto& face : mesh.faces) setups.push_back(set_up(face, settings));
  return setups;
}

template <class S>
Vec3<S> background_at(const RasterTarget<S>& target, int u, int v) {
  const S* pixel = target.background.pixel(u, v);
  return {pixel[0], pixel[1], pixel[2]};
}

/// d loss / d coverage of each fragment through the silhouette: d_silhouette · Π_{k ≠ j} (1 − D_k), by prefix
/// and suffix products so that D = 1 is no division by zero.
template <class S>
void add_silhouette_gradient(const std::vector<Fragment<S>>& fragments, S d_silhouette,
                             std::vector<S>& d_coverage) {
  const std::size_t n = fragments.size();
  std::vector<S> after(n + 1, S(1));
  for (std::size_t j = n; j-- > 0;) after[j] = after[j + 1] * (1 - fragments[j].coverage);
  S before = 1;
  for (std::size_t j = 0; j < n; ++j) {
    d_coverage[j] += d_silhouette * before * after[j + 1];
    before *= 1 - fragments[j].coverage;
  }
}

/// d loss / d D and d loss / d z̄ of one fragment → its face's vertices.
template <class S>
void fragment_vjp(const Fragment<S>& f, const FaceSetup<S>& setup, const SoftRasterSettings<S>& settings,
                  S d_coverage, S d_normalized_z, std::array<Vec3<S>, 3>& d_face) {
  // Distance: d² = |p − q|² with q the nearest boundary point; by the envelope theorem q's place on the edge
  // is constant.
  const S d_distance2 = d_coverage * f.coverage * (1 - f.coverage) * f.sign / settings.sigma;
  if (d_distance2 != 0) {
    const Vec2<S> push = -2 * d_distance2 * f.offset;
    d_face[f.edge].template head<2>() += (1 - f.along) * push;
    d_face[(f.edge + 1) % 3].template head<2>() += f.along * push;
  }
  if (d_normalized_z == 0) return;
  // Depth: z = 1 / Σ b_k / z_k.
  const S d_z = -d_normalized_z / (settings.far - settings.near);
  const S z2 = f.z * f.z;
  Vec3<S> d_clipped;
  for (int k = 0; k < 3; ++k) {
    d_face[k].z() += d_z * z2 * f.clipped[k] / (setup.z[k] * setup.z[k]);
    d_clipped[k] = -d_z * z2 / setup.z[k];
  }
  if (settings.frozen_barycentrics) return;
  // clipped = c / max(Σ c, 1e-5), c = clamp(raw).
  const Vec3<S> c = f.raw.cwiseMax(S(0)).cwiseMin(S(1));
  const S total = std::max(c.sum(), S(1e-5));
  const S common = c.sum() > S(1e-5) ? d_clipped.dot(f.clipped) : S(0);
  Vec3<S> d_raw;
  for (int k = 0; k < 3; ++k)
    d_raw[k] = f.raw[k] > 0 && f.raw[k] < 1 ? (d_clipped[k] - common) / total : S(0);
  d_raw *= std::min(S(1), setup.altitude / settings.edge_on_altitude);
  // raw solves Σ raw_k v_k = p, Σ raw_k = 1, so d raw_k / d v_m = −raw_m ∇raw_k.
  Vec2<S> slope = Vec2<S>::Zero();
  for (int k = 0; k < 3; ++k) slope += d_raw[k] * Vec2<S>(setup.barycentric(k, 0), setup.barycentric(k, 1));
  for (int m = 0; m < 3; ++m) d_face[m].template head<2>() -= f.raw[m] * slope;
}

}  // namespace

template <class S>
int texel_index(S b0, S b1, int resolution) {
  const S x = b0 * S(resolution), y = b1 * S(resolution);
  const int last = resolution - 1;
  const int ix = std::clamp(static_cast<int>(x), 0, last), iy = std::clamp(static_cast<int>(y), 0, last);
  // On the far edge x + y − ix − iy is 1 up to rounding: a tolerance picks the lower half.
  if (x + y - S(ix) - S(iy) <= 1 + S(64) * std::numeric_limits<S>::epsilon() * S(resolution))
    return iy * resolution + ix;
  return (last - iy) * resolution + (last - ix);
}

template <class S>
PixelRect touched_pixels(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings, int width,
                         int height, const PixelRect& clip) {
  const S half_longer = S(std::max(width, height)) / 2;
  S low_u = S(clip.u1), high_u = S(clip.u0) - 1, low_v = S(clip.v1), high_v = S(clip.v0) - 1;
  for (const auto& face : mesh.faces) {
    const FaceSetup<S> setup = set_up(face, settings);
    if (!setup.usable) continue;
    low_u = std::min(low_u, setup.low_x * half_longer + (S(width) - 1) / 2);
    high_u = std::max(high_u, setup.high_x * half_longer + (S(width) - 1) / 2);
    low_v = std::min(low_v, (S(height) - 1) / 2 - setup.high_y * half_longer);
    high_v = std::max(high_v, (S(height) - 1) / 2 - setup.low_y * half_longer);
  }
  PixelRect rect;
  rect.u0 = static_cast<int>(std::floor(std::clamp(low_u, S(clip.u0), S(clip.u1))));
  rect.v0 = static_cast<int>(std::floor(std::clamp(low_v, S(clip.v0), S(clip.v1))));
  rect.u1 = static_cast<int>(std::ceil(std::clamp(high_u, S(clip.u0) - 1, S(clip.u1) - 1))) + 1;
  rect.v1 = static_cast<int>(std::ceil(std::clamp(high_v, S(clip.v0) - 1, S(clip.v1) - 1))) + 1;
  return rect;
}

template <class S>
Image<S> rasterize(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings,
                   const RasterTarget<S>& target) {
  const PixelRect& rect = target.rect;
  Image<S> rgba(rect.width(), rect.height(), 4);
  for (int v = 0; v < rect.height(); ++v)
    for (int u = 0; u < rect.width(); ++u)
      for (int c = 0; c < 3; ++c) rgba.at(u, v, c) = target.background.at(u, v, c);
  const auto setups = set_up_all(mesh, settings);
  for_each_pixel(mesh, setups, settings, target, [&](int u, int v, std::vector<Fragment<S>>& fragments) {
    const Blend<S> result = blend(fragments, mesh, settings, background_at(target, u, v));
    for (int c = 0; c < 3; ++c) rgba.at(u, v, c) = result.color[c];
    rgba.at(u, v, 3) = result.silhouette;
  });
  return rgba;
}

template <class S>
ScreenGradient<S> rasterize_vjp(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings,
                                const RasterTarget<S>& target, const Image<S>& d_rgba) {
  ScreenGradient<S> gradient;
  gradient.faces.assign(mesh.faces.size(), {Vec3<S>::Zero(), Vec3<S>::Zero(), Vec3<S>::Zero()});
  gradient.texels.assign(mesh.texels.size(), Vec3<S>::Zero());
  const auto setups = set_up_all(mesh, settings);
  std::vector<S> d_coverage;
  for_each_pixel(mesh, setups, settings, target, [&](int u, int v, std::vector<Fragment<S>>& fragments) {
    const Vec3<S> background = background_at(target, u, v);
    const Blend<S> result = blend(fragments, mesh, settings, background);
    Vec3<S> d_color(d_rgba.at(u, v, 0), d_rgba.at(u, v, 1), d_rgba.at(u, v, 2));
    S d_silhouette = d_rgba.at(u, v, 3);
    const bool logit_mode = settings.background != Background::silhouette;
    // Among what the weights are shared: faces and background (paper) or faces alone (silhouette mode).
    Vec3<S> mean = result.color;
    const bool any_color = result.sum > 0;
    if (!logit_mode && any_color) {
      d_silhouette += d_color.dot(result.among_faces - background);
      d_color *= result.silhouette;
      mean = result.among_faces;
    }
    d_coverage.assign(fragments.size(), S(0));
    if (d_silhouette != 0) add_silhouette_gradient(fragments, d_silhouette, d_coverage);
    const S mean_gain = d_color.dot(mean);
    for (std::size_t j = 0; j < fragments.size(); ++j) {
      const Fragment<S>& f = fragments[j];
      S d_normalized_z = 0;
      if (any_color && f.colored) {
        gradient.texels[f.texel] += f.weight * d_color;
        const S advantage = d_color.dot(mesh.texels[f.texel]) - mean_gain;
        // w / D without dividing: D may underflow where the weight does not.
        d_coverage[j] += std::exp(f.normalized_z / settings.gamma - result.top) / result.sum * advantage;
        d_normalized_z = f.weight * advantage / settings.gamma;
      }
      fragment_vjp(f, setups[f.face], settings, d_coverage[j], d_normalized_z, gradient.faces[f.face]);
    }
  });
  return gradient;
}

#define MIRAGE_INSTANTIATE(S)                                                                        \
  template int texel_index<S>(S, S, int);                                                            \
  template PixelRect touched_pixels<S>(const ScreenMesh<S>&, const SoftRasterSettings<S>&, int, int, \
                                       const PixelRect&);                                            \
  template Image<S> rasterize<S>(const ScreenMesh<S>&, const SoftRasterSettings<S>&,                 \
                                 const RasterTarget<S>&);                                            \
  template ScreenGradient<S> rasterize_vjp<S>(const ScreenMesh<S>&, const SoftRasterSettings<S>&,    \
                                              const RasterTarget<S>&, const Image<S>&);
MIRAGE_INSTANTIATE(float)
MIRAGE_INSTANTIATE(double)
#undef MIRAGE_INSTANTIATE

}  // namespace mirage
