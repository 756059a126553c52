// Where an object stands in a frame: what simulation, light, exported scenes and masks know of it.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "scene/carrier.h"
#include "scene/place_choice.h"
#include "sensors/visible_light.h"

namespace mirage {

/// What an object stands on.
enum class Support {
  roof,  ///< on top of the carrier, which never hides it
  free,  ///< on the road or in the air; the carrier, if there is one, may stand in front of it
};

/// Why a vehicle is left out as a host of a placement.
enum class LeftOut {
  no,
  no_room,       ///< something labelled stands where the object would
  no_neighbour,  ///< no other vehicle is near enough to be its victim
};

/// A pose, and the vehicles that it has to do with.
struct Placement {
  /// The adversary frame's axes in `velo`. The object's lowest vertex stands at its origin's height.
  Transform velo_from_adversary = Transform::Identity();
  Support support = Support::free;
  std::optional<Carrier> carrier = {};  ///< the vehicle under it or beside it; it shades, and it may hide
  std::vector<Label> targets = {};  ///< of the frame: the vehicles whose detection an attack's loss is about
  std::optional<int> neighbour = {};  ///< Victim::neighbour: the target's number in the frame
  Victim victim = Victim::carrier;
  Vec3d volume = 2 * kRoofBox;  ///< PlaceChoice::volume
  bool grows_box = false;       ///< TrueBox::grown
  LeftOut left_out = LeftOut::no;
};

/// `place` of an object whose host `carrier` is, in a frame with these `labels`: the target is the carrier
/// or, with Victim::neighbour, the vehicle (is_sought) whose box's centre is nearest to the object from
/// above; with Victim::object there is none (own_label()). The object stands on the carrier where its origin
/// is over the labelled box's outline and no lower than a saloon's waist, else free. Of a placement's file an
/// object that stands free needs room: with more than a tenth of its volume's footprint on a labelled box
/// (the carrier's own where it starts from that box's centre) at its height it has none. Without room or
/// neighbour the host is left out: it has no target either.
Placement placement_of(const PlaceChoice& place, Carrier carrier, std::span<const Label> labels);
/// What has to be said of a host that is left out; empty for the others.
std::string why_left_out(const PlaceChoice& place, LeftOut left_out);
/// On its roof.
Placement on_roof(Carrier carrier);

/// Warns of an object (its extents, m) that is larger than the placement's volume. On a roof what is carried
/// is longer than the box that an attack fills: warn_of_large_object (check_inputs.h) has its bound.
void warn_of_volume(const PlaceChoice& place, const Vec3d& size, const std::string& where);

/// The host's true box with the object, where that grows it: with the label's heading, the smallest that
/// holds the labelled box and the placed mesh (`velo`).
Box3 grown_box(const Box3& box, const Mesh& placed);

/// Victim::object: what the frame's labels would say of the object, a "Misc" with the carrier's track. Its
/// box is the smallest upright one along the object's own x axis that holds the placed mesh (`velo`); in the
/// picture that box's outline, none where the picture does not show it.
Label own_label(const Placement& placement, const Mesh& placed, const Calibration& calibration);

/// The adversary as placed: vertices in `velo`, the lowest at the placement's height.
TexturedMesh place(const TexturedMesh& adversary, const Placement& placement);

/// What is around the placed object for the light model with visibility: the road, and the vehicle under it
/// or beside it. None without a carrier: an object in free space.
std::optional<LightSurroundings> surroundings_of(const Frame& frame, const Placement& placement);

/// Planar depth (m, camera) beyond which nothing in the photograph occludes the object: that of the nearest
/// corner of the carrier that it stands on, else infinite.
double occluder_depth_limit(const Placement& placement, const Calibration& calibration);

}  // namespace mirage
