// Where the adversary stands: a pose on a vehicle's roof.
#pragma once

#include <memory>
#include <string>

#include "geometry/mesh.h"
#include "scene/frame.h"

namespace mirage {

/// Where the adversary stands on one vehicle, and how that was found.
struct Rooftop {
  /// velo_from_adversary with its origin on the roof point, x along the heading, z up.
  Transform velo_from_adversary = Transform::Identity();
  bool from_box = true;     ///< true where no shape was fitted and the labelled box was used
  std::string reason = {};  ///< why a finder of shapes fell back to the box
  /// The fitted vehicle (`velo`, watertight, wound outward); null where from_box.
  std::shared_ptr<const Mesh> vehicle = {};
};

/// Finds roof poses: BoxRooftopFinder here, ShapeRooftopFinder in scene/shape/shape_rooftop.h. Several
/// threads may ask at once.
class RooftopFinder {
 public:
  virtual ~RooftopFinder() = default;
  /// `label` is one of frame.labels and a vehicle.
  virtual Rooftop find(const Frame& frame, const Label& label) const = 0;
};

/// The labelled box's top face, centred over the cabin: a car's cabin centre lies behind the box's centre
/// by a share of the length (stated in rooftop.cpp).
class BoxRooftopFinder : public RooftopFinder {
 public:
  Rooftop find(const Frame& frame, const Label& label) const override;
};

}  // namespace mirage
