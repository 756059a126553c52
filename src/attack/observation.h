// Where an attack's time goes.
#pragma once

#include <chrono>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>

#include "attack/attack_settings.h"
#include "attack/expectation.h"
#include "attack/object_renderer.h"
#include "detection/detector.h"
#include "frames/host_id.h"
#include "simulation/lidar_silhouette.h"

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

// What a detector is shown of one host in a step of the attack, and the way back through all that made it:
// the simulation, a renderer in place of its rasteriser, and what --expect draws of the world.

/// What draws the object for the detector where it is not the simulation.
struct HostPictures {
  RenderedPictures* pictures = nullptr;  ///< null: the simulation
  const RenderedMesh* of = nullptr;
};

/// One host of a step. What it refers to outlives it.
struct StepHost {
  const PreparedFrame& prepared;
  HostId id;
  Placement placement;
  /// What the detector finds in the frame as recorded: for the objective's top-k rule and for what counts as
  /// hidden.
  std::span<const Detection> clean = {};
  const WorldDraw* draw = nullptr;  ///< null: the world as recorded
  HostPictures seen = {};
};

/// A host with the adversary, as its sensors see it, and the tape of that. `host`, `adversary` and `settings`
/// outlive it.
class Observation {
 public:
  /// Draws the world, simulates both sensors, corrects the picture by the renderer's and adds the camera's
  /// noise.
  Observation(const StepHost& host, const TexturedMesh& adversary, const AttackSettings& settings);
  Observation(const Observation&) = delete;
  Observation& operator=(const Observation&) = delete;

  /// What it is of.
  const StepHost& host() const { return host_; }
  const AttackSettings& settings() const { return settings_; }
  /// Image and sweep with the object.
  const Simulated& simulated() const { return simulated_; }
  /// For a detector that can so much: with the frame as recorded, where that saves it work, and, if the
  /// gradient is wanted (`back`), the places where one more return would count.
  SensorView view(const Capabilities& can, bool back);
  /// d loss / d adversary, of the detector's gradient by what view() showed. What is no input of
  /// settings.target gets none. The noise is held fixed, and so is what the renderer's picture differs by.
  AdversaryGradient vjp(const SensorGradient& gradient) const;
  /// What it took so far: worlds, simulation_forward and rendering.
  const HostSeconds& seconds() const { return seconds_; }

 private:
  const StepHost& host_;
  const AttackSettings& settings_;
  Stopwatch clock_;  ///< before the world, whose time it takes
  DrawnHost world_;
  Simulated simulated_;
  PixelRect changed_;  ///< pixels that are not as recorded, but for noise
  CleanView clean_;
  LidarSilhouette silhouette_;
  HostSeconds seconds_;
};

}  // namespace mirage
