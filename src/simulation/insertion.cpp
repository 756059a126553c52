#include "simulation/insertion.h"

#include <algorithm>

#include "base/error.h"
#include "base/fields.h"
#include "scene/depth_completion.h"
#include "simulation/camera_pass.h"
#include "simulation/check_inputs.h"
#include "simulation/sensor_pass.h"

namespace mirage {

struct Simulated::Tape {
  TexturedMesh placed;
  Eigen::Matrix3d velo_from_adversary;
  std::vector<std::size_t> lowest;  ///< vertices that the mesh stands on: several at a tie
  std::shared_ptr<const LidarTape> lidar;
  std::vector<SensorVjp> sensors;
};

namespace {

/// One of the frame's cameras, by index.
class CameraSensor : public SensorPass {
 public:
  explicit CameraSensor(std::size_t camera) : camera_(camera) {}
  SensorVjp draw(const PreparedFrame& prepared, const Placement& placement, const TexturedMesh& placed,
                 const SimulationSettings& settings, Simulated& result) const override {
    const Calibration& calibration = prepared.frame.calibration_of(camera_);
    if (camera_ > 0 && !may_see(calibration, placed.mesh, settings)) return nullptr;
    CameraSight& sight = camera_ == 0 ? result : result.others[camera_ - 1];
    return [camera = camera_, calibration,
            tape = draw_in_camera(prepared, placement, placed, settings, sight, camera_)](
               const Simulated& simulated, const TexturedMesh& object, const Upstream& upstream,
               AdversaryGradient& placed_gradient) {
      const GradientView d_image = camera == 0               ? upstream.image
                                   : upstream.others.empty() ? GradientView()
                                                             : upstream.others[camera - 1];
      if (d_image)
        draw_in_camera_vjp(tape, object, calibration, simulated.sight(camera), d_image,
                           placed_gradient.vertices, placed_gradient.texels);
    };
  }

 private:
  std::size_t camera_;
};

/// The frame's sweep; also keeps the returns in the tape.
class LidarSensor : public SensorPass {
 public:
  explicit LidarSensor(std::shared_ptr<const LidarTape>& tape) : tape_(tape) {}
  SensorVjp draw(const PreparedFrame& prepared, const Placement&, const TexturedMesh& placed,
                 const SimulationSettings& settings, Simulated& result) const override {
    tape_ = std::make_shared<const LidarTape>(draw_in_lidar(prepared, placed, settings, result));
    return [settings, tape = tape_](const Simulated&, const TexturedMesh& object, const Upstream& upstream,
                                    AdversaryGradient& placed_gradient) {
      if (upstream.points.size() > 0)
        draw_in_lidar_vjp(*tape, object, settings, upstream.points, placed_gradient.vertices,
                          placed_gradient.texels);
      if (upstream.presence.size() > 0)
        lidar_silhouette_vjp(*upstream.silhouette, upstream.presence, placed_gradient.vertices);
    };
  }

 private:
  std::shared_ptr<const LidarTape>& tape_;
};

}  // namespace

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
  Simulated result;
  result.others.resize(prepared.frame.others.size());
  result.measurements.resize(prepared.measured_by.size());
  const auto draw = [&](const SensorPass& sensor) {
    if (SensorVjp drawn = sensor.draw(prepared, placement, tape->placed, settings, result))
      tape->sensors.push_back(std::move(drawn));
  };
  for (std::size_t k = 0; k < prepared.frame.cameras(); ++k) draw(CameraSensor(k));
  draw(LidarSensor(tape->lidar));
  for (const auto& sensor : prepared.measured_by) draw(*sensor);
  result.tape = std::move(tape);
  return result;
}

AdversaryGradient simulate_vjp(const Simulated& simulated, const ImageF& d_image,
                               const std::vector<std::array<float, 4>>& d_points) {
  if (!d_image.empty() && d_image.channels != 3)
    throw InputError("upstream gradient", "d_image", "is not of the image's size",
                     "give height × width × 3 values");
  return simulate_vjp(simulated, Upstream{d_image.empty() ? nullptr : d_image.data.data(), d_image.width,
                                          d_image.height, d_points});
}

AdversaryGradient simulate_vjp(const Simulated& simulated, const Upstream& upstream) {
  check_upstream(simulated, upstream);
  const Simulated::Tape& tape = *simulated.tape;
  AdversaryGradient placed, gradient;
  placed.vertices.assign(tape.placed.mesh.vertices.size(), Vec3d::Zero());
  placed.texels.assign(tape.placed.atlas.texels.size(), Vec3d::Zero());
  for (const SensorVjp& vjp : tape.sensors) vjp(simulated, tape.placed, upstream, placed);
  gradient.texels = std::move(placed.texels);
  // placed = R (v − (0, 0, lowest z)) + t
  double lifted = 0;
  for (const Vec3d& d : placed.vertices) {
    gradient.vertices.push_back(tape.velo_from_adversary.transpose() * d);
    lifted += gradient.vertices.back().z();
  }
  // At a tie (an icosphere stands on an edge) they share it, as a central difference gives for two.
  for (const std::size_t i : tape.lowest)
    gradient.vertices[i].z() -= lifted / static_cast<double>(tape.lowest.size());
  return gradient;
}

double Simulated::best_share() const {
  double best = visible_share;
  for (const CameraSight& other : others) best = std::max(best, other.visible_share);
  return best;
}

std::vector<std::array<double, 4>> object_returns(const Simulated& simulated) {
  std::vector<std::array<double, 4>> points;
  for (const auto& added : simulated.tape->lidar->returns) {
    const Vec3d p = added.ray.origin + added.range * added.ray.direction;
    points.push_back({p.x(), p.y(), p.z(), added.hit.reflectance});
  }
  return points;
}

const TexturedMesh& placed_adversary(const Simulated& simulated) {
  return simulated.tape->placed;
}

std::span<const Quality> qualities() {
  const auto own = [](const char* name, bool exact) {
    const SimulationSettings settings;
    const auto& raster = settings.raster;
    return Quality{name, raster.sigma, raster.gamma, raster.dist_eps, settings.supersampling, exact};
  };
  static const std::array<Quality, 3> all = {Quality{"draft", 1e-7, 3e-3, 1e-4, 1, false},
                                             own("default", false), own("exact", true)};
  return all;
}

const Quality& quality_of(const std::string& name) {
  for (const Quality& quality : qualities())
    if (name == quality.name) return quality;
  throw unknown_word("quality", name, {"draft", "default", "exact"});
}

void apply_quality(const std::string& name, SimulationSettings& settings,
                   const std::function<bool(const char* option)>& is_set) {
  if (name.empty()) return;
  const Quality& quality = quality_of(name);
  const auto free = [&](const char* option) { return !is_set || !is_set(option); };
  for (const char* option : kSoftOptions)
    if (quality.exact && !free(option))
      throw InputError(option, "", "means nothing at --quality exact, which draws exact areas",
                       "leave it out, or choose draft or default");
  if (free("--sigma")) settings.raster.sigma = quality.sigma;
  if (free("--gamma")) settings.raster.gamma = quality.gamma;
  if (free("--supersampling")) settings.supersampling = quality.supersampling;
  settings.raster.dist_eps = quality.dist_eps;
  settings.reference = false;
  settings.exact_coverage = quality.exact;
}

}  // namespace mirage
