// A spinning LiDAR as data: its beams, its firings, its range limits and its mount pose.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "base/sizes.h"
#include "base/types.h"
#include "sensors/ray_caster.h"

namespace mirage {

/// One return: position in `velo` (m) and reflectance in [0, 1]. Layout as in KITTI's .bin files.
struct LidarPoint {
  float x = 0, y = 0, z = 0, reflectance = 0;
  /// Position in `velo` (m).
  Vec3f position() const { return {x, y, z}; }
};
static_assert(sizeof(LidarPoint) == 16);

/// One turn of the unit.
using Sweep = std::vector<LidarPoint>;

/// A laser of the unit. Its rays start off the unit's centre: fired at azimuth a, a ray starts `height` up
/// the axis and `lateral` to the left of its direction (a + azimuth_offset, elevation). Without the 0.2 m of
/// an HDL-64E's upper lasers, elevations would be wrong by 1.2° at 10 m.
struct LidarBeam {
  double elevation = 0;       ///< rad, positive up
  double height = 0;          ///< m
  double lateral = 0;         ///< m
  double azimuth_offset = 0;  ///< rad; includes the unit's turn until `time`
  double time = 0;            ///< s, after the first laser of its firing sequence
};

/// A ray in `velo`; `direction` is a unit vector.
struct LidarRay {
  Vec3d origin, direction;
};

/// A LiDAR unit and its mount.
struct LidarModel {
  std::string name;
  std::vector<LidarBeam> beams;  ///< from the top beam down
  double azimuth_step = 0;       ///< rad, mean between firings
  /// rad; firings happen on the encoder's grid: at the multiple of this nearest to column · azimuth_step. 0:
  /// no grid.
  double encoder_step = 0;
  double azimuth_min = 0, azimuth_max = 0;  ///< rad, firings kept (KITTI labels cover the front)
  double range_min = 0, range_max = 0;      ///< m
  double rate = 0;                          ///< revolutions per second
  int rotation = 1;                         ///< +1 counter-clockwise seen from above, −1 clockwise
  Vec2d divergence = Vec2d::Zero();         ///< rad, horizontal and vertical, full angle; 0: unknown
  Transform velo_from_lidar = Transform::Identity();  ///< mount pose of the unit in `velo`
  double height = 0;                                  ///< m of the `velo` origin over the ground
  /// Effects in the sweeps that it recorded, in words of parse_lidar_effects (lidar_effects.h).
  std::string recorded_effects = "unit";

  /// Firings between azimuth_min and azimuth_max.
  int azimuth_count() const;
  /// Azimuth of the firing, counter-clockwise from +x, in the unit's frame; without the beam's own offset.
  double firing_azimuth(int column) const;
  /// The ray of a beam (index) fired at an azimuth (rad, unit's frame).
  LidarRay ray_at(int beam, double firing_azimuth) const;
  /// The ray of a beam in a firing (indices).
  LidarRay ray(int beam, int column) const { return ray_at(beam, firing_azimuth(column)); }
  /// Time at which a beam fires (s). At 0 the unit looks along its +x, the camera's moment in KITTI's
  /// recordings (Geiger et al., IJRR 2013); firings behind it are up to half a turn away.
  double firing_time(int beam, double firing_azimuth) const;
};

/// Every ray of the model in `velo`, a row a beam, a column a firing: make it once, trace it often.
RayTable ray_table(const LidarModel& lidar);

/// Reads the [lidar] table of a file (scenes/rigs/kitti64.toml explains the keys). A rig may name a unit
/// instead: lidar = "vlp16" at its head; or unit = "vlp16" in its table, with the keys that differ on this
/// car. InputError naming file and key if missing, unknown or out of range, and for beams not from the top
/// down.
LidarModel read_lidar_model(const std::filesystem::path& file);
/// The [lidar] table of a file, with the keys of the unit that it names, if any.
nlohmann::json lidar_table(const std::filesystem::path& file);
/// The file of a unit: scenes/lidars/NAME.toml, or the file itself if the name ends in .toml.
std::filesystem::path lidar_file(const std::string& name);

// One LiDAR return on a triangle: Möller–Trumbore in a known face, and its VJP (src/README.md, LiDAR).
//
// With ray p(t) = o + t d (|d| = 1) and n = (v1 − v0) × (v2 − v0):
//     t = n·(v0 − o) / n·d,   ∂p/∂v_k = b_k · d nᵀ / (n·d)      for a fixed face.
// Reflectance is that of a Lambert surface: r = ρ |n̂·d|.

/// Height of a face (m) below which the gradient of its reflectance is scaled down.
inline constexpr double kThinFace = 1e-3;

/// A ray's return from one face.
template <class S>
struct FaceReturn {
  bool valid = false;
  S range = 0;  ///< t, metres
  Vec3<S> barycentric = Vec3<S>::Zero();
  S reflectance = 0;
};

/// Intersection of a ray with the face's plane, with barycentrics (Möller & Trumbore 1997). Not valid if the
/// ray is parallel to the plane or the face has no area. The caller knows (from Embree) that the ray hits
/// this face.
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
  for (int k = 0; k < 3; ++k) d_face[as_size(k)] += hit.barycentric[k] * along_normal;
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
