#include "validation/tradeoff/tradeoff.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <memory>
#include <set>

#include "base/child_process.h"
#include "base/error.h"
#include "base/files.h"
#include "base/logging.h"
#include "scene/data/data_rig.h"
#include "validation/reference/scratch_folder.h"
#include "validation/tradeoff/cycles_study.h"
#include "validation/tradeoff/depth_points.h"
#include "validation/tradeoff/detector_study.h"
#include "validation/tradeoff/one_thread.h"
#include "validation/tradeoff/subjects.h"

namespace mirage {
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
  const std::string python = plotting_python().string();
  if (python.empty() ||
      run_program({python, shipped_file("validation/tradeoff/plot.py").string(), out.string()}) != 0) {
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
