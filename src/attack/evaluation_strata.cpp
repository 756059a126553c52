#include "attack/evaluation_strata.h"

#include <set>

#include "base/image_io.h"
#include "frames/frame_store.h"
#include "generator/vehicle_truth.h"
#include "scene/data/read_frames.h"

namespace mirage {
std::vector<HostPart> host_parts(std::span<const HostOutcome> hosts) {
  std::vector<HostPart> list;
  const auto add_range = [&](const std::string& name, double nearest, double farthest) {
    list.push_back({"range", name, [nearest, farthest](const HostOutcome& host) {
                      return host.range >= nearest && host.range < farthest;
                    }});
  };
  add_range("0-15 m", 0, 15);
  add_range("15-30 m", 15, 30);
  add_range("30-50 m", 30, 50);
  add_range("50+ m", 50, 1e9);
  const char* const levels[] = {"fully visible", "partly occluded", "largely occluded", "occlusion unknown"};
  for (int level = 0; level < 4; ++level)
    list.push_back(
        {"occlusion", levels[level], [level](const HostOutcome& host) { return host.occluded == level; }});
  constexpr double kWhole = 0.15;
  list.push_back(
      {"truncation", "whole (≤ 0.15)", [](const HostOutcome& host) { return host.truncated <= kWhole; }});
  list.push_back(
      {"truncation", "cut off (> 0.15)", [](const HostOutcome& host) { return host.truncated > kWhole; }});
  std::set<std::string> kinds;
  for (const HostOutcome& host : hosts) kinds.insert(host.kind);
  for (const std::string& kind : kinds)
    list.push_back({"kind", kind, [kind](const HostOutcome& host) { return host.kind == kind; }});
  return list;
}

std::vector<StratumSuccess> strata(const std::vector<HostOutcome>& hosts, int meshes) {
  std::vector<StratumSuccess> result;
  for (const HostPart& part : host_parts(hosts)) {
    std::vector<const HostOutcome*> members;
    int detected = 0;
    for (const HostOutcome& host : hosts)
      if (part.holds(host)) {
        members.push_back(&host);
        detected += host.detected;
      }
    result.push_back({part.by, part.name, static_cast<int>(members.size()) / meshes, detected / meshes,
                      success_rates(members)});
  }
  return result;
}

nlohmann::json to_json(const std::vector<StratumSuccess>& strata) {
  auto list = nlohmann::json::array();
  for (const StratumSuccess& part : strata)
    list.push_back({{"by", part.by},
                    {"name", part.name},
                    {"hosts", part.hosts},
                    {"vehicles", part.vehicles},
                    {"fn_asr", to_json(part.rates.fn_asr)},
                    {"fp_asr", to_json(part.rates.fp_asr)},
                    {"asr", to_json(part.rates.asr)}});
  return list;
}

std::map<std::string, std::string> vehicle_kinds(const std::filesystem::path& data,
                                                 const std::vector<HostId>& hosts) {
  std::map<std::string, std::string> kinds;
  const auto source = generator::source_of(data);
  if (!source) return kinds;
  std::map<std::string, std::vector<const HostId*>> of_frame;
  for (const HostId& id : hosts) of_frame[id.frame].push_back(&id);
  const double mount = lidar_of(data).height;
  for (const auto& [frame, ids] : of_frame) {
    const auto index = generator::index_of(frame);
    if (!index) continue;
    const std::vector<Label> labels = read_annotations(data, frame).labels;
    const auto vehicles = generator::true_vehicles(source->seed, *index, mount, source->look);
    for (const HostId* id : ids) {
      if (id->label < 0 || static_cast<std::size_t>(id->label) >= labels.size()) continue;
      const Label& label = labels[static_cast<std::size_t>(id->label)];
      const auto* vehicle = generator::find_vehicle(vehicles, label.type, label.box);
      if (vehicle != nullptr && !vehicle->kind.empty()) kinds[host_name(*id)] = vehicle->kind;
    }
  }
  return kinds;
}

}  // namespace mirage
