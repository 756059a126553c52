// One LiDAR return on a triangle: Möller–Trumbore in a known face, and its VJP (src/README.md, LiDAR).
//
// With ray p(t) = o + t d (|d| = 1) and n = (v1 − v0) × (v2 − v0):
//     t = n·(v0 − o) / n·d,   ∂p/∂v_k = b_k · d nᵀ / (n·d)      for a fixed face.
// Reflectance is that of a Lambert surface: r = ρ |n̂·d|.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "base/types.h"

namespace mirage {

/// Smallest height of a face (m) over which its reflectance may change at the full rate.
inline constexpr double kThinFace = 1e-3;

/// A ray's return from one face.
template <class S>
struct FaceReturn {
  bool valid = false;
  S range = 0;  ///< t, metres
  Vec3<S> barycentric = Vec3<S>::Zero();
  S reflectance = 0;
};

/// Where the ray meets the face's plane, with barycentrics (Möller & Trumbore 1997). Not valid when the ray
/// lies in the plane or the face has no area. The caller knows (from Embree) that the face is the one that is
/// hit.
template <class S>
FaceReturn<S> intersect_face(const Vec3<S>& origin, const Vec3<S>& direction,
                             const std::array<Vec3<S>, 3>& face, S reflectivity) {
  FaceReturn<S> result;
  const Vec3<S> e1 = face[1] - face[0], e2 = face[2] - face[0], n = e1.cross(e2);
  const Vec3<S> p = direction.cross(e2);
  const S determinant = e1.dot(p), length = n.norm();
  if (!(std::abs(determinant) > 0) || !(length > 0)) return result;
  const Vec3<S> s = origin - face[0];
  const S b1 = s.dot(p) / determinant;
  const Vec3<S> q = s.cross(e1);
  const S b2 = direction.dot(q) / determinant;
  result.range = e2.dot(q) / determinant;
  result.barycentric = Vec3<S>(1 - b1 - b2, b1, b2);
  result.reflectance = reflectivity * std::abs(n.dot(direction)) / length;
  result.valid = true;
  return result;
}

/// d loss / d (x, y, z, reflectance) of the return → the face's vertices. The gradient of the position grows
/// as 1 / cos θ with the incidence angle; below cos θ = grazing_cosine it is scaled by (cos θ /
/// grazing_cosine), so that |∂p/∂v_k| ≤ |b_k| / grazing_cosine always. The gradient of the reflectance grows
/// as 1 / height of the face; below kThinFace it is scaled down, so that |∂r/∂v_k| ≤ 2 ρ / kThinFace always.
template <class S>
std::array<Vec3<S>, 3> intersect_face_vjp(const Vec3<S>& direction, const std::array<Vec3<S>, 3>& face,
                                          const FaceReturn<S>& hit, S reflectivity, S grazing_cosine,
                                          const Vec3<S>& d_point, S d_reflectance) {
  std::array<Vec3<S>, 3> d_face{Vec3<S>::Zero(), Vec3<S>::Zero(), Vec3<S>::Zero()};
  if (!hit.valid) return d_face;
  const Vec3<S> e1 = face[1] - face[0], e2 = face[2] - face[0], n = e1.cross(e2);
  const S facing = n.dot(direction), length = n.norm();
  if (!(length > 0)) return d_face;
  const S sign = facing >= 0 ? S(1) : S(-1);
  const Vec3<S> unit = n / length;
  const S cosine = std::max(std::abs(facing) / length, grazing_cosine);
  const Vec3<S> along_normal = unit * (sign * d_point.dot(direction) / cosine);
  for (int k = 0; k < 3; ++k) d_face[k] += hit.barycentric[k] * along_normal;
  // Reflectance: ρ |n·d| / |n|.
  const S longest = std::sqrt(std::max({e1.squaredNorm(), e2.squaredNorm(), (e2 - e1).squaredNorm()}));
  const S bound = std::min(S(1), length / longest / S(kThinFace));
  const Vec3<S> d_n =
      d_reflectance * reflectivity * sign * bound / length * (direction - unit * unit.dot(direction));
  const Vec3<S> d_e1 = e2.cross(d_n), d_e2 = d_n.cross(e1);
  d_face[0] -= d_e1 + d_e2;
  d_face[1] += d_e1;
  d_face[2] += d_e2;
  return d_face;
}

}  // namespace mirage
