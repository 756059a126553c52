// A whole sweep of a generated scene, with the sensor's imperfections.
#pragma once

#include <cstdint>

#include "sensors/lidar_effects.h"
#include "sensors/lidar_model.h"
#include "sensors/ray_camera.h"

namespace mirage {

/// The imperfections of generated sweeps, chosen so that they look like KITTI's: road and cars keep their
/// counts of points over the range.
LidarEffects generated_sweep_effects();

/// What came back of each firing: beams × columns, beam by beam.
struct Firings {
  std::vector<LidarPoint> points;  ///< `velo`; meaningless where nothing returned
  std::vector<double> ranges;      ///< m, as reported; 0 where nothing returned
  std::vector<int> objects;  ///< Surface::object of what returned; −1: background, or nothing returned
};

/// Something that moves while it is swept.
struct SweptPart {
  const RayScene* scene = nullptr;  ///< where it is at the sweep's moment
  Vec3d velocity = Vec3d::Zero();   ///< m/s
};

/// The unit on its way through a scene that is not in `velo`, among things that move.
struct UnitMotion {
  Transform scene_from_velo = Transform::Identity();  ///< at the sweep's moment (LidarModel::firing_time 0)
  /// Of the unit, as LidarEffects has them (whose own are not used then). Returns are written as seen from
  /// its place at that moment, as KITTI's recordings are; a thing is where it was when the beam met it.
  Vec3d velocity = Vec3d::Zero();
  double yaw_rate = 0;
  std::vector<SweptPart> parts = {};  ///< besides what stands, with velocities in the scene's frame
};

/// Traces every (beam, column) of the model. Glass lets most rays pass. Random numbers are keyed by (seed,
/// beam): the result does not depend on the thread count.
Firings simulate_firings(const RayScene& scene, const LidarModel& model, std::uint64_t seed,
                         const LidarEffects& effects = generated_sweep_effects(),
                         const UnitMotion* motion = nullptr);

/// The returns alone, beam by beam. `objects`, if given: each return's, as in Firings.
Sweep simulate_sweep(const RayScene& scene, const LidarModel& model, std::uint64_t seed,
                     const LidarEffects& effects = generated_sweep_effects(),
                     std::vector<int>* objects = nullptr, const UnitMotion* motion = nullptr);

}  // namespace mirage
