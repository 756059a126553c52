// Where an attack's time goes.
#pragma once

#include <chrono>
#include <nlohmann/json.hpp>

namespace mirage {

/// Seconds between calls.
class Stopwatch {
 public:
  /// Since the last lap or the construction.
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    const double seconds = std::chrono::duration<double>(now - last_).count();
    last_ = now;
    return seconds;
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

/// Of one host: its thread's seconds by the clock on the wall. `worlds`: what --expect draws;
/// `rendering`: an ObjectRenderer's pictures; `rest`: the objective.
struct HostSeconds {
  double simulation_forward = 0, simulation_vjp = 0, detector_forward = 0, detector_backward = 0;
  double worlds = 0, rendering = 0, rest = 0;
  /// Adds stage by stage.
  HostSeconds& operator+=(const HostSeconds& other);
};

/// Of iterations, in this process. The first five are wall seconds, one after another; `threads` are summed
/// over the hosts that were simulated within `hosts`, several at a time.
struct StageSeconds {
  double input = 0;      ///< waiting for frames that were not read ahead
  double hosts = 0;      ///< simulating, detecting, and back
  double exchange = 0;   ///< waiting for the other ranks and their gradients
  double optimiser = 0;  ///< sum, smoothness, Adam, projection
  double files = 0;      ///< checkpoints
  HostSeconds threads;
  /// Adds stage by stage.
  StageSeconds& operator+=(const StageSeconds& other);
};

/// Means over iterations; `seconds`: wall seconds of all of them, `workers`: threads that share the hosts.
nlohmann::json to_json(const StageSeconds& stages, double seconds, long iterations, std::size_t workers);

}  // namespace mirage
