// A street around the ego vehicle: surfaces, the labelled things among them, and what moves.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "base/error.h"
#include "base/fields.h"
#include "base/types.h"
#include "generator/parts.h"
#include "geometry/box.h"

namespace mirage {

// The kind of place that generated streets show.

/// Which country's streets are generated.
enum class Look {
  european,  ///< streets of a middle-sized German town and the roads around it
  american   ///< North American avenues, suburbs and office blocks
};

/// "european", "american".
inline std::string name_of(Look look) {
  return look == Look::american ? "american" : "european";
}

/// InputError naming `where` and `field` if there is no such look.
inline Look parse_look(const std::string& name, const std::string& where, const std::string& field) {
  if (name == "european") return Look::european;
  if (name == "american") return Look::american;
  throw InputError(where, field, name + " is not a look", use_one_of(name, {"european", "american"}));
}

}  // namespace mirage

namespace mirage::generator {

/// A labelled thing where it stands.
struct Placed {
  std::string type;
  Box3 box;               ///< `velo`
  std::string kind = {};  ///< Actor::kind
};

/// Surfaces in `velo`; a labelled thing's surfaces carry its index in `placed` as object.
struct Street {
  std::vector<Surface> surfaces;
  std::vector<Placed> placed;
};

/// Pose and motion of an upright thing at one moment.
struct Waypoint {
  Vec3d position = Vec3d::Zero();  ///< m, in the world: on the ground under the box's centre; ours: `velo`
  double yaw = 0;                  ///< rad
  Vec3d velocity = Vec3d::Zero();  ///< m/s
  double yaw_rate = 0;             ///< rad/s
  /// world_from_thing.
  Transform pose() const;
};
using Way = std::vector<Waypoint>;  ///< one each kWayStep seconds

/// s between the waypoints of a Way.
inline constexpr double kWayStep = 0.02;

/// Something that drives.
struct Mover {
  std::string role;  ///< brakes, overtakes, towards, crosses, keeps
  Actor actor;
  Way way;
};

/// A street that lasts some seconds (street.h).
struct MovingStreet {
  Street standing;  ///< in the world
  std::vector<Mover> movers;
  Way own;  ///< of `velo`

  /// The step of the ways at a time (s), from 0 to their end.
  std::size_t step(double time) const;
  /// The whole street at a time, in the world; `movers`, in order, are placed after the standing things.
  Street at(double time) const;
  /// A mover's surfaces at a time, in the world, with its place among the placed as object.
  std::vector<Surface> surfaces_of(std::size_t mover, double time) const;
};

/// Whether the surface is something that lies on the roof of `placed`: part of the thing, but not of its
/// boxes.
bool on_roof(const Surface& surface, const Placed& placed);

/// `height`: of the `velo` origin over the road (m). `behind`: how much of the street lies behind the car
/// (m; 0: its first metres). Deterministic by (seed, index, look, behind).
Street make_street(std::uint64_t seed, std::uint64_t index, double height, Look look = Look::european,
                   double behind = 0);
/// m of street behind a car that looks back: whose rig has other cameras than the first.
inline constexpr double kBehind = 60;

// A street that lasts some seconds: its standing things, the car's own way along it, and its movers. Our lane
// is the right one of two. A car ahead brakes (and so do we, a second later), one overtakes us, one or more
// come towards us, one crosses, and others keep their lanes. Nothing collides.
//
// The world is the car's `velo` at time 0, upright.

/// `height`: of the `velo` origin over the road (m). Deterministic by (seed, index, look, seconds).
MovingStreet make_moving_street(std::uint64_t seed, std::uint64_t index, double height, Look look,
                                double seconds);

}  // namespace mirage::generator
