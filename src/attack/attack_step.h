// The loss and gradient of one host in a step of the attack.
#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "attack/attack_hosts.h"
#include "attack/attack_settings.h"
#include "attack/checkpoint.h"
#include "attack/clean_detections.h"
#include "attack/detector_pool.h"
#include "attack/observation.h"
#include "frames/hosts.h"
#include "geometry/mesh.h"
#include "simulation/simulation.h"

namespace mirage {

/// Loss and gradient of one host: simulation, detector, objective and their VJPs. With a draw, in that drawn
/// world.
struct HostStep {
  double hide = 0, false_positive = 0;
  bool found = false;  ///< as recorded, at the score and IoU of an evaluation (EvaluationSettings)
  /// Found as recorded, but by no proposal of this step. A progress indicator without an extra forward pass:
  /// computed before suppression, and never used by the optimiser.
  bool hidden = false;
  AdversaryGradient gradient;
  HostTimings seconds;
};

// One Adam step of the adversary, as repeated by an attack, and by adversarial training between two updates
// of the model.

/// One host of an iteration: simulates both sensors with the placed adversary (in the host's drawn world if
/// there is one), runs the detector, and computes the loss of the placement's targets. Its gradient is with
/// respect to the adversary's vertices (m, adversary frame) and texels. Inputs outside settings.target are
/// simulated, but get no gradient. The gradient is empty if `back` is false.
HostStep attack_host(Detector& detector, const StepHost& host, const TexturedMesh& adversary,
                     const AttackSettings& settings, bool back = true);

/// attack_host() in draw `number` of the world. With EotSettings::worst it uses the candidate draw with the
/// greatest loss (the first of equals); if nothing varies, the world as recorded. `host` has no draw yet. The
/// seconds sum over all candidates.
HostStep step_host(Detector& detector, StepHost host, const TexturedMesh& adversary,
                   const AttackSettings& settings, std::uint64_t number, bool back);

/// Steps of one attack. Its arguments must outlive it.
class AttackStepper {
 public:
  /// `mesh`: the adversary's, for its faces. `clean_cache`: shared with other steppers of the same detector.
  AttackStepper(const AttackSettings& settings, const DetectorPool& detectors, FrameStore& store,
                const std::vector<Host>& hosts, const Mesh& mesh,
                std::shared_ptr<CleanDetectionCache> clean_cache = std::make_shared<CleanDetectionCache>());
  /// Updates state.rendered if the mesh has moved away from it. Then computes the mean gradient over the
  /// hosts of state.iteration (spread over detectors and ranks, summed in the batch's order), takes the Adam
  /// step, and projects. Adds the loss row and increments state.iteration. Failure if a gradient, or the step
  /// that weights and rates make of it, is not finite: it would poison the checkpoint. Prefetches the next
  /// iteration's frames. Adds its times to `spent`.
  LossRow step(AttackState& state, StepTimings* spent = nullptr) const;
  /// Losses of a mesh without a step: means over these hosts, and the smoothness. The result is the same on
  /// every rank and in any iteration: host k is in drawn world `first_world` + k (or the worst of its
  /// candidates), and a renderer draws this very mesh. Adds its times to `spent`.
  LossRow judge(const TexturedMesh& adversary, const std::vector<Host>& hosts, std::uint64_t first_world,
                StepTimings* spent = nullptr) const;
  /// The objective on validation hosts, in worlds that no step uses.
  double held_out(const TexturedMesh& adversary, const std::vector<Host>& hosts) const;

 private:
  /// The hosts' steps in their order, on every rank: host k in world `first_world` + k. `meanwhile` runs
  /// after this rank's own hosts, before it waits for other ranks.
  std::vector<HostStep> steps_of(const std::vector<HostId>& hosts, const TexturedMesh& adversary,
                                 const RenderedMesh& rendered, std::uint64_t first_world, bool back,
                                 StepTimings& stages, const std::function<void()>& meanwhile) const;
  /// Means of the hosts' losses, and the smoothness; adds the gradient of the smoothness to `d_vertices`.
  LossRow row_of(const std::vector<HostStep>& steps, const std::vector<Vec3d>& vertices,
                 std::vector<Vec3d>& d_vertices) const;
  /// The hosts of an iteration.
  std::vector<HostId> batch(long iteration) const;
  /// While other ranks work on their hosts, lets the detector cache its clean activations of frames `next`,
  /// except those in `seen`. Affects speed only.
  void open_ahead(std::span<const std::string> next, std::span<const std::string> seen) const;

  const AttackSettings& settings_;
  const DetectorPool& detectors_;
  FrameStore& store_;
  const std::vector<Host>& hosts_;
  HostOrder order_;
  Laplacian laplacian_;
  std::vector<Vec3d> unit_;  ///< --parts size: the start's vertices in a box of half lengths 1
  std::shared_ptr<CleanDetectionCache> clean_cache_;
  std::unique_ptr<RenderedPictures> pictures_;  ///< null without a renderer
};

}  // namespace mirage
