// The placement of an object in a frame, as simulation, light, exported scenes and masks use it.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "scene/carrier.h"
#include "scene/place_choice.h"
#include "sensors/visible_light.h"

namespace mirage {

/// The support of an object.
enum class Support {
  roof,  ///< on top of the carrier, which never hides it
  free,  ///< on the road or in the air; the carrier, if there is one, may stand in front of it
};

/// Why a vehicle is left out as a host of a placement.
enum class LeftOut {
  no,
  no_room,       ///< something labelled stands where the object would
  no_neighbour,  ///< no other vehicle is near enough to be the victim
};

/// A pose, its carrier and its target vehicles.
struct Placement {
  /// The adversary frame's axes in `velo`. The object's lowest vertex stands at its origin's height.
  Transform velo_from_adversary = Transform::Identity();
  Support support = Support::free;
  std::optional<Carrier> carrier = {};  ///< the vehicle under it or beside it; it shades, and it may hide
  std::vector<Label> targets = {};      ///< labels of the frame whose detection enters an attack's loss
  std::optional<int> neighbour = {};    ///< Victim::neighbour: the target's label index
  Victim victim = Victim::carrier;
  Vec3d volume = 2 * kRoofBox;  ///< PlaceChoice::volume
  bool grows_box = false;       ///< TrueBox::grown
  LeftOut left_out = LeftOut::no;
};

/// The placement by `place` of an object with the host `carrier`, in a frame with these `labels`: the target
/// is the carrier or, with Victim::neighbour, the vehicle (is_sought) whose box's centre is nearest to the
/// object from above; with Victim::object there is no target (own_label()). The object stands on the carrier
/// if its origin is above the labelled box's outline and no lower than a saloon's waist; otherwise it stands
/// free. A free object from a placement file needs room: it has none if a labelled box at its height (the
/// carrier's only if it starts from that box's centre) covers more than a tenth of its footprint. Without
/// room or neighbour the host is left out and has no target.
Placement placement_of(const PlaceChoice& place, Carrier carrier, std::span<const Label> labels);
/// The reason for a host being left out, for messages; empty for LeftOut::no.
std::string why_left_out(const PlaceChoice& place, LeftOut left_out);
/// An object on the carrier's roof.
Placement on_roof(Carrier carrier);

/// Warns of an object (its extents, m) that is larger than the placement's volume. Not for roofs: their loads
/// may exceed the box that an attack fills, and warn_of_large_object (check_inputs.h) checks them.
void warn_of_volume(const PlaceChoice& place, const Vec3d& size, const std::string& where);

/// The host's true box, grown by the object: the smallest box with the label's heading that holds the
/// labelled box and the placed mesh (`velo`).
Box3 grown_box(const Box3& box, const Mesh& placed);

/// Victim::object: a label for the object, a "Misc" with the carrier's track. Its box is the smallest upright
/// one along the object's own x axis that holds the placed mesh (`velo`). Its picture box is that box's
/// outline, unset if the picture does not show it.
Label own_label(const Placement& placement, const Mesh& placed, const Calibration& calibration);

/// The adversary as placed: vertices in `velo`, the lowest at the placement's height.
TexturedMesh place(const TexturedMesh& adversary, const Placement& placement);

/// Surroundings of the placed object for the light model with visibility: the road, and the vehicle under or
/// beside it. Nullopt without a carrier: an object in free space.
std::optional<LightSurroundings> surroundings_of(const Frame& frame, const Placement& placement);

/// Planar depth (m, camera) beyond which nothing in the photograph occludes the object: the depth of the
/// nearest corner of the carrier under it; infinite if it does not stand on one.
double occluder_depth_limit(const Placement& placement, const Calibration& calibration);

}  // namespace mirage
