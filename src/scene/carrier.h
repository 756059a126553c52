// A vehicle that carries an object: its label, its roof's pose, and its fitted shape if any.
#pragma once

#include <memory>
#include <string>

#include "base/types.h"
#include "geometry/mesh.h"
#include "scene/frame.h"

namespace mirage {

/// One vehicle and how its roof was found.
struct Carrier {
  Label label;
  /// velo_from_roof with its origin on the roof point, x along the heading, z up.
  Transform velo_from_roof = Transform::Identity();
  bool from_box = true;     ///< no shape was fitted; the roof is the labelled box's
  std::string reason = {};  ///< why a shape finder fell back to the box
  /// The fitted vehicle (`velo`, watertight, wound outward); null if from_box.
  std::shared_ptr<const Mesh> shape = {};
};

/// An ordinary saloon in shares of the labelled box: the stand-in for a vehicle without a fitted shape.
namespace saloon {
inline constexpr double kRoofRear = -0.32, kRoofFront = 0.08, kRoofWidth = 0.76;  // of length, length, width
inline constexpr double kWaist = 0.58;                                            // of the height
}  // namespace saloon

/// A closed car-shaped mesh in `velo` that fills the labelled box: body, cabin with its roof plane at the
/// box's top, four wheels. The cabin's centre lies where BoxRoofFinder puts it.
Mesh car_proxy(const Box3& box);
/// The fitted vehicle if there is one, otherwise car_proxy of the labelled box.
std::shared_ptr<const Mesh> shape_of(const Carrier& carrier);

/// Finds roofs: BoxRoofFinder here, ShapeRoofFinder in scene/shape/shape_fit.h. Thread-safe.
class RoofFinder {
 public:
  virtual ~RoofFinder() = default;
  /// `label`: one of frame.labels, a vehicle.
  virtual Carrier find(const Frame& frame, const Label& label) const = 0;
};

/// The labelled box's top face, centred over the cabin: a car's cabin centre lies behind the box's centre
/// by a share of the length (stated in carrier.cpp).
class BoxRoofFinder : public RoofFinder {
 public:
  Carrier find(const Frame& frame, const Label& label) const override;
};

}  // namespace mirage
