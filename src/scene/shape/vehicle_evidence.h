// What a sweep says about one vehicle: returns on it, space its rays found empty, the ground it stands on.
// All in the frame of the labelled box: origin at the centre of its bottom, x along its heading, z up.
#pragma once

#include <optional>
#include <vector>

#include "geometry/box.h"
#include "scene/occlusion.h"

namespace mirage {

/// A piece of a ray (m, `velo`).
struct Segment {
  Vec3d from, to;
};

/// z = height + slope · (x, y).
struct GroundPlane {
  double height = 0;  ///< m
  Vec2d slope = Vec2d::Zero();
  /// The ground's z (m) at a place.
  double at(double x, double y) const { return height + slope.x() * x + slope.y() * y; }
};

/// What the sweep says of one vehicle, in `velo`.
struct VehicleEvidence {
  std::vector<Vec3d> surface;         ///< returns on the vehicle, thinned
  std::vector<Segment> empty;         ///< parts of rays before their return, near the vehicle, thinned
  std::optional<GroundPlane> ground;  ///< absent where too little of it is seen
  int points = 0;                     ///< returns on the vehicle before thinning
};

/// Which returns count for a vehicle, and how many are kept.
struct EvidenceSettings {
  double grow = 0.20;          ///< m: labels are drawn by hand; returns this far outside the box still count
  double above_ground = 0.12;  ///< m: lower returns are the road's
  double cell = 0.10;          ///< m: one return in each cube of this size stays
  int max_rays = 500;          ///< empty segments kept, evenly over the rays
  double before = 0.12;        ///< m before a return from which on its ray says nothing
  double beside = 0.4;         ///< m to either side in which a higher return makes a ray one through glass
  double ground_ring = 1.5;    ///< m around the box in which ground is looked for
  int min_ground = 15;         ///< returns a ground plane needs
};

/// A ray without a return says nothing: dark paint and glass swallow light as the sky does. Nor does a ray
/// that passes below a return on the vehicle in about the same direction: it may have gone through a window.
/// Empty space is taken from rays with their laser's own origin (SweepIndex): an HDL-64E's lasers lie 20 cm
/// apart.
VehicleEvidence gather_evidence(const SweepIndex& sweep, const Box3& box,
                                const EvidenceSettings& settings = {});

}  // namespace mirage
