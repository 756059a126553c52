#include "attack/evaluation_outcomes.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <map>
#include <tuple>

#include "base/field_json.h"

namespace mirage {

/// What is written of every host.
template <class Visitor, FieldsOf<HostOutcome> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "from_box"}, s.from_box);
  visit({.name = "range", .range = kNotNegative}, s.range);
  visit({.name = "occluded"}, s.occluded);
  visit({.name = "truncated"}, s.truncated);
  visit({.name = "clean_iou", .range = kShare}, s.clean_iou);
  visit({.name = "attacked_iou", .range = kShare}, s.attacked_iou);
  visit({.name = "clean_score", .range = kShare}, s.clean_score);
  visit({.name = "attacked_score", .range = kShare}, s.attacked_score);
  visit({.name = "detected"}, s.detected);
  visit({.name = "hidden"}, s.hidden);
  visit({.name = "false_positive"}, s.false_positive);
  visit({.name = "false_positive_distance", .range = kNotNegative}, s.false_positive_distance);
}

namespace {

constexpr std::size_t kMostEntries = 100'000'000;
constexpr int kMostMeshes = 1'000'000;

/// The fields that hold a distance in m.
constexpr std::pair<const char*, double HostOutcome::*> kDistances[] = {
    {"clean_distance", &HostOutcome::clean_distance}, {"attacked_distance", &HostOutcome::attacked_distance}};

HostOutcome read_outcome(const JsonFields& json) {
  HostOutcome host;
  host.id = {json.text("frame"), json.count("label")};
  host.kind = json.text("kind");
  if (json.has("mesh")) host.mesh = json.count("mesh", kMostMeshes);
  if (json.has("track")) host.track = json.count("track");
  for (const auto& [key, distance] : kDistances)
    if (json.has(key) && !json.is_null(key)) host.*distance = json.number(key, 0, Range::kMost);
  read_fields(json, host);
  return host;
}

}  // namespace

nlohmann::json outcomes_json(const std::vector<HostOutcome>& hosts, int meshes) {
  auto list = nlohmann::json::array();
  for (const HostOutcome& host : hosts) {
    nlohmann::json entry = fields_json(host);
    entry.update({{"frame", host.id.frame}, {"label", host.id.label}, {"kind", host.kind}});
    if (!host.matching.in_picture())
      for (const auto& [key, distance] : kDistances)
        entry[key] = std::isfinite(host.*distance) ? nlohmann::json(host.*distance) : nlohmann::json();
    if (meshes > 1) entry["mesh"] = host.mesh;
    if (host.track >= 0) entry["track"] = host.track;
    list.push_back(std::move(entry));
  }
  return list;
}

std::vector<HostOutcome> read_outcomes(const JsonFields& evaluation) {
  const JsonFields positives = evaluation.object("false_positives");
  // The distribution is there whether or not there is a box (false_positives.h).
  const bool in_picture = positives.has("distance_from_host_px");
  const auto each = [](const JsonFields& json, const char* key, const auto& read) {
    const nlohmann::json& list = json.list(key, kMostEntries);
    for (std::size_t i = 0; i < list.size(); ++i) read(json.inner(fmt::format("{}[{}]", key, i), list[i]));
  };
  std::map<std::tuple<std::string, int, int>, std::vector<NewBox>> boxes;
  each(positives, "list", [&](const JsonFields& json) {
    NewBox box;
    box.distance = json.number(in_picture ? "distance_from_host_px" : "distance_from_host", 0, Range::kMost);
    boxes[{json.text("frame"), json.count("label"), json.count("mesh", kMostMeshes)}].push_back(box);
  });
  std::vector<HostOutcome> hosts;
  each(evaluation, "outcomes", [&](const JsonFields& json) {
    HostOutcome host = read_outcome(json);
    host.matching = in_picture ? kInPicture : kFromAbove;
    if (const auto own = boxes.find({host.id.frame, host.id.label, host.mesh}); own != boxes.end())
      host.new_boxes = own->second;
    hosts.push_back(std::move(host));
  });
  return hosts;
}

}  // namespace mirage
