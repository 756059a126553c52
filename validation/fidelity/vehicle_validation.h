// Finds out about one vehicle everything that `mirage validate` says of it.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "validation/fidelity/validation_settings.h"
#include "validation/fidelity/vehicle_result.h"
#include "validation/reference/reference_renderer.h"

namespace mirage {

/// What the vehicles of a validation share.
struct ValidationContext {
  const ValidationSettings& settings;
  const Run& run;
  const SimulationSettings& learned;  ///< the run's own, which `run` may have other than
  FrameStore& store;
  Detector& detector;
  ReferenceRenderer& renderer;
  std::map<std::string, std::vector<Detection>> clean;  ///< a frame's clean detections serve all its vehicles
};

/// Writes the vehicle's scene and pictures under settings.out. An object of which nothing is in view has no
/// figures. ReferenceLost if the renderer was lost too often on one of its renders.
VehicleResult validate_vehicle(ValidationContext& context, const HostId& id, bool with_ladder);

}  // namespace mirage
