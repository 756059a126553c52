// Fits every vehicle of a frame and, where the truth is known, measures the fit against it.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "generator/vehicle_truth.h"
#include "scene/shape/shape_roof.h"

namespace mirage {

/// Against the true mesh of a generated vehicle. Its roof point is roof_point() of the true mesh.
struct FitError {
  Vec3d roof = Vec3d::Zero();  ///< fitted minus true roof point, along the true vehicle's axes (m)
  Vec3d box = Vec3d::Zero();   ///< the same for BoxRoofFinder's point
  double yaw = 0;              ///< rad
  double to_truth = 0;         ///< mean distance of the fitted surface to the true one (m)
  double from_truth = 0;       ///< mean distance of the true outer surface to the fitted one (m)
};

/// One vehicle of a data set, its fit, and how well that agrees with the truth where the set has it.
struct FittedVehicle {
  std::string frame;
  int label = 0;     ///< index among the frame's labels
  double range = 0;  ///< m, horizontal, from the LiDAR to the box
  int occluded = 0;
  Carrier carrier;  ///< from_box where there is no fit
  ShapeFit fit;
  double residual = 0;           ///< median distance of the returns to the fitted mesh (m)
  double roof_over_box = 0;      ///< fitted roof point's height over the labelled box's top (m)
  double roof_over_returns = 0;  ///< the same over the 99th percentile of its returns' heights (m)
  double seconds = 0;            ///< evidence and fit, one thread
  std::optional<FitError> error;
};

/// What to fit, and how to disturb the labels first: generated boxes are exact, drawn ones aren't.
struct FitFrameSettings {
  std::vector<std::string> types = {"Car"};
  /// Times normal errors of 7 cm along x and y, 5 cm in z, 0.02 rad and 3 % of each size, cut at 2.5 σ.
  double label_noise = 0;
  std::uint64_t seed = 0;
};

/// Fits the frame's labels. `truth`: the frame's true vehicles, null if not known.
std::vector<FittedVehicle> fit_frame(const ShapeRoofFinder& finder, const Frame& frame,
                                     const LidarModel& lidar, const FitFrameSettings& settings,
                                     const std::vector<generator::TrueVehicle>* truth);

/// Value below which the share p of the numbers lies; 0 for none.
double lower_quantile(std::vector<double> values, double p);

/// One vehicle: pose, size, roof, code, residual, errors.
nlohmann::json to_json(const FittedVehicle& vehicle);

}  // namespace mirage
