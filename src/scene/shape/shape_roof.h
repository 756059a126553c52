// Roof poses from fitted shapes.
#pragma once

#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "scene/carrier.h"
#include "scene/shape/shape_fit.h"

namespace mirage {

/// Fits the shape manifold to cars and vans; the adversary stands on the fitted roof. A vehicle that can't be
/// fitted (too few returns, another type) gets BoxRoofFinder's pose, with from_box set and the reason.
class ShapeRoofFinder : public RoofFinder {
 public:
  /// `lidar`: the one that recorded the frames' sweeps.
  ShapeRoofFinder(ShapeModel model, LidarModel lidar, const ShapeFitSettings& settings = {});
  Carrier find(const Frame& frame, const Label& label) const override;
  /// The whole fit, from an index over the frame's sweep.
  ShapeFit fit(const SweepIndex& index, const Label& label) const;

 private:
  ShapeModel model_;
  LidarModel lidar_;
  ShapeFitSettings settings_;
  // Indices of the sweeps asked for last, one a thread: a frame's vehicles are asked for together.
  struct Indexed {
    Sweep sweep;
    std::shared_ptr<const SweepIndex> index;
  };
  std::shared_ptr<const SweepIndex> index_of(const Sweep& sweep) const;
  mutable std::mutex mutex_;
  mutable std::vector<Indexed> indexed_;  ///< the one used last is last
};

/// What finds the roofs, as --rooftop names it: "shape" (the shipped manifold), "box", or a manifold of the
/// user's own (*.shape, `mirage fit --build-model`).
inline constexpr const char* kDefaultRoof = "shape";
/// `lidar`: the one that recorded the frames' sweeps. InputError for another word.
std::unique_ptr<RoofFinder> make_roof_finder(const std::string& rooftop, const LidarModel& lidar);
/// content_hash of the manifold that `rooftop` names; empty for "box". InputError for another word.
std::string rooftop_model_hash(const std::string& rooftop);

}  // namespace mirage
