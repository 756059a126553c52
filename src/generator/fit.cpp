#include "generator/fit.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "base/error.h"
#include "base/files.h"
#include "base/intervals.h"
#include "base/random.h"
#include "base/schedule.h"
#include "base/sizes.h"
#include "generator/dataset.h"
#include "sensors/ray_caster.h"

namespace mirage::generator {

std::vector<TrueVehicle> true_vehicles(const StreetSource& source, std::uint64_t index, double height) {
  const Street street = make_street(source.seed, index, height, source.look, source.behind);
  std::vector<TrueVehicle> vehicles;
  for (const Placed& placed : street.placed) vehicles.push_back({placed, {}});
  for (const Surface& surface : street.surfaces)
    if (const auto k = as_size(surface.object); surface.object >= 0 && !on_roof(surface, street.placed[k]))
      append(vehicles[k].mesh, surface.mesh, Transform::Identity());
  return vehicles;
}

std::optional<StreetSource> source_of(const std::filesystem::path& data) {
  const auto file = data / "dataset.json";
  if (!std::filesystem::exists(file)) return std::nullopt;
  const nlohmann::json about = read_json(file, kMaxRecordBytes);
  if (!about.is_object() || !about.contains("seed") || !about.at("seed").is_number_unsigned() ||
      !about.contains("generator"))
    throw InputError(file.string(), "seed", "missing or not a whole number",
                     "make the data set again with: mirage generate");
  if (about.at("generator") != kGeneratorVersion) return std::nullopt;
  const nlohmann::json look = about.value("look", nlohmann::json(name_of(Look::european)));
  if (!look.is_string())
    throw InputError(file.string(), "look", "is not text", "make the data set again with: mirage generate");
  return StreetSource{about.at("seed").get<std::uint64_t>(), parse_look(look, file.string(), "look"),
                      std::filesystem::is_directory(data / "training" / "cameras") ? kBehind : 0};
}

const TrueVehicle* find_vehicle(const std::vector<TrueVehicle>& vehicles, const std::string& type,
                                const Box3& box) {
  const TrueVehicle* best = nullptr;
  double nearest = 0.1;
  for (const TrueVehicle& v : vehicles) {
    const double d =
        Vec3d(v.box.bev.x - box.bev.x, v.box.bev.y - box.bev.y, v.box.bottom - box.bottom).norm();
    if (v.type != type || d >= nearest) continue;
    nearest = d;
    best = &v;
  }
  return best;
}

}  // namespace mirage::generator

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

