#include "attack/vehicle_drive.h"

#include <algorithm>
#include <cmath>

#include "base/fields.h"
#include "base/intervals.h"

namespace mirage {
namespace {

constexpr double kAway = 2.5;  // usual steps between frames after which the vehicle was away

/// s that each frame stands for, and whether the next one follows it.
struct Stands {
  double seconds = 0;
  bool followed = false;
};

std::vector<Stands> stands_of(const std::vector<DriveFrame>& frames) {
  std::vector<double> steps;
  for (std::size_t i = 0; i + 1 < frames.size(); ++i) steps.push_back(frames[i + 1].time - frames[i].time);
  const double usual = steps.empty() ? 0 : median_interval(steps).value;
  std::vector<Stands> stands(frames.size(), {usual, false});
  for (std::size_t i = 0; i < steps.size(); ++i)
    if (steps[i] <= kAway * usual) stands[i] = {steps[i], true};
  return stands;
}

template <class Lacks>
double longest_run(const std::vector<Stands>& stands, const Lacks& lacks) {
  double longest = 0, run = 0;
  for (std::size_t i = 0; i < stands.size(); ++i) {
    if (i > 0 && !stands[i - 1].followed) run = 0;
    run = lacks(i) ? run + stands[i].seconds : 0;
    longest = std::max(longest, run);
  }
  return longest;
}

/// The entries of one number a frame.
std::vector<double> column(const std::vector<DriveFrame>& frames, double DriveFrame::*number) {
  std::vector<double> values;
  for (const DriveFrame& frame : frames) values.push_back(frame.*number);
  return values;
}

constexpr std::pair<const char*, double DriveFrame::*> kColumns[] = {{"time_s", &DriveFrame::time},
                                                                     {"range_m", &DriveFrame::range},
                                                                     {"nearest_m", &DriveFrame::nearest},
                                                                     {"closing_mps", &DriveFrame::closing}};
constexpr int kMostOfDrive = 1000000;  // frames, tracks

}  // namespace

DriveOutcome outcome_of(const VehicleDrive& vehicle, DriveVersion version) {
  DriveOutcome outcome;
  const auto& frames = vehicle.frames;
  const auto sight = [&](std::size_t i) -> const DriveSight& {
    return frames[i].sights[static_cast<std::size_t>(version)];
  };
  const std::vector<Stands> stands = stands_of(frames);
  outcome.gap_s = longest_run(stands, [&](std::size_t i) { return !sight(i).found; });
  outcome.track_gap_s =
      longest_run(stands, [&](std::size_t i) { return sight(i).track == TrackSight::lost; });
  for (std::size_t i = 0; i < frames.size(); ++i) {
    outcome.found += sight(i).found;
    outcome.phantom_frames += sight(i).phantoms > 0;
    outcome.phantom_s += sight(i).phantoms > 0 ? stands[i].seconds : 0;
    outcome.phantom_lane_s += sight(i).phantom_in_lane ? stands[i].seconds : 0;
    if (outcome.confirmed || sight(i).track == TrackSight::lost) continue;
    const DriveFrame& frame = frames[i];
    outcome.confirmed = {frame.time - frames.front().time, frame.range, frame.closing, std::nullopt, {}};
    const double speed = std::max(0.0, frame.closing);
    if (speed > 0) outcome.confirmed->to_collision = frame.nearest / speed;
    for (std::size_t k = 0; k < kBrakes.size(); ++k)
      outcome.confirmed->reserve[k] = frame.nearest - speed * speed / (2 * kBrakes[k]);
  }
  return outcome;
}

nlohmann::json to_json(const VehicleDrive& vehicle) {
  nlohmann::json json = {{"sequence", vehicle.sequence},
                         {"track", vehicle.track},
                         {"type", vehicle.type},
                         {"frames", vehicle.frames.size()},
                         {"roof",
                          {{"fitted", vehicle.fitted},
                           {"residual_m", vehicle.residual_m},
                           {"residual_deg", vehicle.residual_deg},
                           {"fit_jitter_m", vehicle.fit_jitter_m},
                           {"jitter_m", vehicle.jitter_m},
                           {"in_box_m", vehicle.in_box_m},
                           {"in_box_deg", vehicle.in_box_deg}}}};
  auto& strip = json["strip"];
  strip["index"] = nlohmann::json::array();
  for (const DriveFrame& frame : vehicle.frames) strip["index"].push_back(frame.index);
  for (const auto& [key, number] : kColumns) strip[key] = column(vehicle.frames, number);
  for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
    const std::string name = kDriveVersions[v];
    const DriveOutcome outcome = outcome_of(vehicle, static_cast<DriveVersion>(v));
    json["found"][name] = outcome.found;
    json["gap_s"][name] = outcome.gap_s;
    json["track_gap_s"][name] = outcome.track_gap_s;
    for (const char* key : {"confirmed_s", "confirmed_m", "closing_mps", "to_collision_s", "reserve_m"})
      json[key][name] = nullptr;
    if (const auto& at = outcome.confirmed) {
      json["confirmed_s"][name] = at->seconds;
      json["confirmed_m"][name] = at->metres;
      json["closing_mps"][name] = at->closing;
      if (at->to_collision) json["to_collision_s"][name] = *at->to_collision;
      for (std::size_t k = 0; k < kBrakes.size(); ++k)
        json["reserve_m"][name][std::to_string(kBrakes[k])] = at->reserve[k];
    }
    json["phantoms"][name] = {{"tracks", vehicle.phantom_tracks[v]},
                              {"frames", outcome.phantom_frames},
                              {"seconds", outcome.phantom_s},
                              {"in_lane_s", outcome.phantom_lane_s}};
    std::string found, track;
    std::vector<int> phantoms, in_lane;
    for (const DriveFrame& frame : vehicle.frames) {
      const DriveSight& sight = frame.sights[v];
      found += sight.found ? 'f' : '-';
      track += static_cast<char>(sight.track);
      phantoms.push_back(sight.phantoms);
      in_lane.push_back(sight.phantom_in_lane);
    }
    strip[name] = {{"found", found}, {"track", track}, {"phantoms", phantoms}, {"in_lane", in_lane}};
  }
  for (std::size_t d = 0; d < kDeaths.size(); ++d) {
    auto& at = json["deaths"][std::to_string(kDeaths[d])];
    for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
      at["track_gap_s"][kDriveVersions[v]] = vehicle.deaths[d].track_gap_s[v];
      at["phantom_frames"][kDriveVersions[v]] = vehicle.deaths[d].phantom_frames[v];
    }
  }
  return json;
}

