// The hosts of an evaluation in its file: written by to_json(Evaluation), read back by who puts evaluations
// beside each other.
#pragma once

#include <nlohmann/json.hpp>
#include <vector>

#include "attack/host_outcome.h"
#include "base/json_fields.h"

namespace mirage {

/// [{frame, label, mesh?, track?, kind, …}]: "mesh" where there are several, "track" where it is known,
/// "clean_distance" and "attacked_distance" in the bird's-eye view alone, null where they are infinite.
nlohmann::json outcomes_json(const std::vector<HostOutcome>& hosts, int meshes);

/// The hosts of what to_json(Evaluation) wrote, in its order, without their detections; of their new boxes
/// (those that false_positives_json listed) the distance alone. InputError naming file and field.
std::vector<HostOutcome> read_outcomes(const JsonFields& evaluation);

}  // namespace mirage
