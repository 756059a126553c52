// What a detector is shown of a host with an object, the way back, and where an attack's time goes.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <span>
#include <utility>
#include <vector>

#include "attack/attack_settings.h"
#include "attack/eot.h"
#include "base/schedule.h"
#include "detection/detector.h"
#include "frames/host_id.h"
#include "frames/hosts.h"
#include "simulation/adversary_lidar.h"
#include "simulation/insertion.h"

namespace mirage {

// A renderer that an attack's detector looks through in the place of the rasteriser: its pictures are better,
// take their time and have no derivative. The attack knows no more of it than this
// (validation/blender/blender_process.h is Blender Cycles).

/// A host in the world that a step sees it in.
struct HostInWorld {
  const PreparedFrame& prepared;
  const HostId& host;
  const Placement& placement;  ///< at the host, or one drawn (attack/eot.h)
  const SimulationSettings& simulation;
  std::uint64_t world = 0;  ///< which draw it is of; 0: as recorded, or the only one
};

/// Draws placed objects. Several threads may ask at a time.
class ObjectRenderer {
 public:
  /// A part of the photograph.
  struct Window {
    PixelRect rect;  ///< inside the photograph
    ImageF picture;  ///< rect-sized RGB: the photograph with the object in it, scene-linear, not clamped
  };
  virtual ~ObjectRenderer() = default;
  /// The placed object, behind what the photograph shows in front of it; the same bits for the same
  /// arguments. `simulated`: what the insertion makes of them. Failure if the renderer is lost for good.
  virtual Window draw(const HostInWorld& host, const TexturedMesh& adversary, const Simulated& simulated,
                      std::uint64_t seed) = 0;
  /// What decides its pictures, for a run's identity.
  virtual nlohmann::json identity() const = 0;
};

// An attack's detector looks at the pictures of an ObjectRenderer, and the gradient goes through the
// insertion's own rasteriser. With x the mesh, R the rasteriser's picture, C the renderer's and x₀ the mesh
// that C was last drawn of, the detector is shown
//
//     P(x) = R(x) + (C(x₀) − R(x₀))
//
// and d P / d x = d R / d x: R is the control variate of C (Owen, Monte Carlo theory, methods and examples,
// 2013, section 8.9). Where x = x₀ the detector sees C itself, with the gradient taken straight through
// (Bengio, Léonard, Courville, 2013); between two draws the picture still follows the mesh. x₀ is one mesh
// for all hosts: a checkpoint holds it, and the pictures are made anew from it to the same bits.

/// The mesh that pictures are drawn of, and the number of steps after which it was the adversary's.
struct RenderedMesh {
  long iteration = -1;  ///< −1: of no step of the attack
  TexturedMesh mesh;
};

/// Whether it has moved further, in either way. With 0 every change counts.
bool has_moved(const TexturedMesh& from, const TexturedMesh& to, const RedrawLimits& renewal);

/// Corrections C(x₀) − R(x₀), kept while x₀ stays. Several threads may ask.
class RenderedPictures {
 public:
  /// Noise is drawn by seed, host and iteration. `renderer` outlives it.
  RenderedPictures(ObjectRenderer& renderer, std::uint64_t seed) : renderer_(renderer), seed_(seed) {}

  /// Turns R(adversary), which `simulated` holds, into P: image and radiance. Returns the window that changed
  /// beside `simulated.rect`. Pictures of a mesh of no step (iteration −1) are not kept.
  PixelRect correct(const HostInWorld& host, const TexturedMesh& adversary, const RenderedMesh& rendered,
                    Simulated& simulated);

 private:
  struct Correction {
    std::uint64_t world = 0;
    PixelRect rect;
    ImageF difference;  ///< rect-sized
  };
  std::shared_ptr<const Correction> make(const HostInWorld& host, const TexturedMesh& adversary,
                                         const RenderedMesh& rendered, const Simulated& simulated) const;

  ObjectRenderer& renderer_;
  std::uint64_t seed_;
  std::mutex mutex_;
  long iteration_ = -1;                                                   ///< that the kept ones are of
  std::size_t kept_ = 0;                                                  ///< values
  std::map<std::string, std::shared_ptr<const Correction>> corrections_;  ///< by host
};

// What a detector is shown of a frame with an object in it.

/// For a detector that can so much. Of the sensors beside the first camera and the LiDAR the view has those
/// that the detector reads by name and the object may have changed.
SensorView view_of(const PreparedFrame& prepared, const Simulated& simulated, const Capabilities& can);

/// The frame without the object, as a detector may use it to compute only what the object changes (of the
/// picture: `changed`): views of
/// `prepared`, which must outlive it. The key is a hash of the picture, the sweep and the calibration.
UnchangedInput unchanged_input(const PreparedFrame& prepared, const PixelRect& changed);

/// Seconds between calls.
class Stopwatch {
 public:
  /// Since the last lap or the construction.
  double lap() {
    const auto now = Clock::now();
    return std::chrono::duration<double>(now - std::exchange(last_, now)).count();
  }

