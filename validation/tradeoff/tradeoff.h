// The results of a speed–accuracy study.
#pragma once

#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "attack/observation.h"
#include "base/intervals.h"
#include "detection/detector.h"
#include "geometry/mesh.h"
#include "validation/reference/reference_renderer.h"
#include "validation/tradeoff/points.h"
#include "validation/tradeoff/sensor_studies.h"
#include "validation/tradeoff/subjects.h"

namespace mirage {

// Attack success at equal time: one short attack in each way of trading accuracy for speed.

/// An attack of equal time, and how it fared.
struct TimedAttack {
  std::string name, quality;
  DetectorOptions detector;
  double seconds = 0;                           ///< of iterations
  int iterations = 0;                           ///< made in them
  double loss = 0;                              ///< AttackResult::loss
  int vehicles = 0;                             ///< held back and detected clean
  Interval fn_asr = {}, fp_asr = {}, asr = {};  ///< 95 %
};

/// {name, quality, precision, locality, clean_memory_mb, seconds, iterations, loss, vehicles, asr, fn_asr,
/// fp_asr, asr_interval: [low, high]}
nlohmann::json to_json(const TimedAttack& attack);

/// For each quality, then for whole passes, bfloat16 and a locality of 4 m at the default quality: an attack
/// of settings.attack_seconds of iterations on the data set's training vehicles (made anew; once it is
/// finished it is OUT/attack_NAME), then its success on the held-back ones, simulated at `exact` and detected
/// in float over what the object changes for all alike. The attacks' success depends on the machine. Empty if
/// attack_seconds is 0.
std::vector<TimedAttack> attack_study(const TradeoffSettings& settings);

// The detector's side of the speed–accuracy study: one attack step of a host (simulation, detector,
// objective, and back) with the detector's passes made in several ways.

/// Axes: "passes" (over the whole frame; over what the object changes, which is the default and the
/// baseline), "precision" (bfloat16 where the processor multiplies it), and "locality" (1, 2, 4, 8 m of
/// surroundings). Errors: "gradient_cosine" and "gradient_norm" of the adversary's gradient (vertices and
/// texels) against that of whole passes in double, "gradient" = 1 − the cosine, and "gradient_cosine_least",
/// the worst host's; means over hosts whose reference is not zero. Times: CPU time of one thread, clean
/// frames kept, medians of `repeats` in alternation with the baseline. Empty if every reference is zero.
/// InputError, FieldError as load_detector has them.
std::vector<TradeoffPoint> detector_points(const DetectorOptions& options, const std::vector<StepHost>& hosts,
                                           const TexturedMesh& adversary, int repeats);

/// The quality of the camera's references; means over hosts.
struct CameraReference {
  double self_cosine = 0;   ///< CameraStudy::self_cosine
  Agreement sharp;          ///< CameraStudy::sharp_agreement
  std::vector<int> pixels;  ///< of each host's object
};

struct TradeoffResult {
  TradeoffSettings settings;          ///< `source`: the frames that were used
  std::vector<HostId> hosts;          ///< by distance
  std::size_t frames = 0;             ///< that they stand in
  std::vector<TradeoffPoint> points;  ///< of all groups, their fronts marked
  CameraReference reference;
  std::string depth_reference;  ///< of depth completion, in words; empty where it was not scored
  std::vector<TimedAttack> attacks;
  /// Names of the pictures in `out`: none without matplotlib, no list before they are drawn.
  std::optional<std::vector<std::string>> plots;
  std::filesystem::path page;  ///< empty if there is none

  /// By the camera's points, each beside the shipped setting; empty without the grid. Points into `points`.
  std::vector<Recommendation> recommended() const;
};

/// {settings, ratio, ms, errors, on_front: of the point, if there is one; name, rule, shipped: the same of
/// it}
nlohmann::json to_json(const Recommendation& advice);
/// {frames, vehicles, hosts, pixels, seed, repeats, data, depth, rooftop, reference, baseline, points,
/// recommended, attack, plots?, page?}
nlohmann::json to_json(const TradeoffResult& result);

// The speed–accuracy study: every setting that trades speed for accuracy, measured on the same hosts in the
// same run, with the fronts and the settings that follow from them (`mirage tradeoff`).

/// Runs it, writes OUT/tradeoff.json (to_json of the result without its plots and page), and with matplotlib
/// OUT/tradeoff.{png,svg} and tradeoff.html. InputError for numbers out of range, and if no vehicle can be
/// used. `start`: starts the renderer of settings.cycles.
TradeoffResult tradeoff(const TradeoffSettings& settings, const StartReference& start = {});

}  // namespace mirage
