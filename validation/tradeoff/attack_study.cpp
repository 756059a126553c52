#include "validation/tradeoff/attack_study.h"

#include <algorithm>

#include "attack/attack.h"
#include "attack/evaluation.h"
#include "attack/run.h"
#include "base/interrupt.h"
#include "detection/precision.h"
#include "scene/data/data_rig.h"
#include "simulation/quality.h"

namespace mirage {
namespace {

constexpr double kLocality = 4;  // m

/// One way of spending the seconds.
struct Arm {
  std::string name, quality;
  DetectorOptions detector;
};

std::vector<Arm> attack_arms(const DetectorOptions& options) {
  std::vector<Arm> arms;
  for (const Quality& quality : qualities())
    arms.push_back({std::string("quality ") + quality.name, quality.name, options});
  const auto add = [&](const char* name, const auto& change) {
    arms.push_back({name, "default", options});
    change(arms.back().detector);
  };
  add("whole passes", [](DetectorOptions& o) { o.clean_memory_mb = 0; });
  if (multiplies_bfloat16()) add("bfloat16", [](DetectorOptions& o) { o.precision = kBfloat16; });
  add("locality 4 m", [](DetectorOptions& o) { o.locality = kLocality; });
  return arms;
}

}  // namespace

nlohmann::json attack_study(const TradeoffSettings& settings) {
  AttackSettings attack;
  static_cast<FrameSource&>(attack) = settings.source;
  attack.seed = settings.seed;
  attack.quiet = settings.quiet;
  attack.iterations = kMostIterations;
  attack.seconds = settings.attack_seconds;
  DetectorOptions options = settings.detector;
  options.rig = data_rig(settings.source.data);
  const DetectorPool judges = load_detector_pool(options, attack.batch);
  SimulationSettings exact;
  apply_quality("exact", exact);
  nlohmann::json list = nlohmann::json::array();
  for (const Arm& arm : attack_arms(options)) {
    throw_if_interrupted("the study goes on from its beginning");
    attack.detector = arm.detector;
    attack.simulation = {};
    apply_quality(arm.quality, attack.simulation);
    std::string folder = "attack " + arm.name;
    std::replace(folder.begin(), folder.end(), ' ', '_');
    attack.out = settings.out / folder;
    std::filesystem::remove_all(attack.out);
    const AttackResult result = run_attack(attack, load_detector_pool(arm.detector, attack.batch));
    const Run run = read_run(attack.out);
    FrameStore store(attack);
    EvaluationSettings by;
    by.quiet = settings.quiet;
    const Evaluation judged = evaluate(judges, store, run.test, run.adversary, exact, by);
    list.push_back({{"name", arm.name},
                    {"quality", arm.quality},
                    {"precision", arm.detector.precision},
                    {"locality", arm.detector.locality},
                    {"clean_memory_mb", arm.detector.clean_memory_mb},
                    {"seconds", settings.attack_seconds},
                    {"iterations", result.iterations},
                    {"loss", result.loss},
                    {"vehicles", judged.vehicles},
                    {"asr", judged.asr},
                    {"fn_asr", judged.fn_asr},
                    {"fp_asr", judged.fp_asr},
                    {"asr_interval", {judged.asr_interval.low, judged.asr_interval.high}}});
  }
  return list;
}

}  // namespace mirage
