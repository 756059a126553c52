#include "validation/tradeoff_attack.h"

#include <limits>

#include "attack/attack.h"
#include "attack/evaluation.h"
#include "attack/run.h"
#include "base/interrupt.h"
#include "scene/quality.h"

namespace mirage {

nlohmann::json attack_study(const TradeoffSettings& settings) {
  AttackSettings attack;
  static_cast<FrameSource&>(attack) = settings.source;
  attack.detector = settings.detector;
  attack.seed = settings.seed;
  attack.quiet = settings.quiet;
  attack.iterations = std::numeric_limits<int>::max();
  attack.seconds = settings.attack_seconds;
  attack.vertex_rate = 5e-3;  // five times the paper's: seconds, not hours
  attack.texel_rate = 2e-2;
  const DetectorPool detectors = load_detector_pool(settings.detector, attack.batch);
  SimulationSettings exact;
  apply_quality("exact", exact);
  nlohmann::json list = nlohmann::json::array();
  for (const Quality& quality : qualities()) {
    throw_if_interrupted("the study goes on from its beginning");
    attack.simulation = {};
    apply_quality(quality.name, attack.simulation);
    attack.out = settings.out / (std::string("attack_") + quality.name);
    std::filesystem::remove_all(attack.out);
    const AttackResult result = run_attack(attack, detectors);
    const Run run = read_run(attack.out);
    FrameStore store(attack);
    EvaluationSettings by;
    by.quiet = settings.quiet;
    const Evaluation judged = evaluate(detectors, store, run.test, run.adversary, exact, by);
    list.push_back({{"quality", quality.name},
                    {"seconds", settings.attack_seconds},
                    {"iterations", result.iterations},
                    {"loss", result.loss},
                    {"vehicles", judged.vehicles},
                    {"asr", judged.asr},
                    {"fn_asr", judged.fn_asr},
                    {"fp_asr", judged.fp_asr}});
  }
  return list;
}

}  // namespace mirage
