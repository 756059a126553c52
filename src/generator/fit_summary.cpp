#include "generator/fit_summary.h"

#include <cmath>
#include <functional>
#include <limits>

namespace mirage {
namespace {

using Vehicles = std::vector<const FittedVehicle*>;

/// Of what `value` says of each.
FitSpread spread(const Vehicles& vehicles, const std::function<double(const FittedVehicle&)>& value) {
  std::vector<double> values;
  for (const FittedVehicle* v : vehicles) values.push_back(value(*v));
  return {lower_quantile(values, 0.05), lower_quantile(values, 0.5), lower_quantile(values, 0.95)};
}

FitSummary::Errors errors(const Vehicles& known) {
  FitSummary::Errors errors;
  errors.vehicles = known.size();
  for (std::size_t a = 0; a < 3; ++a) {
    const auto axis = static_cast<Eigen::Index>(a);
    errors.roof[a] = spread(known, [&](const auto& v) { return std::abs(v.error->roof[axis]); });
    errors.box[a] = spread(known, [&](const auto& v) { return std::abs(v.error->box[axis]); });
  }
  errors.distance = spread(known, [](const auto& v) { return v.error->roof.norm(); });
  errors.yaw = spread(known, [](const auto& v) { return std::abs(v.error->yaw); });
  errors.to_truth = spread(known, [](const auto& v) { return v.error->to_truth; });
  errors.from_truth = spread(known, [](const auto& v) { return v.error->from_truth; });
  return errors;
}

/// Over the vehicles that `in` accepts.
FitSummary summary(const std::vector<FittedVehicle>& vehicles,
                   const std::function<bool(const FittedVehicle&)>& in) {
  FitSummary summary;
  Vehicles fitted, known;
  for (const FittedVehicle& v : vehicles) {
    if (!in(v)) continue;
    ++summary.vehicles;
    if (!v.fit.fitted) continue;
    fitted.push_back(&v);
    if (v.error) known.push_back(&v);
  }
  summary.fitted = fitted.size();
  summary.residual = spread(fitted, [](const auto& v) { return v.residual; });
  summary.roof_over_box = spread(fitted, [](const auto& v) { return v.roof_over_box; });
  summary.roof_over_returns = spread(fitted, [](const auto& v) { return v.roof_over_returns; });
  summary.seconds = spread(fitted, [](const auto& v) { return v.seconds; });
  if (!known.empty()) summary.error = errors(known);
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
  nlohmann::json json = {{"vehicles", s.vehicles},
                         {"fitted", s.fitted},
                         {"from_box", s.vehicles - s.fitted},
                         {"residual_m", to_json(s.residual)},
                         {"roof_over_box_m", with_low(s.roof_over_box)},
                         {"roof_over_returns_m", with_low(s.roof_over_returns)},
                         {"seconds", to_json(s.seconds)}};
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
