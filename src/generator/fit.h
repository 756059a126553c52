// The true shapes of a generated frame's vehicles, which a fit to the frame's sweep should find.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "base/json_fields.h"
#include "generator/street.h"
#include "geometry/box.h"
#include "geometry/mesh.h"
#include "scene/shape/shape_fit.h"

namespace mirage::generator {

/// A generated vehicle as it is, with nothing hidden.
struct TrueVehicle : Placed {
  Mesh mesh;  ///< in `velo`; every surface, seats and lamps included, without the load on its roof
};

/// The source of a data set's streets.
struct StreetSource {
  std::uint64_t seed = 0;
  Look look = Look::european;
  double behind = 0;  ///< m of street behind the car
};
/// The labelled things of frame `index`, laid out again (nothing is rendered). `height`: of the rig's LiDAR
/// over the ground, as in make_street.
std::vector<TrueVehicle> true_vehicles(const StreetSource& source, std::uint64_t index, double height);

/// A data set's source, if this generator's version made it (dataset.json), so that true_vehicles gives the
/// rendered vehicles; empty for recorded sets and for other versions. InputError for a broken dataset.json.
std::optional<StreetSource> source_of(const std::filesystem::path& data);

/// The vehicle of a data set's label: same type, centre nearest and within 0.1 m; null without one.
const TrueVehicle* find_vehicle(const std::vector<TrueVehicle>& vehicles, const std::string& type,
                                const Box3& box);

}  // namespace mirage::generator

namespace mirage {

// Fits every vehicle of a frame and, where the truth is known, measures the fit against it.

/// The error of a fit against the true mesh of a generated vehicle. The true roof point is roof_point() of
/// the true mesh.
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
  /// The fitted roof's pose, or where there is no fit BoxRoofFinder's.
  Transform velo_from_roof = Transform::Identity();
  ShapeFit fit;
  double residual = 0;           ///< median distance of the returns to the fitted mesh (m)
  double roof_over_box = 0;      ///< fitted roof point's height over the labelled box's top (m)
  double roof_over_returns = 0;  ///< the same over the 99th percentile of its returns' heights (m)
  double seconds = 0;            ///< evidence and fit, one thread
  std::optional<FitError> error;
};

/// Which labels to fit, and how to disturb them first: generated boxes are exact, annotated ones are not.
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

/// One vehicle: pose, size, roof, code, residual, errors.
nlohmann::json to_json(const FittedVehicle& vehicle);
/// Reads a vehicle of to_json as far as summarise_fits and to_json need it: without meshes and returns, with
/// an upright roof. InputError naming file and field.
FittedVehicle read_fitted_vehicle(const JsonFields& json);

// How well the vehicles of a data set were fitted.

/// Quantiles of some numbers, by lower_quantile.
struct FitSpread {
  double p05 = 0, median = 0, p95 = 0;
};

/// A summary over vehicles. Lengths in m, as in FittedVehicle; errors as absolute values.
struct FitSummary {
  /// Over the vehicles whose truth is known.
  struct Errors {
    std::size_t vehicles = 0;
    std::array<FitSpread, 3> roof, box;  ///< of FitError, along x, y, z
    FitSpread distance;                  ///< between the roof points
    FitSpread yaw;                       ///< rad
    FitSpread to_truth, from_truth;
  };
  std::size_t vehicles = 0, fitted = 0;
  FitSpread residual, roof_over_box, roof_over_returns;  ///< of the fitted
  FitSpread seconds;                                     ///< of the fitted
  std::optional<Errors> error;                           ///< where any truth is known
};

/// Vehicles whose range (m) or number of returns lies in [low, high).
struct FitClass {
  double low = 0, high = 0;  ///< high: infinity for the last
  FitSummary fits;
};

/// Fits of a data set: all, those within 30 m, and classes of range (m) and of returns.
struct FitReport {
  FitSummary all, within_30_m;
  std::vector<FitClass> by_range, by_returns;
};

/// Classes end at 10, 20, 30, 40 m and beyond, and at 20, 40, 100, 300, 1000 returns and more.
FitReport summarise_fits(const std::vector<FittedVehicle>& vehicles);

/// {all, within_30_m, by_range, by_returns}; each {vehicles, fitted, from_box, residual_m, roof_over_box_m,
/// roof_over_returns_m, seconds, error?}, with its "range_m" or "returns": [low, high or null]
nlohmann::json to_json(const FitReport& report);

}  // namespace mirage
