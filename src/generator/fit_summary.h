// How well the vehicles of a data set were fitted.
#pragma once

#include <array>
#include <cstddef>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "generator/fit_dataset.h"

namespace mirage {

/// Of some numbers, by lower_quantile.
struct FitSpread {
  double p05 = 0, median = 0, p95 = 0;
};

/// Over some vehicles. Lengths in m, as FittedVehicle has them; those of errors without their signs.
struct FitSummary {
  /// Over those whose truth is known.
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

struct FitReport {
  FitSummary all, within_30_m;
  std::vector<FitClass> by_range, by_returns;
};

FitReport summarise_fits(const std::vector<FittedVehicle>& vehicles);

/// {all, within_30_m, by_range, by_returns}; each {vehicles, fitted, from_box, residual_m, roof_over_box_m,
/// roof_over_returns_m, seconds, error?}, with its "range_m" or "returns": [low, high or null]
nlohmann::json to_json(const FitReport& report);

}  // namespace mirage