FitError measure(const ShapeFit& fit, const Transform& by_box, const generator::TrueVehicle& truth) {
  const Transform truth_from_velo = velo_from_box(truth.box).inverse();
  const Mesh true_mesh = generator::moved(truth.mesh, truth_from_velo),
             fitted = generator::moved(fit.mesh, truth_from_velo);
  const Vec3d roof = roof_point(true_mesh);
  FitError error;
  error.roof = truth_from_velo * Vec3d(fit.velo_from_roof.translation()) - roof;
  error.box = truth_from_velo * Vec3d(by_box.translation()) - roof;
  const Vec3d heading = truth_from_velo.linear() * fit.velo_from_vehicle.linear().col(0);
  error.yaw = std::atan2(heading.y(), heading.x());
  error.to_truth = mean_distance(fitted, MeshDistance(true_mesh), [](const Vec3d&) { return true; });
  // The outer surface: points that a ray along some axis can leave. Rays cannot leave from seats.
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

nlohmann::json list(const Vec3d& v) {
  return {v.x(), v.y(), v.z()};
}

constexpr double kMaxFitDistance = 1e9;
constexpr int kMaxFitCount = 1'000'000'000;
constexpr std::size_t kMaxCodeLength = 1000;

Vec3d read_list(const JsonFields& json, const char* key) {
  return Eigen::Map<const Vec3d>(json.numbers(key, 3, -kMaxFitDistance, kMaxFitDistance).data());
}

using Vehicles = std::vector<const FittedVehicle*>;

/// The spread of value(vehicle) over the vehicles.
FitSpread spread(const Vehicles& vehicles, const std::function<double(const FittedVehicle&)>& value) {
  std::vector<double> values;
  for (const FittedVehicle* v : vehicles) values.push_back(value(*v));
  return {lower_quantile(values, 0.05), lower_quantile(values, 0.5), lower_quantile(values, 0.95)};
}

FitSummary::Errors errors(const Vehicles& vehicles_with_truth) {
  FitSummary::Errors errors;
  errors.vehicles = vehicles_with_truth.size();
  for (std::size_t a = 0; a < 3; ++a) {
    const auto axis = static_cast<Eigen::Index>(a);
    errors.roof[a] =
        spread(vehicles_with_truth, [&](const auto& v) { return std::abs(v.error->roof[axis]); });
    errors.box[a] = spread(vehicles_with_truth, [&](const auto& v) { return std::abs(v.error->box[axis]); });
  }
  errors.distance = spread(vehicles_with_truth, [](const auto& v) { return v.error->roof.norm(); });
  errors.yaw = spread(vehicles_with_truth, [](const auto& v) { return std::abs(v.error->yaw); });
  errors.to_truth = spread(vehicles_with_truth, [](const auto& v) { return v.error->to_truth; });
  errors.from_truth = spread(vehicles_with_truth, [](const auto& v) { return v.error->from_truth; });
  return errors;
}

/// The summary of the vehicles that `in` accepts.
FitSummary summary(const std::vector<FittedVehicle>& vehicles,
                   const std::function<bool(const FittedVehicle&)>& in) {
  FitSummary summary;
  Vehicles fitted, vehicles_with_truth;
  for (const FittedVehicle& v : vehicles) {
    if (!in(v)) continue;
    ++summary.vehicles;
    if (!v.fit.fitted) continue;
    fitted.push_back(&v);
    if (v.error) vehicles_with_truth.push_back(&v);
  }
  summary.fitted = fitted.size();
  summary.residual = spread(fitted, [](const auto& v) { return v.residual; });
  summary.roof_over_box = spread(fitted, [](const auto& v) { return v.roof_over_box; });
  summary.roof_over_returns = spread(fitted, [](const auto& v) { return v.roof_over_returns; });
  summary.seconds = spread(fitted, [](const auto& v) { return v.seconds; });
  if (!vehicles_with_truth.empty()) summary.error = errors(vehicles_with_truth);
  return summary;
}

/// One class between each two of `limits`.
std::vector<FitClass> classes(const std::vector<FittedVehicle>& vehicles, const std::vector<double>& limits,
                              const std::function<double(const FittedVehicle&)>& value) {
  std::vector<FitClass> list;
  for (std::size_t i = 0; i + 1 < limits.size(); ++i) {
    const auto in = [&](const FittedVehicle& v) { return value(v) >= limits[i] && value(v) < limits[i + 1]; };
    list.push_back({limits[i], limits[i + 1], summary(vehicles, in)});
  }
  return list;
}

nlohmann::json to_json(const FitSpread& s) {
  return {{"median", s.median}, {"p95", s.p95}};
}

nlohmann::json with_low(const FitSpread& s) {
  return {{"p05", s.p05}, {"median", s.median}, {"p95", s.p95}};
}

nlohmann::json to_json(const FitSummary& s) {
  nlohmann::json json = {{"vehicles", s.vehicles}, {"fitted", s.fitted}, {"from_box", s.vehicles - s.fitted}};
  const auto add = [&](const char* key, nlohmann::json of) {
    json[key] = s.fitted ? std::move(of) : nullptr;
  };
  add("residual_m", to_json(s.residual));
  add("roof_over_box_m", with_low(s.roof_over_box));
  add("roof_over_returns_m", with_low(s.roof_over_returns));
  add("seconds", to_json(s.seconds));
  if (s.error)
    json["error"] = {{"vehicles", s.error->vehicles},
                     {"roof_x_m", to_json(s.error->roof[0])},
                     {"roof_y_m", to_json(s.error->roof[1])},
                     {"roof_z_m", to_json(s.error->roof[2])},
                     {"roof_m", to_json(s.error->distance)},
                     {"box_x_m", to_json(s.error->box[0])},
                     {"box_y_m", to_json(s.error->box[1])},
                     {"box_z_m", to_json(s.error->box[2])},
                     {"yaw_rad", to_json(s.error->yaw)},
                     {"fitted_to_true_m", to_json(s.error->to_truth)},
                     {"true_to_fitted_m", to_json(s.error->from_truth)}};
  return json;
}

/// With the limits as numbers of type Number.
template <class Number>
nlohmann::json classes_json(const std::vector<FitClass>& list, const char* key) {
  nlohmann::json json = nlohmann::json::array();
  for (const FitClass& c : list) {
    json.push_back(to_json(c.fits));
    auto& limits = json.back()[key] = {static_cast<Number>(c.low), nullptr};
    if (std::isfinite(c.high)) limits[1] = static_cast<Number>(c.high);
  }
  return json;
}

}  // namespace

