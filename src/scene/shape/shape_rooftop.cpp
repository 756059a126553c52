#include "scene/shape/shape_rooftop.h"

#include <algorithm>

namespace mirage {
namespace {

bool same(const Sweep& a, const Sweep& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const LidarPoint& p, const LidarPoint& q) {
    return p.x == q.x && p.y == q.y && p.z == q.z;
  });
}

}  // namespace

ShapeRooftopFinder::ShapeRooftopFinder(ShapeModel model, LidarModel lidar, const ShapeFitSettings& settings)
    : model_(std::move(model)), lidar_(std::move(lidar)), settings_(settings) {}

ShapeFit ShapeRooftopFinder::fit(const SweepIndex& index, const Label& label) const {
  if (label.type != "Car" && label.type != "Van") {
    ShapeFit none;
    none.reason = "the manifold holds cars and vans, this is a " + label.type;
    return none;
  }
  return fit_shape(model_, gather_evidence(index, label.box, settings_.evidence), label.box, settings_);
}

Rooftop ShapeRooftopFinder::find(const Frame& frame, const Label& label) const {
  std::shared_ptr<const SweepIndex> index;
  {
    const std::scoped_lock lock(mutex_);
    if (!index_ || !same(sweep_, frame.sweep)) {
      index_ = std::make_shared<const SweepIndex>(frame.sweep, lidar_);
      sweep_ = frame.sweep;
    }
    index = index_;
  }
  const ShapeFit found = fit(*index, label);
  if (!found.fitted) return BoxRooftopFinder().find(frame, label);
  return {found.velo_from_roof, false};
}

}  // namespace mirage