VehicleDrive read_vehicle_drive(const JsonFields& json) {
  VehicleDrive vehicle;
  vehicle.sequence = json.text("sequence");
  vehicle.type = json.text("type");
  vehicle.track = json.count("track");
  const JsonFields roof = json.object("roof"), strip = json.object("strip");
  vehicle.fitted = roof.count("fitted", kMostOfDrive);
  for (const auto& [key, number] :
       {std::pair("residual_m", &VehicleDrive::residual_m),
        std::pair("residual_deg", &VehicleDrive::residual_deg),
        std::pair("fit_jitter_m", &VehicleDrive::fit_jitter_m),
        std::pair("jitter_m", &VehicleDrive::jitter_m), std::pair("in_box_m", &VehicleDrive::in_box_m),
        std::pair("in_box_deg", &VehicleDrive::in_box_deg)})
    vehicle.*number = roof.number(key, 0, Range::kMost);
  const auto count = static_cast<std::size_t>(json.count("frames", kMostOfDrive));
  vehicle.frames.resize(count);
  const std::vector<double> index = strip.numbers("index", count, 0, kMostOfDrive);
  for (std::size_t i = 0; i < count; ++i) vehicle.frames[i].index = static_cast<int>(index[i]);
  for (const auto& [key, number] : kColumns) {
    const std::vector<double> values = strip.numbers(key, count, -1e9, 1e9);
    for (std::size_t i = 0; i < count; ++i) vehicle.frames[i].*number = values[i];
  }
  for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
    vehicle.phantom_tracks[v] =
        json.object("phantoms").object(kDriveVersions[v]).count("tracks", kMostOfDrive);
    const JsonFields of = strip.object(kDriveVersions[v]);
    const std::string found = of.text("found"), track = of.text("track");
    const std::vector<double> phantoms = of.numbers("phantoms", count, 0, kMostOfDrive),
                              in_lane = of.numbers("in_lane", count, 0, 1);
    if (found.size() != count || found.find_first_not_of("f-") != found.npos)
      of.fail("found", "is not one f or - for each frame");
    if (track.size() != count || track.find_first_not_of("fcl") != track.npos)
      of.fail("track", "is not one f, c or l for each frame");
    for (std::size_t i = 0; i < count; ++i)
      vehicle.frames[i].sights[v] = {found[i] == 'f', static_cast<TrackSight>(track[i]),
                                     static_cast<int>(phantoms[i]), in_lane[i] > 0};
  }
  for (std::size_t d = 0; d < kDeaths.size(); ++d) {
    const JsonFields at = json.object("deaths").object(std::to_string(kDeaths[d]));
    for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
      vehicle.deaths[d].track_gap_s[v] = at.object("track_gap_s").number(kDriveVersions[v], 0, Range::kMost);
      vehicle.deaths[d].phantom_frames[v] =
          at.object("phantom_frames").count(kDriveVersions[v], kMostOfDrive);
    }
  }
  return vehicle;
}

}  // namespace mirage
