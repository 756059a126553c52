// Where an object stands in a frame: what simulation, light, exported scenes and masks know of it.
#pragma once

#include <optional>
#include <vector>

#include "scene/carrier.h"
#include "sensors/visible_light.h"

namespace mirage {

/// What an object stands on.
enum class Support {
  roof,  ///< on top of the carrier, which never hides it
  free,  ///< on the road or in the air; the carrier, if there is one, may stand in front of it
};

/// A pose, and the vehicles that it has to do with.
struct Placement {
  /// The adversary frame's axes in `velo`. The object's lowest vertex stands at its origin's height.
  Transform velo_from_adversary = Transform::Identity();
  Support support = Support::free;
  std::optional<Carrier> carrier = {};  ///< the vehicle under it or beside it; it shades, and it may hide
  std::vector<Label> targets = {};  ///< of the frame: the vehicles whose detection an attack's loss is about
};

/// `place` of an object whose host `carrier` is: its carrier and its only target. It stands on the carrier
/// where its origin is over the labelled box's outline and no lower than a saloon's waist, else free.
Placement placement_of(const PlaceChoice& place, Carrier carrier);
/// On its roof.
Placement on_roof(Carrier carrier);

/// The adversary as placed: vertices in `velo`, the lowest at the placement's height.
TexturedMesh place(const TexturedMesh& adversary, const Placement& placement);

/// What is around the placed object for the light model with visibility: the road, and the vehicle under it
/// or beside it. None without a carrier: an object in free space.
std::optional<LightSurroundings> surroundings_of(const Frame& frame, const Placement& placement);

/// Planar depth (m, camera) from which on nothing that the photograph shows stands in front of the object:
/// that of the carrier's nearest corner where it stands on it, else infinite.
double unhidden_depth(const Placement& placement, const Calibration& calibration);

}  // namespace mirage
