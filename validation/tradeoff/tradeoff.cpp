#include "validation/tradeoff/tradeoff.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <memory>
#include <set>

#include "base/child_process.h"
#include "base/error.h"
#include "base/field_json.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/names.h"
#include "scene/data/data_rig.h"
#include "validation/reference/reference_renderer.h"
#include "validation/tradeoff/subjects.h"

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
        {"step_m", CameraStudy::kStep},
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

namespace {

std::vector<TradeoffPoint> pass_points(const TradeoffSettings& settings, const Subjects& subjects,
                                       FrameStore& store) {
  std::vector<std::shared_ptr<const PreparedFrame>> held;
  std::vector<StepHost> hosts;
  if (settings.detector_hosts > 0)
    for (const HostId& id : evenly(subjects.hosts, static_cast<std::size_t>(settings.detector_hosts))) {
      held.push_back(store.get(id.frame));
      hosts.push_back({*held.back(), id, store.placement(id)});
    }
  if (hosts.empty()) return {};
  DetectorOptions options = settings.detector;
  options.rig = data_rig(settings.source.data, settings.source.rig);
  const OneThread bound;
  return detector_points(options, hosts, subjects.adversary, settings.repeats);
}

std::vector<TradeoffPoint> cycles_points(const TradeoffSettings& settings, const Subjects& subjects,
                                         FrameStore& store, const StartReference& start) {
  const std::unique_ptr<ReferenceRenderer> renderer = start(settings.out);
  std::vector<std::shared_ptr<const PreparedFrame>> held;
  std::vector<CyclesHost> hosts;
  for (const HostId& id : evenly(subjects.hosts, static_cast<std::size_t>(settings.cycles_hosts))) {
    held.push_back(store.get(id.frame));
    hosts.push_back({held.back().get(), store.placement(id), subjects.adversary, host_name(id)});
  }
  const auto scratch = settings.out / kScratchFolder;
  auto points = cycles_study(*renderer, hosts, {}, settings.cycles_samples, settings.seed, scratch);
  std::error_code ignored;
  std::filesystem::remove_all(scratch, ignored);
  return points;
}

/// Names of the files that validation/tradeoff/plot.py made.
std::vector<std::string> plot(const std::filesystem::path& out) {
  if (run_script("validation/tradeoff/plot.py", out) != 0) {
    spdlog::warn("no page: install python3-matplotlib (the points are in {})",
                 (out / "tradeoff.json").string());
    return {};
  }
  return {"tradeoff.png", "tradeoff.svg"};
}

void mark_fronts(std::vector<TradeoffPoint>& points) {
  for (const auto& [group, error] :
       std::vector<std::pair<const char*, const char*>>{{"camera", "image_levels"},
                                                        {"camera", "gradient"},
                                                        {"lidar", "range_error_m"},
                                                        {"lidar", "gradient"},
                                                        {"depth", "mae_mm"},
                                                        {"detector", "gradient"},
                                                        {"cycles", "image_levels"}})
    mark_front(points, group, error);
}

}  // namespace

TradeoffResult tradeoff(const TradeoffSettings& given, const StartReference& start) {
  check_fields(given);
  TradeoffResult result;
  TradeoffSettings& settings = result.settings = given;
  std::unique_ptr<Run> run;
  if (!settings.run.empty()) {
    run = std::make_unique<Run>(read_run(settings.run, settings.trust));
    override_settings(*run, settings.asked, settings.seed);
    settings.source = run->settings;
  } else {
    AttackSettings plain;
    override_settings(plain, settings.asked, settings.seed);
    settings.source = plain;
  }
  if (settings.source.data.empty())
    throw FieldError("data", "", "no data set", "give --data, or --run of a finished mirage attack");
  make_output_folder(settings.out);
  FrameStore store(settings.source);
  const Subjects subjects = choose_subjects(settings, run.get(), store);
  result.hosts = subjects.hosts;
  std::set<std::string> frames;
  for (const HostId& id : subjects.hosts) frames.insert(id.frame);
  result.frames = frames.size();

  SensorPoints sensors = sensor_points(settings, subjects, store);
  result.points = std::move(sensors.points);
  result.reference = std::move(sensors.reference);
  const auto append = [&](std::vector<TradeoffPoint> more) {
    std::move(more.begin(), more.end(), std::back_inserter(result.points));
  };
  DepthPoints depth = depth_points(settings, subjects.adversary);
  result.depth_reference = depth.reference;
  append(std::move(depth.points));
  append(pass_points(settings, subjects, store));
  if (settings.cycles) append(cycles_points(settings, subjects, store, start));
  mark_fronts(result.points);
  result.attacks = attack_study(settings);

  write_json(settings.out / "tradeoff.json", to_json(result));
  result.plots = plot(settings.out);
  if (!result.plots->empty()) result.page = settings.out / "tradeoff.html";
  return result;
}

}  // namespace mirage
