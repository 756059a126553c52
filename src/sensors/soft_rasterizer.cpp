#include "sensors/soft_rasterizer.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensors/raster/plain_fragment.h"
#include "sensors/raster/setup.h"

namespace mirage {
namespace {

using plain_raster::FaceSetup;
using plain_raster::Fragment;

/// The blend at one sample. Fills the fragments' weights.
template <class S>
struct Blend {
  S silhouette = 0, unseen = 1;           ///< S and 1 − S
  S transparent = 1;                      ///< Π(1 − D)
  bool any_color = false;                 ///< some fragment gives colour
  Vec3<S> color = Vec3<S>::Zero();        ///< I
  Vec3<S> among_faces = Vec3<S>::Zero();  ///< Σ w C, without the background
};

template <class S>
void blend_silhouette(const std::vector<Fragment<S>>& fragments, std::size_t faces, SilhouetteBlend how,
                      Blend<S>& result) {
  S sum = 0;
  bool opaque = false;
  for (const auto& f : fragments) {
    result.transparent *= f.uncovered;
    sum += f.coverage;
    opaque = opaque || f.inside;  // D > 1/2, also where D rounds to it
  }
  switch (how) {
    case SilhouetteBlend::product:
      result.silhouette = 1 - result.transparent;
      result.unseen = result.transparent;
      return;
    case SilhouetteBlend::sum:
      result.silhouette = sum / S(faces);
      break;
    case SilhouetteBlend::hard:
      result.silhouette = opaque ? 1 : 0;
      break;
  }
  result.unseen = 1 - result.silhouette;
}

/// Softmax weights of the fragments and the background; returns the background's.
template <class S>
S softmax_weights(std::vector<Fragment<S>>& fragments, const SoftRasterSettings<S>& settings) {
  const bool logit = settings.background != Background::silhouette;
  const S background = background_logit(settings);
  S top = logit ? background : -std::numeric_limits<S>::infinity();
  for (const auto& f : fragments)
    if (f.colored) top = std::max(top, f.normalized_z);
  // Subtracts before dividing: for small γ, z̄ / γ itself has no digits left after the point.
  const S background_mass = logit ? std::exp((background - top) / settings.gamma) : S(0);
  S sum = background_mass;
  for (auto& f : fragments) {
    f.weight = f.colored ? f.coverage * std::exp((f.normalized_z - top) / settings.gamma) : S(0);
    sum += f.weight;
  }
  if (!(sum > 0)) return 0;
  for (auto& f : fragments) f.weight /= sum;
  return background_mass / sum;
}

/// Weight 1 for the nearest face that contains the sample; returns the background's weight.
template <class S>
S hard_weights(std::vector<Fragment<S>>& fragments, const SoftRasterSettings<S>& settings) {
  Fragment<S>* nearest = nullptr;
  for (auto& f : fragments) {
    f.weight = 0;
    if (f.colored && f.inside && (!nearest || f.z < nearest->z)) nearest = &f;
  }
  if (nearest) nearest->weight = 1;
  return settings.background != Background::silhouette && !nearest ? 1 : 0;
}

template <class S>
Blend<S> blend(std::vector<Fragment<S>>& fragments, std::size_t faces, const SoftRasterSettings<S>& settings,
               const Vec3<S>& background) {
  Blend<S> result;
  blend_silhouette(fragments, faces, settings.silhouette, result);
  const S background_weight = settings.color == ColorBlend::softmax ? softmax_weights(fragments, settings)
                                                                    : hard_weights(fragments, settings);
  for (const auto& f : fragments)
    if (f.weight > 0) {
      result.any_color = true;
      result.among_faces += f.weight * f.color;
    }
  if (!result.any_color)
    result.color = background;
  else if (settings.background == Background::silhouette)
    result.color = result.silhouette * result.among_faces + result.unseen * background;
  else
    result.color = result.among_faces + background_weight * background;
  return result;
}

/// Throws InputError for meaningless settings.
template <class S>
void check(const SoftRasterSettings<S>& settings) {
  SoftRasterSettings<double> s;
  s.sigma = settings.sigma;
  s.gamma = settings.gamma;
  s.epsilon = settings.epsilon;
  s.dist_eps = settings.dist_eps;
  s.near = settings.near;
  s.far = settings.far;
  s.edge_on_altitude = settings.edge_on_altitude;
  raster::check_settings(s);
}

template <class S>
std::vector<FaceSetup<S>> set_up_all(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings) {
  check(settings);
  std::vector<FaceSetup<S>> setups;
  setups.reserve(mesh.faces.size());
  for (const auto& face : mesh.faces) setups.push_back(plain_raster::set_up(face, settings));
  return setups;
}

/// Calls visit(u, v, background, fragments) for every sample of window pixel (u, v) that meets a face;
/// fragments come in face order.
template <class S, class Visit>
void for_each_sample(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings,
                     const RasterTarget<S>& target, const std::vector<FaceSetup<S>>& setups,
                     const Visit& visit) {
  const int s = target.supersampling;
  std::vector<Fragment<S>> fragments;
  Fragment<S> fragment;
  for (int v = 0; v < target.rect.height(); ++v)
    for (int u = 0; u < target.rect.width(); ++u) {
      const S limit =
          target.depth_limit.empty() ? std::numeric_limits<S>::infinity() : target.depth_limit.at(u, v);
      const S* pixel = target.background.pixel(u, v);
      for (int j = 0; j < s; ++j)
        for (int i = 0; i < s; ++i) {
          const Vec2<S> p = ndc_from_pixel(S(target.rect.u0 + u) + (S(i) + S(0.5)) / S(s) - S(0.5),
                                           S(target.rect.v0 + v) + (S(j) + S(0.5)) / S(s) - S(0.5),
                                           target.width, target.height);
          fragments.clear();
          for (std::size_t f = 0; f < setups.size(); ++f)
            if (setups[f].usable && plain_raster::make_fragment(setups[f], static_cast<int>(f), p, limit,
                                                                mesh, settings, fragment))
              fragments.push_back(fragment);
          if (!fragments.empty()) visit(u, v, Vec3<S>(pixel[0], pixel[1], pixel[2]), fragments);
        }
    }
}

/// Derivative of the blend: d loss / d (I, S) of one sample → texels and faces.
template <class S>
void sample_vjp(const std::vector<Fragment<S>>& fragments, const Blend<S>& result,
                const std::vector<FaceSetup<S>>& setups, const ScreenMesh<S>& mesh,
                const SoftRasterSettings<S>& settings, const Vec3<S>& background, Vec3<S> d_color,
                S d_silhouette, ScreenGradient<S>& gradient) {
  // The mean colour under the weights: of faces and background, or of faces only.
  Vec3<S> mean = result.color;
  if (settings.background == Background::silhouette && result.any_color) {
    d_silhouette += d_color.dot(result.among_faces - background);
    d_color *= result.silhouette;
    mean = result.among_faces;
  }
  for (const auto& f : fragments) {
    plain_raster::FragmentGradient<S> d;
    // d D / d x = D (1 − D), multiplied out so that nothing is divided by 1 − D or by D.
    if (settings.coverage != Coverage::hard) {
      if (settings.silhouette == SilhouetteBlend::product)
        d.x = d_silhouette * result.transparent * f.coverage;
      else if (settings.silhouette == SilhouetteBlend::sum)
        d.x = d_silhouette * f.coverage * f.uncovered / S(mesh.faces.size());
    }
    if (f.weight > 0) {
      const Vec3<S> d_fragment = f.weight * d_color;
      if (mesh.texture == Texture::vertex)
        for (int k = 0; k < 3; ++k) {
          gradient.texels[as_size(f.texel + k)] += f.lookup[k] * d_fragment;
          d.lookup[k] = d_fragment.dot(mesh.texels[as_size(f.texel + k)]);
        }
      else
        gradient.texels[as_size(f.texel)] += d_fragment;
      if (settings.color == ColorBlend::softmax) {
        const S advantage = d_fragment.dot(f.color - mean);
        if (settings.coverage != Coverage::hard) d.x += f.uncovered * advantage;
        d.normalized_z = advantage / settings.gamma;
      }
    }
    plain_raster::fragment_vjp(f, setups[as_size(f.face)], settings, d, gradient.faces[as_size(f.face)]);
  }
}

}  // namespace

template <class S>
PixelRect touched_pixels(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings, int width,
                         int height, const PixelRect& clip) {
  const S half_longer = S(std::max(width, height)) / 2;
  S low_u = S(clip.u1), high_u = S(clip.u0) - 1, low_v = S(clip.v1), high_v = S(clip.v0) - 1;
  for (const auto& face : mesh.faces) {
    const FaceSetup<S> setup = plain_raster::set_up(face, settings);
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
  const S share = 1 / S(target.supersampling * target.supersampling);
  const auto add = [&](int u, int v, const Vec3<S>& background, std::vector<Fragment<S>>& fragments) {
    const Blend<S> result = blend(fragments, mesh.faces.size(), settings, background);
    // As a difference from the background, which the other samples keep.
    for (int c = 0; c < 3; ++c) rgba.at(u, v, c) += share * (result.color[c] - background[c]);
    rgba.at(u, v, 3) += share * result.silhouette;
  };
  for_each_sample(mesh, settings, target, set_up_all(mesh, settings), add);
  return rgba;
}

template <class S>
ScreenGradient<S> rasterize_vjp(const ScreenMesh<S>& mesh, const SoftRasterSettings<S>& settings,
                                const RasterTarget<S>& target, const Image<S>& d_rgba) {
  ScreenGradient<S> gradient;
  gradient.faces.assign(mesh.faces.size(), {Vec3<S>::Zero(), Vec3<S>::Zero(), Vec3<S>::Zero()});
  gradient.texels.assign(mesh.texels.size(), Vec3<S>::Zero());
  const auto setups = set_up_all(mesh, settings);
  const S share = 1 / S(target.supersampling * target.supersampling);
  const auto add = [&](int u, int v, const Vec3<S>& background, std::vector<Fragment<S>>& fragments) {
    const Blend<S> result = blend(fragments, mesh.faces.size(), settings, background);
    const S* d = d_rgba.pixel(u, v);
    sample_vjp(fragments, result, setups, mesh, settings, background,
               Vec3<S>(share * Vec3<S>(d[0], d[1], d[2])), share * d[3], gradient);
  };
  for_each_sample(mesh, settings, target, setups, add);
  return gradient;
}

#define MIRAGE_INSTANTIATE(S)                                                                        \
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
