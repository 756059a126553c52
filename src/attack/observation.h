// A detector's view of a host with an object, its VJP, and the time of an attack's stages.
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

// A renderer can replace the rasteriser in the detector's view: its pictures are better, but slow and not
// differentiable. This interface is all that the attack knows of it (validation/blender/blender_process.h is
// Blender Cycles).

/// A host in the drawn world of a step.
struct HostInWorld {
  const PreparedFrame& prepared;
  const HostId& host;
  const Placement& placement;  ///< at the host, or one drawn (attack/eot.h)
  const SimulationSettings& simulation;
  std::uint64_t world = 0;  ///< number of the draw; 0: as recorded, or the only draw
};

/// Draws placed objects. Thread-safe.
class ObjectRenderer {
 public:
  /// A rendered part of the photograph.
  struct Window {
    PixelRect rect;  ///< inside the photograph
    ImageF picture;  ///< rect-sized RGB: the photograph with the object in it, scene-linear, not clamped
  };
  virtual ~ObjectRenderer() = default;
  /// Draws the placed object, occluded by the photograph's nearer surfaces; the same bits for the same
  /// arguments. `simulated`: the insertion's result for them. Failure if the renderer has failed permanently.
  virtual Window draw(const HostInWorld& host, const TexturedMesh& adversary, const Simulated& simulated,
                      std::uint64_t seed) = 0;
  /// All settings that decide its pictures, for a run's identity.
  virtual nlohmann::json identity() const = 0;
};

// An attack's detector looks at the pictures of an ObjectRenderer, and the gradient goes through the
// insertion's own rasteriser. With x the mesh, R the rasteriser's picture, C the renderer's and x₀ the mesh
// of the last C, the detector sees
//
//     P(x) = R(x) + (C(x₀) − R(x₀))
//
// and d P / d x = d R / d x: R is the control variate of C (Owen, Monte Carlo theory, methods and examples,
// 2013, section 8.9). At x = x₀ the detector sees C itself, with a straight-through gradient (Bengio,
// Léonard, Courville, 2013). Between two renderings the picture still follows the mesh. x₀ is one mesh for
// all hosts. A checkpoint holds it, and its pictures are redrawn to the same bits.

/// The mesh of the rendered pictures, and the attack's iteration at which it was the adversary.
struct RenderedMesh {
  long iteration = -1;  ///< −1: no step of the attack
  TexturedMesh mesh;
};

/// Whether vertices or texels have moved further than the limits. With 0 every change counts.
bool has_moved(const TexturedMesh& from, const TexturedMesh& to, const RedrawThresholds& redraw);

/// Corrections C(x₀) − R(x₀), cached while x₀ stays the same. Thread-safe.
class RenderedPictures {
 public:
  /// Noise is drawn by seed, host and iteration. `renderer` outlives it.
  RenderedPictures(ObjectRenderer& renderer, std::uint64_t seed) : renderer_(renderer), seed_(seed) {}

  /// Turns R(adversary), which `simulated` holds, into P: image and radiance. Returns the window that it
  /// changed, besides `simulated.rect`. Pictures with iteration −1 are not cached.
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
  long iteration_ = -1;                                                   ///< of the cached corrections
  std::size_t kept_ = 0;                                                  ///< values
  std::map<std::string, std::shared_ptr<const Correction>> corrections_;  ///< by host
};

// A detector's view of a frame with an object in it.

/// For a detector with these capabilities. Besides the first camera and the LiDAR, the view has the sensors
/// that the detector reads by name and the object may have changed.
SensorView view_of(const PreparedFrame& prepared, const Simulated& simulated, const Capabilities& can);

/// The frame without the object, from which a detector may compute only the object's changes (in the picture:
/// `changed`). Holds views of `prepared`, which must outlive it. The key is a hash of picture, sweep and
/// calibration.
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

/// Wall-clock seconds of one host's thread. `worlds`: the draws of --expect; `rendering`: an ObjectRenderer's
/// pictures; `rest`: the objective.
struct HostTimings {
  double simulation_forward = 0, simulation_vjp = 0, detector_forward = 0, detector_backward = 0;
  double worlds = 0, rendering = 0, rest = 0;
  /// Adds stage by stage.
  HostTimings& operator+=(const HostTimings& other);
};

/// Seconds of this process's iterations. The first five are consecutive wall-clock times; `threads` sums over
/// the hosts, which run in parallel within `hosts`.
struct StepTimings {
  double input = 0;      ///< waiting for frames that were not read ahead
  double hosts = 0;      ///< simulation, detection, and their VJPs
  double exchange = 0;   ///< waiting for the other ranks and their gradients
  double optimiser = 0;  ///< sum, smoothness, Adam, projection
  double files = 0;      ///< checkpoints
  HostTimings threads;
  /// Adds stage by stage.
  StepTimings& operator+=(const StepTimings& other);
};

/// Means per iteration; `seconds`: wall-clock seconds of all iterations, `workers`: threads that share the
/// hosts.
nlohmann::json to_json(const StepTimings& stages, double seconds, long iterations, std::size_t workers);

// A detector's view of one host, and the VJP through all its stages: the simulation, a renderer in place of
// its rasteriser, and the draws of --expect.

/// One host with an object. Objects that it refers to must outlive it.
struct StepHost {
  const PreparedFrame& prepared;
  HostId id;
  Placement placement;
  /// Detections in the frame as recorded: for the objective's top-k rule and for HostStep::hidden.
  std::span<const Detection> clean = {};
  const SampledEnvironment* draw = nullptr;  ///< null: the world as recorded
  RenderedPictures* pictures = nullptr;      ///< draws the object; null: the simulation does
  const RenderedMesh* rendered = nullptr;    ///< with `pictures`: their mesh
};

/// A host with the adversary as its sensors see it, and the tape for the VJP. `host` and `adversary` must
/// outlive it.
class Observation {
 public:
  /// Draws the world, simulates both sensors, corrects the picture by the renderer's, and adds camera noise.
  Observation(const StepHost& host, const TexturedMesh& adversary, const SimulationSettings& simulation);
  Observation(const Observation&) = delete;
  Observation& operator=(const Observation&) = delete;

  /// The observed host.
  const StepHost& host() const { return host_; }
  /// Image and sweep with the object.
  const Simulated& simulated() const { return simulated_; }
  /// The object's placement in the drawn world.
  const Placement& placement() const { return world_.placement(); }
  /// Whether pixels differ from the recorded ones away from the object: exposure, noise.
  bool changes_picture() const { return host_.draw && host_.draw->expectation().any_in_picture(); }
  /// For a detector with these capabilities. `local`: includes the frame without the object, so that the
  /// detector computes only the object's changes.
  SensorView view(const Capabilities& can, bool local);
  /// With LidarGradient::silhouette, adds the places where an additional return would matter, so that a
  /// detector with presence gradients returns one there, too.
  void watch(SensorView& view);
  /// Returns d loss / d adversary from the detector's gradient with respect to view(). Inputs outside
  /// `target` get no gradient. The noise and the renderer's correction are held fixed.
  AdversaryGradient vjp(const SensorGradient& gradient, AttackTarget target) const;
  /// Seconds so far: worlds, simulation_forward and rendering.
  const HostTimings& seconds() const { return seconds_; }

 private:
  const StepHost& host_;
  Stopwatch clock_;  ///< declared before world_, whose construction it times
  SampledHost world_;
  Simulated simulated_;
  PixelRect changed_;  ///< pixels that differ from the recorded ones, except by noise
  UnchangedInput clean_;
  LidarSilhouette silhouette_;
  HostTimings seconds_;
};

}  // namespace mirage