 private:
  Clock::time_point last_ = Clock::now();
};

/// Of one host: its thread's seconds by the clock on the wall. `worlds`: what --expect draws;
/// `rendering`: an ObjectRenderer's pictures; `rest`: the objective.
struct HostTimings {
  double simulation_forward = 0, simulation_vjp = 0, detector_forward = 0, detector_backward = 0;
  double worlds = 0, rendering = 0, rest = 0;
  /// Adds stage by stage.
  HostTimings& operator+=(const HostTimings& other);
};

/// Of iterations, in this process. The first five are wall seconds, one after another; `threads` are summed
/// over the hosts that were simulated within `hosts`, several at a time.
struct StepTimings {
  double input = 0;      ///< waiting for frames that were not read ahead
  double hosts = 0;      ///< simulating, detecting, and back
  double exchange = 0;   ///< waiting for the other ranks and their gradients
  double optimiser = 0;  ///< sum, smoothness, Adam, projection
  double files = 0;      ///< checkpoints
  HostTimings threads;
  /// Adds stage by stage.
  StepTimings& operator+=(const StepTimings& other);
};

/// Means over iterations; `seconds`: wall seconds of all of them, `workers`: threads that share the hosts.
nlohmann::json to_json(const StepTimings& stages, double seconds, long iterations, std::size_t workers);

// What a detector is shown of one host, and the way back through all that made it: the simulation, a renderer
// in place of its rasteriser, and what --expect draws of the world.

/// One host with an object. What it refers to must outlive it.
struct StepHost {
  const PreparedFrame& prepared;
  HostId id;
  Placement placement;
  /// What the detector finds in the frame as recorded: for the objective's top-k rule and for what counts as
  /// hidden.
  std::span<const Detection> clean = {};
  const SampledEnvironment* draw = nullptr;  ///< null: the world as recorded
  RenderedPictures* pictures = nullptr;      ///< draws the object in place of the simulation; null: that
  const RenderedMesh* rendered = nullptr;    ///< with `pictures`: what these are of
};

/// A host with the adversary, as its sensors see it, and the tape of that. `host` and `adversary` outlive it.
class Observation {
 public:
  /// Draws the world, simulates both sensors, corrects the picture by the renderer's and adds the camera's
  /// noise.
  Observation(const StepHost& host, const TexturedMesh& adversary, const SimulationSettings& simulation);
  Observation(const Observation&) = delete;
  Observation& operator=(const Observation&) = delete;

  /// What it is of.
  const StepHost& host() const { return host_; }
  /// Image and sweep with the object.
  const Simulated& simulated() const { return simulated_; }
  /// In the drawn world.
  const Placement& placement() const { return world_.placement(); }
  /// Whether pixels differ from the recorded ones away from the object: exposure, noise.
  bool changes_picture() const { return host_.draw && host_.draw->expectation().any_in_picture(); }
  /// For a detector that can so much. `local`: with the frame as recorded, so that it computes only what the
  /// object changes.
  SensorView view(const Capabilities& can, bool local);
  /// Adds the places where one more return would count, for a detector that knows presence: with
  /// LidarGradient::silhouette they get a gradient, too.
  void watch(SensorView& view);
  /// d loss / d adversary, of the detector's gradient by what view() showed. What is no input of `target`
  /// gets none. The noise is held fixed, and so is what the renderer's picture differs by.
  AdversaryGradient vjp(const SensorGradient& gradient, AttackTarget target) const;
  /// What it took so far: worlds, simulation_forward and rendering.
  const HostTimings& seconds() const { return seconds_; }

 private:
  const StepHost& host_;
  Stopwatch clock_;  ///< before the world, whose time it takes
  SampledHost world_;
  Simulated simulated_;
  PixelRect changed_;  ///< pixels that are not as recorded, but for noise
  UnchangedInput clean_;
  LidarSilhouette silhouette_;
  HostTimings seconds_;
};

}  // namespace mirage
