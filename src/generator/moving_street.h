// A street that lasts some seconds: what stands in it, the car's own way along it, and what drives. Ours is
// the right one of two lanes. A car ahead brakes (and so do we, a second later), one overtakes us, one or
// more come towards us, one crosses, and others keep their lanes. Nothing meets anything.
//
// The world is the car's `velo` at time 0, upright.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "generator/generator.h"
#include "generator/look.h"
#include "generator/placed.h"

namespace mirage::generator {

/// Where something upright is at a moment, and how it moves.
struct Waypoint {
  Vec3d position = Vec3d::Zero();  ///< m, in the world: on the ground under the box's centre; ours: `velo`
  double yaw = 0;                  ///< rad
  Vec3d velocity = Vec3d::Zero();  ///< m/s
  double yaw_rate = 0;             ///< rad/s
  /// world_from_thing.
  Transform pose() const;
};
using Way = std::vector<Waypoint>;  ///< one each kWayStep seconds

inline constexpr double kWayStep = 0.02;

/// Something that drives.
struct Mover {
  std::string role;  ///< brakes, overtakes, towards, crosses, keeps
  Actor actor;
  Way way;
};

/// See above.
struct MovingStreet {
  Street standing;  ///< in the world
  std::vector<Mover> movers;
  Way own;  ///< of `velo`

  /// The step of the ways at a time (s), from 0 to their end.
  std::size_t step(double time) const;
  /// All of it at a time, in the world; what drives is placed after what stands, in the order of `movers`.
  Street at(double time) const;
  /// A mover's surfaces at a time, in the world, with its place among the placed as object.
  std::vector<Surface> surfaces_of(std::size_t mover, double time) const;
};

/// `height`: of the `velo` origin over the road (m). Deterministic by (seed, index, look, seconds).
MovingStreet make_moving_street(std::uint64_t seed, std::uint64_t index, double height, Look look,
                                double seconds);

}  // namespace mirage::generator

namespace mirage {

inline constexpr double kDriveStep = 0.1;  ///< s from a drive's frame to the next

/// A frame of a drive at a time (s), as generate_frame makes one; `index` is the drive's. `standing`: a scene
/// of street.standing. The sweep is taken while all moves, and written as seen from the car's place at that
/// time; labels have their place in MovingStreet::at as identity. Id: "DRIVE_FRAME", counted by kDriveStep.
Frame generate_drive_frame(const Rig& rig, const generator::MovingStreet& street, const RayScene& standing,
                           std::uint64_t seed, std::uint64_t index, double time);

}  // namespace mirage
