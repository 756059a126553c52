// Every arm of the experiments as numbers, whatever table it stands in.
#pragma once

#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "attack/hiding.h"
#include "validation/paper/cases.h"
#include "validation/paper/evidence.h"

namespace mirage::paper {

/// A mesh of an evaluation, judged. Shares in [0, 1].
struct Arm {
  std::string name;              ///< the evaluation's, without its folder
  std::string detector, target;  ///< who was attacked, and through which sensors
  std::string defense;           ///< of the attacked one; empty: none
  std::string parts;             ///< word of --parts: what was learned; empty: shape and texture
  std::string rig;               ///< of the frames
  std::string judge;             ///< the detector that judges
  std::string mesh;              ///< "learned" or a control's word (attack/baseline.h)
  std::vector<std::uint64_t> seeds;
  int vehicles = 0, frames = 0;
  HidingRates hiding;
  /// Of the learned mesh: the same less random meshes of its size, by kHidingRules.
  std::optional<std::array<std::optional<Interval>, kHidingRules.size()>> net;
  Interval false_positives;
};

/// Of the evaluations that were judged, in the cases' order; repetitions are pooled.
std::vector<Arm> evaluation_arms(const Experiments& experiments, const ReproduceSettings& settings,
                                 const Evidence& evidence);

/// {name, detector, target, defense?, parts?, rig, judge, mesh, seeds, vehicles, frames, asr: as HidingRates,
/// net?: {vanished, iou50, iou70, distance1m, distance2m: each {value, low, high} or null}, fp_asr, interval:
/// {confidence, drawn}}
nlohmann::json to_json(const Arm& arm);

}  // namespace mirage::paper
