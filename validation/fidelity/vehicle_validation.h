// Finds out about one vehicle everything that `mirage validate` says of it.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "validation/blender/blender_process.h"
#include "validation/fidelity/validation_settings.h"
#include "validation/fidelity/vehicle_result.h"

namespace mirage {

/// What the vehicles of a validation share.
struct ValidationContext {
  const ValidationSettings& settings;
  const Run& run;
  const SimulationSettings& learned;  ///< the run's own, which `run` may have other than
  FrameStore& store;
  Detector& detector;
  BlenderWorker& blender;
  std::map<std::string, std::vector<Proposal>> clean;  ///< a frame's clean detections serve all its vehicles
};

/// Writes the vehicle's scene and pictures under settings.out. An object of which nothing is in view has no
/// figures. BlenderLost if Blender was lost too often on one of its renders.
VehicleResult validate_vehicle(ValidationContext& context, const HostId& id, bool with_ladder);

}  // namespace mirage
