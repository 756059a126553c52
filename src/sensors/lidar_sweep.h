// A whole sweep of a generated scene, with the sensor's imperfections.
#pragma once

#include <cstdint>

#include "sensors/lidar_effects.h"
#include "sensors/lidar_model.h"
#include "sensors/ray_camera.h"

namespace mirage {

/// The imperfections of generated sweeps, chosen to match KITTI: point counts of road and cars over the
/// range.
LidarEffects generated_sweep_effects();

/// The return of each firing: beams × columns, beam by beam.
struct Firings {
  std::vector<LidarPoint> points;  ///< `velo`; meaningless without a return
  std::vector<double> ranges;      ///< m, as reported; 0 without a return
  std::vector<int> objects;        ///< Surface::object of the return; −1: background, or no return
};

/// A part of the scene that moves during the sweep.
struct SweptPart {
  const RayScene* scene = nullptr;  ///< at the sweep's moment
  Vec3d velocity = Vec3d::Zero();   ///< m/s
};

/// Motion of the unit through a scene that is not in `velo`, with moving parts.
struct UnitMotion {
  Transform scene_from_velo = Transform::Identity();  ///< at the sweep's moment (LidarModel::firing_time 0)
  /// Of the unit; these replace LidarEffects' own. Returns are written relative to its pose at that moment,
  /// as in KITTI's recordings; a part is where it was when the beam met it.
  Vec3d velocity = Vec3d::Zero();
  double yaw_rate = 0;
  std::vector<SweptPart> parts = {};  ///< besides the static scene; velocities in the scene's frame
};

/// Traces every (beam, column) of the model. Most rays pass through glass. Random numbers are keyed by (seed,
/// beam): the result does not depend on the thread count.
Firings simulate_firings(const RayScene& scene, const LidarModel& model, std::uint64_t seed,
                         const LidarEffects& effects = generated_sweep_effects(),
                         const UnitMotion* motion = nullptr);

/// The returns only, beam by beam. `objects`, unless null: each return's, as in Firings.
Sweep simulate_sweep(const RayScene& scene, const LidarModel& model, std::uint64_t seed,
                     const LidarEffects& effects = generated_sweep_effects(),
                     std::vector<int>* objects = nullptr, const UnitMotion* motion = nullptr);

}  // namespace mirage
