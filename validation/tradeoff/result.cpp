#include "validation/tradeoff/result.h"

#include <fmt/format.h>

#include "base/field_json.h"
#include "base/names.h"

namespace mirage {
namespace {

/// Null if there is none.
const TradeoffPoint* quality_point(const std::vector<TradeoffPoint>& points, const std::string& name) {
  for (const TradeoffPoint& point : points)
    if (point.group == "camera" && point.axis == "quality" && point.label == name) return &point;
  return nullptr;
}

/// Of the group's first point; 0 if it has none.
double measured_baseline_ms(const std::vector<TradeoffPoint>& points, const char* group) {
  for (const TradeoffPoint& point : points)
    if (point.group == group) return point.baseline_ms;
  return 0;
}

nlohmann::json figures_json(const TradeoffPoint& point) {
  return {{"settings", point.settings},
          {"ratio", point.ratio},
          {"ms", point.ms},
          {"errors", point.errors},
          {"on_front", point.front}};
}

nlohmann::json reference_json(const TradeoffResult& result) {
  const TradeoffSettings& asked = result.settings;
  nlohmann::json json = {
      {"image",
       fmt::format("hard edges, plain loop in double, {0}×{0} samples a pixel", asked.reference_samples)},
      {"gradient",
       fmt::format("plain loop in double, σ 1e-7, γ 1e-3, {0}×{0} samples a pixel", asked.sharp_samples)},
      {"gradient_cosine", result.reference.sharp.cosine},
      {"gradient_norm", result.reference.sharp.norm},
      {"finite_differences",
       {{"directions", asked.directions},
        {"step_m", CameraStudySettings().step},
        {"self_cosine", result.reference.self_cosine}}},
      {"depth", nullptr}};
  if (!result.depth_reference.empty()) json["depth"] = result.depth_reference;
  return json;
}

}  // namespace

std::vector<Recommendation> TradeoffResult::recommended() const {
  if (!settings.grid) return {};
  std::vector<Recommendation> list = recommend(points, *quality_point(points, "default"));
  for (Recommendation& advice : list) advice.shipped = quality_point(points, advice.name);
  return list;
}

nlohmann::json to_json(const Recommendation& advice) {
  nlohmann::json json = advice.point ? figures_json(*advice.point) : nlohmann::json::object();
  json["name"] = advice.name;
  json["rule"] = advice.rule;
  json["shipped"] = figures_json(*advice.shipped);
  return json;
}

nlohmann::json to_json(const TradeoffResult& result) {
  const TradeoffSettings& asked = result.settings;
  nlohmann::json hosts = nlohmann::json::array();
  for (const HostId& id : result.hosts) hosts.push_back(host_name(id));
  nlohmann::json json = {{"frames", result.frames},
                         {"vehicles", result.hosts.size()},
                         {"hosts", hosts},
                         {"pixels", result.reference.pixels},
                         {"seed", asked.seed},
                         {"repeats", asked.repeats},
                         {"data", asked.source.data.filename().string()},
                         {"depth", escape_name(asked.source.depth)},
                         {"rooftop", escape_name(asked.source.rooftop)},
                         {"placement", text_of(asked.source.placement)},
                         {"reference", reference_json(result)},
                         {"baseline",
                          {{"camera_ms", measured_baseline_ms(result.points, "camera")},
                           {"lidar_ms", measured_baseline_ms(result.points, "lidar")}}},
                         {"points", list_json(result.points)},
                         {"recommended", list_json(result.recommended())},
                         {"attack", list_json(result.attacks)}};
  if (result.plots) json["plots"] = *result.plots;
  if (!result.page.empty()) json["page"] = result.page.string();
  return json;
}

}  // namespace mirage
