#include "attack/stages.h"

#include "base/ranks.h"

namespace mirage {

HostSeconds& HostSeconds::operator+=(const HostSeconds& other) {
  simulation_forward += other.simulation_forward;
  simulation_vjp += other.simulation_vjp;
  detector_forward += other.detector_forward;
  detector_backward += other.detector_backward;
  worlds += other.worlds;
  rendering += other.rendering;
  rest += other.rest;
  return *this;
}

StageSeconds& StageSeconds::operator+=(const StageSeconds& other) {
  input += other.input;
  hosts += other.hosts;
  exchange += other.exchange;
  optimiser += other.optimiser;
  files += other.files;
  threads += other.threads;
  return *this;
}

nlohmann::json to_json(const StageSeconds& stages, double seconds, long iterations, std::size_t workers) {
  const double n = iterations > 0 ? static_cast<double>(iterations) : 1;
  const double known = stages.input + stages.hosts + stages.exchange + stages.optimiser + stages.files;
  const HostSeconds& t = stages.threads;
  return {{"iterations", iterations},
          {"threads", workers},
          {"ranks", rank_count()},
          {"wall_seconds",
           {{"input", stages.input / n},
            {"hosts", stages.hosts / n},
            {"exchange", stages.exchange / n},
            {"optimiser", stages.optimiser / n},
            {"files", stages.files / n},
            {"rest", (seconds - known) / n},
            {"total", seconds / n}}},
          {"thread_seconds",
           {{"simulation_forward", t.simulation_forward / n},
            {"simulation_vjp", t.simulation_vjp / n},
            {"detector_forward", t.detector_forward / n},
            {"detector_backward", t.detector_backward / n},
            {"worlds", t.worlds / n},
            {"rendering", t.rendering / n},
            {"rest", t.rest / n}}}};
}

}  // namespace mirage
