// One Adam step of the adversary: what an attack repeats, and what adversarial training does between two
// updates of the model.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "attack/attack_settings.h"
#include "attack/checkpoint.h"
#include "attack/clean_sights.h"
#include "attack/detector_pool.h"
#include "attack/host_order.h"
#include "attack/host_step.h"
#include "attack/rendered_pictures.h"
#include "attack/stages.h"
#include "frames/hosts.h"
#include "geometry/laplacian.h"

namespace mirage {

/// What draws the object for the detector where it is not the simulation.
struct HostPictures {
  RenderedPictures* pictures = nullptr;  ///< null: the simulation
  const RenderedMesh* of = nullptr;
};
/// One host of an iteration: simulates both sensors with the adversary on its roof (in `draw`'s world if
/// there is one), detects, and takes the loss back to the adversary's vertices (m, adversary frame) and
/// texels. What is no input of `target` gets no gradient, but is simulated all the same. `clean`: what the
/// detector finds in the frame as recorded, for the objective's top-k rule and for what counts as hidden.
/// `seen`: see attack/rendered_pictures.h.
HostStep attack_host(Detector& detector, const PreparedFrame& prepared, const Host& host,
                     const TexturedMesh& adversary, AttackTarget target, const AttackSettings& settings,
                     const WorldDraw* draw = nullptr, std::span<const Proposal> clean = {},
                     const HostPictures& seen = {});
/// The same without the way back: its gradient is empty.
HostStep judge_host(Detector& detector, const PreparedFrame& prepared, const Host& host,
                    const TexturedMesh& adversary, const AttackSettings& settings,
                    const WorldDraw* draw = nullptr, std::span<const Proposal> clean = {},
                    const HostPictures& seen = {});

/// Steps of one attack. What it is given outlives it.
class AttackStepper {
 public:
  /// `mesh`: the adversary's, for its faces. `sights`: what other steppers of the same detector have seen.
  /// InputError for a target or parts of another word.
  AttackStepper(const AttackSettings& settings, const DetectorPool& detectors, FrameStore& store,
                const std::vector<Host>& hosts, const Mesh& mesh,
                std::shared_ptr<CleanSights> sights = std::make_shared<CleanSights>());
  /// Renews state.rendered where the mesh has moved from it. Then the
  /// mean gradient over the hosts of state.iteration (spread over detectors and ranks, summed in the batch's
  /// order), Adam, projection; ++state.iteration, and its row of losses is kept. Failure if a gradient is not
  /// finite: it would poison the optimiser's state and, with it, the checkpoint. The frames of the next
  /// iteration are read meanwhile. What it takes is added to `spent`.
  LossRow step(AttackState& state, StageSeconds* spent = nullptr) const;
  /// The objective on hosts that are not learned on: mean of their losses, and the smoothness. The same
  /// number on every rank, and for the same mesh in any iteration: what --expect draws is one world a host,
  /// and a renderer draws this very mesh.
  double held_out(const TexturedMesh& adversary, const std::vector<Host>& hosts) const;

 private:
  /// Names of the frames of this rank's hosts of a batch.
  std::vector<std::string> frames_of(std::span<const std::size_t> batch) const;

  const AttackSettings& settings_;
  const DetectorPool& detectors_;
  FrameStore& store_;
  const std::vector<Host>& hosts_;
  HostOrder order_;
  AttackTarget target_;
  AttackParts parts_;
  Laplacian laplacian_;
  std::vector<Vec3d> unit_;  ///< --parts size: the start's vertices in a box of half lengths 1
  std::shared_ptr<CleanSights> sights_;
  std::unique_ptr<RenderedPictures> pictures_;  ///< null without a renderer
};

}  // namespace mirage
