#include "generator/fit_dataset.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>

#include "base/random.h"
#include "sensors/mesh_distance.h"
#include "sensors/ray_caster.h"

namespace mirage {
namespace {

/// Mean distance of the mesh's vertices to a surface, over those that `count` accepts.
double mean_distance(const Mesh& mesh, const MeshDistance& surface,
                     const std::function<bool(const Vec3d&)>& count) {
  double sum = 0;
  std::size_t counted = 0;
  for (const Vec3d& v : mesh.vertices) {
    if (!count(v)) continue;
    sum += surface.distance(v);
    ++counted;
  }
  return counted == 0 ? 0 : sum / static_cast<double>(counted);
}

FitError measure(const ShapeFit& fit, const Carrier& by_box, const generator::TrueVehicle& truth) {
  const Transform truth_from_velo = velo_from_box(truth.box).inverse();
  const auto moved = [&](Mesh mesh) {
    for (Vec3d& v : mesh.vertices) v = truth_from_velo * v;
    return mesh;
  };
  const Mesh true_mesh = moved(truth.mesh), fitted = moved(fit.mesh);
  const Vec3d roof = roof_point(true_mesh);
  FitError error;
  error.roof = truth_from_velo * Vec3d(fit.velo_from_roof.translation()) - roof;
  error.box = truth_from_velo * Vec3d(by_box.velo_from_roof.translation()) - roof;
  const Vec3d heading = truth_from_velo.linear() * fit.velo_from_vehicle.linear().col(0);
  error.yaw = std::atan2(heading.y(), heading.x());
  error.to_truth = mean_distance(fitted, MeshDistance(true_mesh), [](const Vec3d&) { return true; });
  // The outer surface: what a ray along some axis can leave from. Seats can't be left.
  const RayCaster caster({&true_mesh, 1});
  const auto outer = [&](const Vec3d& p) {
    for (const Vec3d& d : {Vec3d(1, 0, 0), Vec3d(-1, 0, 0), Vec3d(0, 1, 0), Vec3d(0, -1, 0), Vec3d(0, 0, 1)})
      if (!caster.occluded({(p + 0.02 * d).cast<float>(), d.cast<float>()})) return true;
    return false;
  };
  error.from_truth = mean_distance(true_mesh, MeshDistance(fitted), outer);
  return error;
}

Box3 disturbed(const Box3& box, double strength, RandomStream& random) {
  const auto error = [&](double sigma) { return strength * sigma * std::clamp(random.normal(), -2.5, 2.5); };
  Box3 out = box;
  out.bev.x += error(0.07);
  out.bev.y += error(0.07);
  out.bottom += error(0.05);
  out.bev.yaw += error(0.02);
  out.bev.length *= 1 + error(0.03);
  out.bev.width *= 1 + error(0.03);
  out.height *= 1 + error(0.03);
  return out;
}

}  // namespace

double lower_quantile(std::vector<double> values, double p) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1,
                         static_cast<std::size_t>(p * static_cast<double>(values.size())))];
}

std::vector<FittedVehicle> fit_frame(const ShapeRoofFinder& finder, const Frame& frame,
                                     const LidarModel& lidar, const FitFrameSettings& settings,
                                     const std::vector<generator::TrueVehicle>* truth) {
  const SweepIndex index(frame.sweep, lidar);
  const BoxRoofFinder by_box;
  std::vector<FittedVehicle> vehicles;
  for (std::size_t i = 0; i < frame.labels.size(); ++i) {
    Label label = frame.labels[i];
    if (!has_box(label) ||
        std::find(settings.types.begin(), settings.types.end(), label.type) == settings.types.end())
      continue;
    const Box3 given = label.box;
    RandomStream random(settings.seed, "label noise " + frame.id, i);
    if (settings.label_noise > 0) label.box = disturbed(given, settings.label_noise, random);
    FittedVehicle vehicle;
    vehicle.frame = frame.id;
    vehicle.label = static_cast<int>(i);
    vehicle.range = std::hypot(label.box.bev.x, label.box.bev.y);
    vehicle.occluded = label.occluded;
    vehicle.carrier = by_box.find(frame, label);
    const auto start = std::chrono::steady_clock::now();
    vehicle.fit = finder.fit(index, label);
    vehicle.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (vehicle.fit.fitted) {
      const Vec3d roof = vehicle.fit.velo_from_roof.translation();
      vehicle.roof_over_box = roof.z() - label.box.bottom - label.box.height;
      const MeshDistance surface(vehicle.fit.mesh);
      std::vector<double> off, heights;
      for (const Vec3d& p : vehicle.fit.returns_velo) {
        off.push_back(surface.distance(p));
        heights.push_back(p.z());
      }
      vehicle.residual = lower_quantile(std::move(off), 0.5);
      vehicle.roof_over_returns = roof.z() - lower_quantile(std::move(heights), 0.99);
      if (truth)
        if (const auto* true_vehicle = generator::find_vehicle(*truth, label.type, given))
          vehicle.error = measure(vehicle.fit, vehicle.carrier, *true_vehicle);
      vehicle.carrier = {label, vehicle.fit.velo_from_roof, false};
    }
    vehicles.push_back(std::move(vehicle));
  }
  return vehicles;
}

namespace {

nlohmann::json list(const Vec3d& v) {
  return {v.x(), v.y(), v.z()};
}

}  // namespace

nlohmann::json to_json(const FittedVehicle& v) {
  const Transform& roof = v.carrier.velo_from_roof;
  nlohmann::json out = {{"frame", v.frame},
                        {"label", v.label},
                        {"range_m", v.range},
                        {"returns", v.fit.points},
                        {"from_box", v.carrier.from_box},
                        {"roof_velo", list(roof.translation())},
                        {"heading_rad", std::atan2(roof(1, 0), roof(0, 0))},
                        {"seconds", v.seconds}};
  if (!v.fit.fitted) {
    out["reason"] = v.fit.reason;
    return out;
  }
  out["size_m"] = list(v.fit.size);
  out["centre_velo"] = list(v.fit.velo_from_vehicle.translation());
  out["code"] =
      std::vector<double>(v.fit.shape.code.data(), v.fit.shape.code.data() + v.fit.shape.code.size());
  out["residual_m"] = v.residual;
  out["roof_over_box_m"] = v.roof_over_box;
  out["roof_over_returns_m"] = v.roof_over_returns;
  out["iterations"] = v.fit.iterations;
  if (v.error)
    out["error"] = {{"roof_m", list(v.error->roof)},
                    {"box_m", list(v.error->box)},
                    {"yaw_rad", v.error->yaw},
                    {"fitted_to_true_m", v.error->to_truth},
                    {"true_to_fitted_m", v.error->from_truth}};
  return out;
}

}  // namespace mirage
