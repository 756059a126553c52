// What one host adds to a step of the attack.
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

/// Loss and gradient of one host: simulation, detector, objective and their VJPs. With a draw, of the host in
/// that world.
struct HostStep {
  double hide = 0, false_positive = 0;
  bool found = false;  ///< as recorded, at the score and IoU of an evaluation (EvaluationSettings)
  /// Found as recorded, and by no proposal of this step. An indication that costs no forward pass: taken
  /// before suppression, and never used by the optimiser.
  bool hidden = false;
  AdversaryGradient gradient;
  HostTimings seconds;
};

// One Adam step of the adversary: what an attack repeats, and what adversarial training does between two
// updates of the model.

/// One host of an iteration: simulates both sensors with the adversary placed (in the host's drawn world if
/// there is one), detects, and takes the loss of the placement's targets back to the adversary's vertices (m,
/// adversary frame) and texels. Inputs outside settings.target get no gradient, but are simulated all the
/// same. With `back` false the gradient is empty.
HostStep attack_host(Detector& detector, const StepHost& host, const TexturedMesh& adversary,
                     const AttackSettings& settings, bool back = true);

/// attack_host() in draw `number` of the world: with
/// EotSettings::worst in the candidate of it that has the greatest loss (the first of equals), and without
/// anything that varies in the world as recorded. `host` has no draw of its own. Its seconds are of all
/// candidates together.
HostStep step_host(Detector& detector, StepHost host, const TexturedMesh& adversary,
                   const AttackSettings& settings, std::uint64_t number, bool back);

/// Steps of one attack. Its arguments must outlive it.
class AttackStepper {
 public:
  /// `mesh`: the adversary's, for its faces. `clean_cache`: what other steppers of the same detector have
  /// seen.
  AttackStepper(const AttackSettings& settings, const DetectorPool& detectors, FrameStore& store,
                const std::vector<Host>& hosts, const Mesh& mesh,
                std::shared_ptr<CleanDetectionCache> clean_cache = std::make_shared<CleanDetectionCache>());
  /// Renews state.rendered where the mesh has moved from it. Then the
  /// mean gradient over the hosts of state.iteration (spread over detectors and ranks, summed in the batch's
  /// order), Adam, projection; ++state.iteration, and its row of losses is kept. Failure if a gradient, or
  /// what weights and rates make of it, is not finite: it would poison the checkpoint. The frames of the next
  /// iteration are read meanwhile. What it takes is added to `spent`.
  LossRow step(AttackState& state, StepTimings* spent = nullptr) const;
  /// A mesh as it is: means of these hosts' losses, and the smoothness. The same on every rank, and for the
  /// same mesh in any iteration: what --expect draws is world `first_world` + k for host k (or the worst of
  /// its candidates), and a renderer draws this very mesh. What it takes is added to `spent`.
  LossRow judge(const TexturedMesh& adversary, const std::vector<Host>& hosts, std::uint64_t first_world,
                StepTimings* spent = nullptr) const;
  /// The objective on hosts that are not learned on, in worlds beyond those of any step.
  double held_out(const TexturedMesh& adversary, const std::vector<Host>& hosts) const;

 private:
  /// The hosts' steps in their order, on every rank: host k in world `first_world` + k. `meanwhile` is done
  /// after this rank's, before it waits for those of others.
  std::vector<HostStep> steps_of(const std::vector<HostId>& hosts, const TexturedMesh& adversary,
                                 const RenderedMesh& rendered, std::uint64_t first_world, bool back,
                                 StepTimings& stages, const std::function<void()>& meanwhile) const;
  /// Means over the hosts' losses, and the smoothness, whose gradient is added to `d_vertices`.
  LossRow row_of(const std::vector<HostStep>& steps, const std::vector<Vec3d>& vertices,
                 std::vector<Vec3d>& d_vertices) const;
  /// Hosts of an iteration.
  std::vector<HostId> batch(long iteration) const;
  /// While other ranks are at their hosts, has the detector keep what it keeps of these frames, but for those
  /// that it has just seen. Changes nothing but time.
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
