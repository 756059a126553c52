// Roof poses from fitted shapes.
#pragma once

#include <memory>
#include <mutex>
#include <optional>

#include "scene/rooftop.h"
#include "scene/shape/shape_fit.h"

namespace mirage {

/// Fits the shape manifold to cars and vans; the adversary stands on the fitted roof. A vehicle that can't be
/// fitted (too few returns, another type) gets BoxRooftopFinder's pose, with from_box set. Several threads
/// may ask at once.
class ShapeRooftopFinder : public RooftopFinder {
 public:
  /// `lidar`: the one that recorded the frames' sweeps.
  ShapeRooftopFinder(ShapeModel model, LidarModel lidar, const ShapeFitSettings& settings = {});
  Rooftop find(const Frame& frame, const Label& label) const override;
  /// The whole fit, from an index over the frame's sweep.
  ShapeFit fit(const SweepIndex& index, const Label& label) const;

 private:
  ShapeModel model_;
  LidarModel lidar_;
  ShapeFitSettings settings_;
  // The index of the sweep asked for last: a frame's vehicles are asked for one after another.
  mutable std::mutex mutex_;
  mutable Sweep sweep_;
  mutable std::shared_ptr<const SweepIndex> index_;
};

}  // namespace mirage