std::vector<FittedVehicle> fit_frame(const ShapeRoofFinder& finder, const Frame& frame,
                                     const LidarModel& lidar, const FitFrameSettings& settings,
                                     const std::vector<generator::TrueVehicle>* truth) {
  const SweepIndex index(frame.sweep, lidar);
  const BoxRoofFinder by_box;
  std::vector<FittedVehicle> vehicles;
  for (std::size_t i = 0; i < frame.labels.size(); ++i) {
    Label label = frame.labels[i];
    if (!has_box(label) || std::ranges::count(settings.types, label.type) == 0) continue;
    const Box3 labelled_box = label.box;
    RandomStream random(settings.seed, "label noise " + frame.id, i);
    if (settings.label_noise > 0) label.box = disturbed(labelled_box, settings.label_noise, random);
    FittedVehicle vehicle;
    vehicle.frame = frame.id;
    vehicle.label = static_cast<int>(i);
    vehicle.range = horizontal_distance(label.box.bev);
    vehicle.velo_from_roof = by_box.find(frame, label).velo_from_roof;
    const Clock::time_point start = Clock::now();
    vehicle.fit = finder.fit(index, label);
    vehicle.seconds = seconds_since(start);
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
        if (const auto* true_vehicle = generator::find_vehicle(*truth, label.type, labelled_box))
          vehicle.error = measure(vehicle.fit, vehicle.velo_from_roof, *true_vehicle);
      vehicle.velo_from_roof = vehicle.fit.velo_from_roof;
    }
    vehicles.push_back(std::move(vehicle));
  }
  return vehicles;
}

nlohmann::json to_json(const FittedVehicle& v) {
  const Transform& roof = v.velo_from_roof;
  nlohmann::json out = {{"frame", v.frame},
                        {"label", v.label},
                        {"range_m", v.range},
                        {"returns", v.fit.points},
                        {"from_box", !v.fit.fitted},
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

FittedVehicle read_fitted_vehicle(const JsonFields& json) {
  const auto number = [](const JsonFields& of, const char* key) {
    return of.number(key, -kMaxFitDistance, kMaxFitDistance);
  };
  FittedVehicle v;
  v.frame = json.text("frame");
  v.label = json.count("label");
  v.range = number(json, "range_m");
  v.seconds = number(json, "seconds");
  v.fit.points = json.count("returns");
  v.velo_from_roof.translation() = read_list(json, "roof_velo");
  v.velo_from_roof.linear() =
      Eigen::AngleAxisd(number(json, "heading_rad"), Vec3d::UnitZ()).toRotationMatrix();
  v.fit.fitted = !json.truth("from_box");
  if (!v.fit.fitted) {
    v.fit.reason = json.text("reason");
    return v;
  }
  v.fit.size = read_list(json, "size_m");
  v.fit.velo_from_vehicle.translation() = read_list(json, "centre_velo");
  const auto code = json.numbers("code", kMaxCodeLength, -kMaxFitDistance, kMaxFitDistance, 0);
  v.fit.shape.code = Eigen::Map<const Eigen::VectorXd>(code.data(), std::ssize(code));
  v.residual = number(json, "residual_m");
  v.roof_over_box = number(json, "roof_over_box_m");
  v.roof_over_returns = number(json, "roof_over_returns_m");
  v.fit.iterations = json.count("iterations", kMaxFitCount);
  if (!json.has("error")) return v;
  const JsonFields error = json.object("error");
  v.error = {read_list(error, "roof_m"), read_list(error, "box_m"), number(error, "yaw_rad"),
             number(error, "fitted_to_true_m"), number(error, "true_to_fitted_m")};
  return v;
}

FitReport summarise_fits(const std::vector<FittedVehicle>& vehicles) {
  constexpr double kAny = std::numeric_limits<double>::infinity();
  const auto range = [](const FittedVehicle& v) { return v.range; };
  const auto returns = [](const FittedVehicle& v) { return static_cast<double>(v.fit.points); };
  return {summary(vehicles, [](const auto&) { return true; }),
          summary(vehicles, [](const auto& v) { return v.range < 30; }),
          classes(vehicles, {0, 10, 20, 30, 40, kAny}, range),
          classes(vehicles, {0, 20, 40, 100, 300, 1000, kAny}, returns)};
}

nlohmann::json to_json(const FitReport& report) {
  return {{"all", to_json(report.all)},
          {"within_30_m", to_json(report.within_30_m)},
          {"by_range", classes_json<double>(report.by_range, "range_m")},
          {"by_returns", classes_json<int>(report.by_returns, "returns")}};
}

}  // namespace mirage
