#include "validation/tradeoff/attack_study.h"

#include <algorithm>

#include "attack/attack.h"
#include "attack/evaluation.h"
#include "attack/run.h"
#include "base/interrupt.h"
#include "detection/precision.h"
#include "scene/data/data_rig.h"
#include "simulation/quality.h"
#include "validation/reference/scratch_folder.h"

namespace mirage {
namespace {

constexpr double kLocality = 4;  // m

/// The ways of spending the seconds.
std::vector<TimedAttack> ways_to_attack(const DetectorOptions& options) {
  std::vector<TimedAttack> attacks;
  for (const Quality& quality : qualities())
    attacks.push_back({std::string("quality ") + quality.name, quality.name, options});
  const auto add = [&](const char* name, const auto& change) {
    attacks.push_back({name, "default", options});
    change(attacks.back().detector);
  };
  add("whole passes", [](DetectorOptions& o) { o.clean_memory_mb = 0; });
  if (multiplies_bfloat16()) add("bfloat16", [](DetectorOptions& o) { o.precision = kBfloat16; });
  add("locality 4 m", [](DetectorOptions& o) { o.locality = kLocality; });
  return attacks;
}

}  // namespace

nlohmann::json to_json(const TimedAttack& attack) {
  return {{"name", attack.name},
          {"quality", attack.quality},
          {"precision", attack.detector.precision},
          {"locality", attack.detector.locality},
          {"clean_memory_mb", attack.detector.clean_memory_mb},
          {"seconds", attack.seconds},
          {"iterations", attack.iterations},
          {"loss", attack.loss},
          {"vehicles", attack.vehicles},
          {"asr", attack.asr.value},
          {"fn_asr", attack.fn_asr.value},
          {"fp_asr", attack.fp_asr.value},
          {"asr_interval", {attack.asr.low, attack.asr.high}}};
}

std::vector<TimedAttack> attack_study(const TradeoffSettings& settings) {
  if (settings.attack_seconds <= 0) return {};
  AttackSettings attack;
  static_cast<FrameSource&>(attack) = settings.source;
  attack.seed = settings.seed;
  attack.quiet = settings.quiet;
  attack.iterations = kMostIterations;
  attack.seconds = settings.attack_seconds;
  DetectorOptions options = settings.detector;
  options.rig = data_rig(settings.source.data, settings.source.rig);
  const DetectorPool judges = load_detector_pool(options, attack.batch);
  SimulationSettings exact;
  apply_quality("exact", exact);
  const std::filesystem::path scratch = settings.out / kScratchFolder;
  std::vector<TimedAttack> list = ways_to_attack(options);
  for (TimedAttack& timed : list) {
    throw_if_interrupted("the study goes on from its beginning");
    attack.detector = timed.detector;
    attack.simulation = {};
    apply_quality(timed.quality, attack.simulation);
    std::string folder = "attack " + timed.name;
    std::replace(folder.begin(), folder.end(), ' ', '_');
    // An earlier study's attack stays until this one is finished, whatever ends it before.
    const std::filesystem::path place = settings.out / folder;
    attack.out = scratch / folder;
    std::filesystem::remove_all(attack.out);
    const AttackResult result = run_attack(attack, load_detector_pool(timed.detector, attack.batch));
    std::filesystem::remove_all(place);
    std::filesystem::rename(attack.out, place);
    const Run run = read_run(place);
    FrameStore store(attack);
    EvaluationSettings by;
    by.quiet = settings.quiet;
    const Evaluation judged = evaluate(judges, store, run.test, run.adversary, exact, by);
    timed.seconds = settings.attack_seconds;
    timed.iterations = result.iterations, timed.loss = result.loss;
    timed.vehicles = judged.vehicles;
    timed.fn_asr = judged.fn_interval, timed.fp_asr = judged.fp_interval, timed.asr = judged.asr_interval;
  }
  std::error_code ignored;
  std::filesystem::remove_all(scratch, ignored);
  return list;
}

}  // namespace mirage
