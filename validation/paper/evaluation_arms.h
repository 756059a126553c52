// Every arm of the experiments as numbers, whatever table it stands in.
#pragma once

#include <nlohmann/json.hpp>

#include "validation/paper/tables.h"

namespace mirage::paper {

/// [{name, detector (attacked), target, defense?, rig (of the frames), judge, mesh ("learned" or a control's
/// word, attack/baseline.h), seeds, vehicles, frames, asr: {vanished, iou50, iou70, distance1m, distance2m:
/// each {value, low, high, vehicles} or null}, net: the same less random meshes of its size (of the learned
/// mesh alone), fp_asr, interval: {confidence, drawn}}]; shares in [0, 1]. An experiment that was not judged
/// has none.
nlohmann::json arms_json(const Experiments& experiments, const ReproduceSettings& settings,
                         const Evidence& evidence);

}  // namespace mirage::paper
