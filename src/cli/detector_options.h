// Options that every command with a detector shares.
#pragma once

#include "cli/command.h"
#include "cli/field_options.h"
#include "detection/detector.h"
#include "scene/data/data_rig.h"

namespace mirage::cli {

/// `data`: the data set that the detector is to see; its rig (or `rig`, if given) chooses the shipped
/// weights.
inline DetectorOptions with_common(DetectorOptions options, const Common& common,
                                   const std::filesystem::path& data, const std::string& rig) {
  options.rig = data_rig(data, rig);
  options.seed = common.seed;
  options.threads = common.threads;
  return options;
}

}  // namespace mirage::cli
