// One (sample, face) pair of the soft rasteriser: coverage, depth and texture lookup, and their derivative.
// Internal to soft_rasterizer.cpp; the definition is in soft_rasterizer.h.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/sizes.h"
#include "geometry/mesh.h"
#include "sensors/screen_mesh.h"

namespace mirage::plain_raster {

/// Screen-space geometry of one face that does not depend on the sample.
template <class S>
struct FaceSetup {
  bool usable = false;
  bool gives_color = false;  ///< shows one of the chosen sides
  Vec2<S> v[3];
  S z[3];
  Vec2<S> slope[3];                ///< gradient of barycentric k on screen
  S altitude = 0;                  ///< smallest altitude on screen, NDC
  S low_x, high_x, low_y, high_y;  ///< bounding box grown by √T
};

template <class S>
struct Fragment {
  int face = -1;
  bool inside = false;
  bool colored = false;           ///< gives colour: its side shows, near ≤ z ≤ far
  S coverage = 0, uncovered = 1;  ///< D and 1 − D, each by its own sigmoid
  S d_x_scale = 0;                ///< d x / d (d²) or d x / d b, where D = sigmoid(x)
  Vec2<S> offset;                 ///< euclidean: sample − nearest boundary point
  int edge = 0;                   ///< euclidean: boundary edge (from corner edge to edge + 1)
  S along = 0;                    ///< euclidean: position on it, [0, 1]
  int smallest_index = 0;         ///< barycentric: index of the smallest
  Vec3<S> raw, clipped;           ///< screen-space barycentrics before and after clipping
  Vec3<S> lookup;                 ///< texture barycentrics, within the face (part)
  S z = 0, normalized_z = 0;      ///< z and z̄
  int texel = 0;                  ///< index of the texel, or of the first of three corner colours
  Vec3<S> color;                  ///< C
  S weight = 0;                   ///< share in the colour
};

template <class S>
FaceSetup<S> set_up(const std::array<Vec3<S>, 3>& face, const SoftRasterSettings<S>& settings) {
  FaceSetup<S> setup;
  for (int k = 0; k < 3; ++k) {
    const Vec3<S>& corner = face[as_size(k)];
    if (!corner.allFinite() || !(corner.z() > 0)) return setup;
    setup.v[k] = corner.template head<2>();
    setup.z[k] = corner.z();
  }
  const Vec2<S>* v = setup.v;
  const Vec2<S> e1 = v[1] - v[0], e2 = v[2] - v[0];
  const S twice_area = e1.x() * e2.y() - e1.y() * e2.x();
  const S longest = std::sqrt(std::max({e1.squaredNorm(), (v[2] - v[1]).squaredNorm(), e2.squaredNorm()}));
  setup.altitude = longest > 0 ? std::abs(twice_area) / longest : 0;
  const S no_area = std::max(S(kNoArea), std::numeric_limits<S>::epsilon() * S(16) * S(sizeof(S) < 8));
  if (!(setup.altitude > no_area) || !std::isfinite(setup.altitude)) return setup;
  for (int k = 0; k < 3; ++k) {
    const Vec2<S>&a = v[(k + 1) % 3], &b = v[(k + 2) % 3];
    setup.slope[k] = Vec2<S>(a.y() - b.y(), b.x() - a.x()) / twice_area;
  }
  setup.gives_color =
      settings.sides == Sides::both || (settings.sides == Sides::counter_clockwise) == (twice_area > 0);
  const S reach = std::sqrt(cut_off(settings));
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

/// D = sigmoid(x) of the fragment; false if the pair is skipped.
template <class S>
bool cover(const FaceSetup<S>& setup, const Vec2<S>& p, const SoftRasterSettings<S>& settings,
           Fragment<S>& f) {
  if (settings.coverage == Coverage::hard) {
    f.coverage = 1;
    f.uncovered = 0;
    return f.inside;
  }
  S x = 0;  // signed d² or b²
  const S sign = f.inside ? S(1) : S(-1);
  if (settings.coverage == Coverage::barycentric) {
    const S smallest = f.raw.minCoeff(&f.smallest_index);
    x = sign * smallest * smallest;
    f.d_x_scale = 2 * std::abs(smallest) / settings.sigma;
  } else {
    S nearest = std::numeric_limits<S>::infinity();
    for (int k = 0; k < 3; ++k) {
      const Vec2<S> edge = setup.v[(k + 1) % 3] - setup.v[k];
      const S t = std::clamp((p - setup.v[k]).dot(edge) / edge.squaredNorm(), S(0), S(1));
      const Vec2<S> offset = p - (setup.v[k] + t * edge);
      if (offset.squaredNorm() < nearest) {
        nearest = offset.squaredNorm();
        f.edge = k;
        f.along = t;
        f.offset = offset;
      }
    }
    x = sign * nearest;
    f.d_x_scale = sign / settings.sigma;
  }
  if (-x >= cut_off(settings)) return false;
  f.coverage = sigmoid(x / settings.sigma);
  f.uncovered = sigmoid(-x / settings.sigma);
  return true;
}

/// Reads the texture at the fragment's lookup.
template <class S>
void read_texture(const ScreenMesh<S>& mesh, Fragment<S>& f) {
  if (mesh.texture == Texture::vertex) {
    f.texel = 3 * f.face;
    const auto first = mesh.texels.begin() + f.texel;
    f.color = f.lookup[0] * first[0] + f.lookup[1] * first[1] + f.lookup[2] * first[2];
    return;
  }
  Vec3<S> on_face = f.lookup;
  std::size_t owner = as_size(f.face);
  if (!mesh.texel_face.empty()) {
    const auto& corner = mesh.corner_barycentrics[owner];
    on_face = f.lookup[0] * corner[0] + f.lookup[1] * corner[1] + f.lookup[2] * corner[2];
    owner = as_size(mesh.texel_face[owner]);
  }
  f.texel = static_cast<int>(mesh.first_texel(owner)) +
            texel_index(on_face[0], on_face[1], mesh.resolution_of(owner));
  f.color = mesh.texels[as_size(f.texel)];
}

/// The fragment of face number `face` at sample p; false if it is skipped.
template <class S>
bool make_fragment(const FaceSetup<S>& setup, int face, const Vec2<S>& p, S limit, const ScreenMesh<S>& mesh,
                   const SoftRasterSettings<S>& settings, Fragment<S>& f) {
  if (p.x() < setup.low_x || p.x() > setup.high_x || p.y() < setup.low_y || p.y() > setup.high_y)
    return false;
  // From the opposite edge, so that its sign (inside or outside) is right to the last digit.
  for (int k = 0; k < 3; ++k) f.raw[k] = setup.slope[k].dot(p - setup.v[(k + 1) % 3]);
  f.inside = f.raw.minCoeff() >= 0;
  f.face = face;
  if (!cover(setup, p, settings, f)) return false;

  const Vec3<S> clipped = f.raw.cwiseMax(S(0)).cwiseMin(S(1));
  f.clipped = clipped / std::max(clipped.sum(), S(1e-5));
  const Vec3<S> over_z(f.clipped[0] / setup.z[0], f.clipped[1] / setup.z[1], f.clipped[2] / setup.z[2]);
  f.z = 1 / over_z.sum();
  if (f.z > limit) return false;
  f.normalized_z = (settings.far - f.z) / (settings.far - settings.near);
  f.colored = setup.gives_color && f.z >= settings.near && f.z <= settings.far;
  if (!f.colored) return true;
  f.lookup = settings.perspective_texture ? Vec3<S>(over_z * f.z) : f.clipped;
  read_texture(mesh, f);
  return true;
}

/// d loss / d the values of a fragment.
template <class S>
struct FragmentGradient {
  S x = 0;                           ///< d loss / d x, D = sigmoid(x)
  S normalized_z = 0;                ///< d loss / d z̄
  Vec3<S> lookup = Vec3<S>::Zero();  ///< d loss / d lookup (corner colours only)
};

/// Adds the gradient of its face's corners.
template <class S>
void fragment_vjp(const Fragment<S>& f, const FaceSetup<S>& setup, const SoftRasterSettings<S>& settings,
                  const FragmentGradient<S>& d, std::array<Vec3<S>, 3>& d_face) {
  Vec3<S> d_raw = Vec3<S>::Zero();
  if (settings.coverage == Coverage::euclidean && d.x != 0) {
    // d² = |p − q|², q the nearest boundary point; by the envelope theorem q is constant on the edge.
    const Vec2<S> push = -2 * d.x * f.d_x_scale * f.offset;
    d_face[as_size(f.edge)].template head<2>() += (1 - f.along) * push;
    d_face[as_size(f.edge + 1) % 3].template head<2>() += f.along * push;
  } else if (settings.coverage == Coverage::barycentric) {
    d_raw[f.smallest_index] = d.x * f.d_x_scale;
  }
  if (f.colored) {
    // z = 1 / Σ b_k / z_k, and lookup_k = z b_k / z_k or b_k.
    const S d_z = -d.normalized_z / (settings.far - settings.near);
    const bool frozen = settings.frozen_barycentrics;
    Vec3<S> d_over_z = Vec3<S>::Constant(-d_z * f.z * f.z), d_clipped = Vec3<S>::Zero();
    if (!frozen) {
      if (settings.perspective_texture)
        d_over_z += f.z * (d.lookup - Vec3<S>::Constant(d.lookup.dot(f.lookup)));
      else
        d_clipped += d.lookup;
    }
    for (int k = 0; k < 3; ++k) {
      d_face[as_size(k)].z() -= d_over_z[k] / setup.z[k] * (f.clipped[k] / setup.z[k]);
      d_clipped[k] += d_over_z[k] / setup.z[k];
    }
    if (!frozen) {
      // clipped = c / max(Σ c, 1e-5), c = clamp(raw).
      const S sum = f.raw.cwiseMax(S(0)).cwiseMin(S(1)).sum(), common = d_clipped.dot(f.clipped);
      for (int k = 0; k < 3; ++k)
        if (f.raw[k] > 0 && f.raw[k] < 1)
          d_raw[k] += sum > S(1e-5) ? (d_clipped[k] - common) / sum : d_clipped[k] / S(1e-5);
    }
  }
  d_raw *= std::min(S(1), setup.altitude / settings.edge_on_altitude);
  // raw solves Σ raw_k v_k = p, Σ raw_k = 1, so d raw_k / d v_m = −raw_m ∇raw_k.
  const Vec2<S> slope = d_raw[0] * setup.slope[0] + d_raw[1] * setup.slope[1] + d_raw[2] * setup.slope[2];
  for (int m = 0; m < 3; ++m) d_face[as_size(m)].template head<2>() -= f.raw[m] * slope;
}

}  // namespace mirage::plain_raster
