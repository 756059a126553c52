#include "simulation/insertion.h"

#include <algorithm>

#include "base/error.h"
#include "scene/depth_completion.h"
#include "simulation/camera_pass.h"
#include "simulation/check_inputs.h"
#include "simulation/upstream.h"

namespace mirage {

struct Simulated::Tape {
  TexturedMesh placed;
  Eigen::Matrix3d velo_from_adversary;
  std::vector<std::size_t> lowest;  ///< vertices that it stands on: more than one at a tie
  std::vector<Calibration> calibrations;
  SimulationSettings settings;
  std::vector<CameraTape> cameras;  ///< by their numbers; nothing in those that do not see it
  LidarTape lidar;
};

PreparedFrame prepare(Frame frame, const LidarModel& lidar, const DepthCompletion* depth, ImageF completed) {
  check_frame(frame);
  check_lidar(lidar);
  PreparedFrame prepared;
  const auto complete = [depth](const ImageF& image, const ImageF& sparse) {
    return depth ? depth->complete(image, sparse) : complete_depth(sparse);
  };
  if (completed.empty()) completed = complete(frame.image, sparse_depth(frame.sweep, frame.calibration));
  prepared.depth = std::move(completed);
  if (!frame.others.empty()) {
    const auto sweep = std::make_shared<const Sweep>(frame.sweep);
    for (const SideCamera& camera : frame.others)
      prepared.other_depths.emplace_back([complete, sweep, camera] {
        return complete(camera.image.get(), sparse_depth(*sweep, camera.calibration));
      });
  }
  prepared.index = SweepIndex(frame.sweep, lidar);
  prepared.lidar = lidar;
  prepared.frame = std::move(frame);
  return prepared;
}

Simulated simulate(const PreparedFrame& prepared, const Placement& placement, const TexturedMesh& adversary,
                   const SimulationSettings& settings) {
  check_textured(adversary, "adversary");
  check_placement(placement);
  check_settings(settings);
  auto tape = std::make_shared<Simulated::Tape>();
  tape->placed = place(adversary, placement);
  tape->velo_from_adversary = placement.velo_from_adversary.linear();
  const double bottom = bounds(adversary.mesh).min().z();
  for (const std::size_t i : used_vertices(adversary.mesh))
    if (adversary.mesh.vertices[i].z() == bottom) tape->lowest.push_back(i);
  tape->settings = settings;
  Simulated result;
  result.others.resize(prepared.frame.others.size());
  tape->cameras.resize(prepared.frame.cameras());
  for (std::size_t k = 0; k < prepared.frame.cameras(); ++k) {
    tape->calibrations.push_back(prepared.frame.calibration_of(k));
    if (k > 0 && !may_see(tape->calibrations[k], tape->placed.mesh, settings)) continue;
    CameraSight& sight = k == 0 ? result : result.others[k - 1];
    tape->cameras[k] = draw_in_camera(prepared, placement, tape->placed, settings, sight, k);
  }
  tape->lidar = draw_in_lidar(prepared, tape->placed, settings, result);
  result.tape = std::move(tape);
  return result;
}

AdversaryGradient simulate_vjp(const Simulated& simulated, const ImageF& d_image,
                               const std::vector<std::array<float, 4>>& d_points) {
  if (!d_image.empty() && d_image.channels != 3)
    throw InputError("upstream gradient", "d_image", "is not of the image's size",
                     "give height × width × 3 values");
  return simulate_vjp(simulated, Upstream<float>{d_image.empty() ? nullptr : d_image.data.data(),
                                                 d_image.width, d_image.height, d_points});
}

template <class S>
AdversaryGradient simulate_vjp(const Simulated& simulated, const Upstream<S>& upstream) {
  check_upstream(simulated, upstream);
  const Simulated::Tape& tape = *simulated.tape;
  AdversaryGradient gradient;
  std::vector<Vec3d> d_placed(tape.placed.mesh.vertices.size(), Vec3d::Zero());
  gradient.texels.assign(tape.placed.atlas.texels.size(), Vec3d::Zero());
  for (std::size_t k = 0; k < tape.cameras.size(); ++k) {
    const S* d_image = k == 0 ? upstream.image : upstream.others.empty() ? nullptr : upstream.others[k - 1];
    if (d_image)
      draw_in_camera_vjp(tape.cameras[k], tape.placed, tape.calibrations[k], simulated.sight(k), d_image,
                         d_placed, gradient.texels);
  }
  if (!upstream.points.empty())
    draw_in_lidar_vjp(tape.lidar, tape.placed, tape.settings, upstream.points, d_placed, gradient.texels);
  if (!upstream.presence.empty()) lidar_silhouette_vjp(*upstream.silhouette, upstream.presence, d_placed);
  // placed = R (v − (0, 0, lowest z)) + t
  double lifted = 0;
  for (const Vec3d& d : d_placed) {
    gradient.vertices.push_back(tape.velo_from_adversary.transpose() * d);
    lifted += gradient.vertices.back().z();
  }
  // At a tie (an icosphere stands on an edge) they share it: what a central difference says of two.
  for (const std::size_t i : tape.lowest)
    gradient.vertices[i].z() -= lifted / static_cast<double>(tape.lowest.size());
  return gradient;
}
template AdversaryGradient simulate_vjp(const Simulated&, const Upstream<float>&);
template AdversaryGradient simulate_vjp(const Simulated&, const Upstream<double>&);

double Simulated::best_share() const {
  double best = visible_share;
  for (const CameraSight& other : others) best = std::max(best, other.visible_share);
  return best;
}

std::vector<std::array<double, 4>> object_returns(const Simulated& simulated) {
  std::vector<std::array<double, 4>> points;
  for (const auto& added : simulated.tape->lidar.returns) {
    const Vec3d p = added.ray.origin + added.range * added.ray.direction;
    points.push_back({p.x(), p.y(), p.z(), added.hit.reflectance});
  }
  return points;
}

const TexturedMesh& placed_adversary(const Simulated& simulated) {
  return simulated.tape->placed;
}

}  // namespace mirage
