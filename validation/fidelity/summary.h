// What the results of all vehicles of a validation say together.
#pragma once

#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "validation/fidelity/vehicle_result.h"

namespace mirage {

/// The figures of result.json over the vehicles; those without a figure are left out of its mean.
/// `test_frames`: frames that the attack never saw.
nlohmann::json summarize_vehicles(const std::vector<VehicleResult>& vehicles,
                                  const std::set<std::string>& test_frames);

}  // namespace mirage
