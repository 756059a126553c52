#include "validation/fidelity/vehicle_result.h"

#include <fmt/format.h>

#include <cmath>

#include "base/field_json.h"

namespace mirage {
namespace {

using nlohmann::json;

constexpr double kAny = Range::kMost;
constexpr std::size_t kMostRungs = 1000;

json change_json(const Change& change) {
  return {{"mae", change.mae},
          {"relative", change.relative},
          {"psnr", std::isfinite(change.psnr) ? json(change.psnr) : json()},  // equal pictures: null
          {"ssim", change.ssim},
          {"flip", change.flip}};
}

Change read_change(const JsonFields& from) {
  Change change;
  change.mae = from.number("mae", -kAny, kAny);
  change.relative = from.number("relative", -kAny, kAny);
  change.psnr = from.is_null("psnr") ? HUGE_VAL : from.number("psnr", -kAny, kAny);
  change.ssim = from.number("ssim", -kAny, kAny);
  change.flip = from.number("flip", -kAny, kAny);
  return change;
}

SquaredError read_error(const JsonFields& from) {
  const JsonFields squared = from.object("squared"), interval = from.object("interval");
  SquaredError error;
  error.plain = squared.number("plain", -kAny, kAny);
  error.floor = squared.number("floor", -kAny, kAny);
  error.drawn = squared.number("drawn", -kAny, kAny);
  error.unbiased = squared.number("unbiased", -kAny, kAny);
  error.interval = {interval.number("value", -kAny, kAny), interval.number("low", -kAny, kAny),
                    interval.number("high", -kAny, kAny)};
  return error;
}

json outcome_json(const std::optional<OutcomeResult>& outcome) {
  return outcome ? fields_json(*outcome) : json::object();
}

OutcomeResult read_outcome(const JsonFields& from) {
  OutcomeResult outcome;
  read_fields(from, outcome);
  return outcome;
}

std::optional<OutcomeResult> read_outcome_if_any(const JsonFields& from) {
  return from.has("score") ? std::optional(read_outcome(from)) : std::nullopt;
}

/// The entries of a list, each read by `read`.
template <class T, class Read>
std::vector<T> read_list(const JsonFields& from, const char* key, const Read& read) {
  std::vector<T> list;
  for (const json& entry : from.list(key, kMostRungs))
    list.push_back(read(from.inner(fmt::format("{}[{}]", key, list.size()), entry)));
  return list;
}

json with(json object, const json& more) {
  object.update(more);
  return object;
}

void add_ladder(const LadderResult& ladder, json& out) {
  out["ladder"] = list_json(ladder.light, [](const LightRungResult& rung) {
    json entry = with(outcome_json(rung.outcome), change_json(rung.change));
    entry.update(to_json(rung.error));
    entry.update({{"effect", rung.effect},
                  {"group", rung.group},
                  {"base", rung.base},
                  {"crop", change_json(rung.crop)},
                  {"to_full", change_json(rung.to_full)},
                  {"seconds", rung.seconds}});
    return entry;
  });
  out["lidar_ladder"] = list_json(ladder.lidar, [](const LidarRungResult& rung) {
    return with(outcome_json(rung.outcome), {{"effect", rung.effect},
                                             {"returns", rung.returns},
                                             {"changed", rung.changed},
                                             {"returns_change", rung.returns_change},
                                             {"seconds", rung.seconds}});
  });
  out["reference"] = {{"samples", ladder.reference_samples},
                      {"seconds", ladder.reference_seconds},
                      {"noise", ladder.reference_noise}};
  out["features"] = ladder.features;
}

LadderResult read_ladder(const JsonFields& from, const json& raw) {
  LadderResult ladder;
  ladder.light = read_list<LightRungResult>(from, "ladder", [](const JsonFields& entry) {
    LightRungResult rung;
    rung.effect = entry.text("effect"), rung.group = entry.text("group"), rung.base = entry.text("base");
    rung.change = read_change(entry);
    rung.crop = read_change(entry.object("crop"));
    rung.to_full = read_change(entry.object("to_full"));
    rung.error = read_error(entry);
    rung.seconds = entry.number("seconds", 0, kAny);
    rung.outcome = read_outcome_if_any(entry);
    return rung;
  });
  ladder.lidar = read_list<LidarRungResult>(from, "lidar_ladder", [](const JsonFields& entry) {
    LidarRungResult rung;
    rung.effect = entry.text("effect");
    rung.returns = static_cast<int>(entry.integer("returns", 0, 1 << 30));
    rung.changed = entry.number("changed", 0, kAny);
    rung.returns_change = entry.number("returns_change", -kAny, kAny);
    rung.seconds = entry.number("seconds", 0, kAny);
    rung.outcome = read_outcome_if_any(entry);
    return rung;
  });
  const JsonFields reference = from.object("reference"), features = from.object("features");
  ladder.reference_samples = static_cast<int>(reference.integer("samples", 0, 1 << 30));
  ladder.reference_seconds = reference.number("seconds", 0, kAny);
  ladder.reference_noise = reference.number("noise", -kAny, kAny);
  for (const auto& [name, value] : raw.at("features").items())
    ladder.features[name] = features.number(name, -kAny, kAny);
  return ladder;
}

void add_seen(const SeenResult& seen, json& out) {
  out["matched"] = fields_json(seen.matched);
  out["samples"] = seen.samples;
  out["full"] = with(fields_json(seen.full), to_json(seen.full.error));
  if (seen.full.mean > 0) out["full"]["relative"] = seen.full.mae / seen.full.mean;
  out["range"] = seen.range;
  out["detected"] = seen.detected;
  out["clean"] = {{"iou", seen.clean_iou}, {"score", seen.clean_score}};
  out["raster"] = fields_json(seen.raster);
  out["hard"] = fields_json(seen.hard);
  out["cycles"] = fields_json(seen.cycles);
  if (seen.arms) {
    out["arms"] = list_json(seen.arms->arms, [](const ArmResult& arm) {
      return with(fields_json(arm.outcome), fields_json(arm.arm));
    });
    out["controls"] = list_json(seen.arms->controls, [](const ControlResult& control) {
      return with(fields_json(control.outcome), fields_json(control.control));
    });
  }
  if (seen.ladder) add_ladder(*seen.ladder, out);
  out["pictures"] = seen.pictures;
}

SeenResult read_seen(const JsonFields& from, const json& raw) {
  SeenResult seen;
  read_fields(from.object("matched"), seen.matched);
  seen.samples = static_cast<int>(from.integer("samples", 0, 1 << 30));
  const JsonFields full = from.object("full"), clean = from.object("clean");
  read_fields(full, seen.full);
  seen.full.error = read_error(full);
  seen.range = from.number("range", 0, kAny);
  seen.detected = from.truth("detected");
  seen.clean_iou = clean.number("iou", 0, kAny);
  seen.clean_score = clean.number("score", 0, kAny);
  seen.raster = read_outcome(from.object("raster"));
  seen.hard = read_outcome(from.object("hard"));
  seen.cycles = read_outcome(from.object("cycles"));
  if (from.has("arms")) {
    seen.arms.emplace();
    seen.arms->arms = read_list<ArmResult>(from, "arms", [](const JsonFields& entry) {
      ArmResult arm{{}, read_outcome(entry)};
      read_fields(entry, arm.arm);
      return arm;
    });
    seen.arms->controls = read_list<ControlResult>(from, "controls", [](const JsonFields& entry) {
      ControlResult control{{}, read_outcome(entry)};
      read_fields(entry, control.control);
      return control;
    });
  }
  if (from.has("ladder")) seen.ladder = read_ladder(from, raw);
  if (seen.arms && seen.arms->arms.empty()) from.fail("arms", "has no entries");
  if (seen.ladder && seen.detected)
    for (const LightRungResult& rung : seen.ladder->light)
      if (!rung.outcome) from.fail("ladder", rung.effect + " has no score");
  const JsonFields pictures = from.object("pictures");
  for (const auto& [name, file] : raw.at("pictures").items()) seen.pictures[name] = pictures.text(name);
  return seen;
}

}  // namespace

json to_json(const VehicleResult& vehicle) {
  json out = vehicle.shown;
  out.update({{"frame", vehicle.host.frame},
              {"label", vehicle.host.label},
              {"name", vehicle.name},
              {"from_box", vehicle.from_box},
              {"visible_share", vehicle.visible_share},
              {"adversary_points", vehicle.adversary_points}});
  if (!vehicle.seen) return out;
  add_seen(*vehicle.seen, out);
  out["losses"] = list_json(vehicle.losses, [](const ReferenceLoss& loss) {
    return json{{"job", loss.job}, {"how", loss.how}, {"attempt", loss.attempt}};
  });
  return out;
}

VehicleResult read_vehicle(const std::filesystem::path& file, const json& raw) {
  const JsonFields from(file, raw, "delete the file; it is made again");
  VehicleResult vehicle;
  vehicle.host = {from.text("frame"), static_cast<int>(from.integer("label", 0, 1 << 30))};
  vehicle.name = from.text("name");
  vehicle.from_box = from.truth("from_box");
  vehicle.visible_share = from.number("visible_share", 0, kAny);
  vehicle.adversary_points = static_cast<int>(from.integer("adversary_points", 0, 1 << 30));
  if (!from.has("matched")) return vehicle;
  vehicle.seen = read_seen(from, raw);
  vehicle.losses = read_list<ReferenceLoss>(from, "losses", [](const JsonFields& entry) {
    return ReferenceLoss{entry.text("job"), entry.text("how"),
                         static_cast<int>(entry.integer("attempt", 0, 1000))};
  });
  for (const char* part : {"bev", "picture_boxes", "host_rect", "crop_rect"})
    if (raw.contains(part)) vehicle.shown[part] = raw.at(part);
  return vehicle;
}

}  // namespace mirage
