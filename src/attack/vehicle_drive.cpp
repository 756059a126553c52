#include "attack/vehicle_drive.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>

#include "base/fields.h"
#include "base/intervals.h"
#include "base/names.h"
#include "base/types.h"

namespace mirage {
namespace {

/// The roof's x, y, z (m) and heading in the labelled box.
Eigen::Vector4d place_in_box(const Label& label, const Transform& velo_from_roof) {
  const Transform roof = velo_from_box(label.box).inverse() * velo_from_roof;
  return {roof.translation().x(), roof.translation().y(), roof.translation().z(), heading_of(roof)};
}

/// box_from_roof: the median position and heading.
Transform usual_roof(const std::vector<RoofTrackFrame>& frames) {
  const bool none =
      std::ranges::all_of(frames, [](const RoofTrackFrame& frame) { return frame.carrier.from_box; });
  std::array<std::vector<double>, 4> values;
  for (const auto& [moment, carrier] : frames) {
    if (carrier.from_box && !none) continue;
    const Eigen::Vector4d place = place_in_box(carrier.label, carrier.velo_from_roof);
    for (int i = 0; i < 4; ++i) values[as_size(i)].push_back(place[i]);
  }
  std::array<double, 4> usual{};
  for (std::size_t i = 0; i < 4; ++i) usual[i] = median_interval(values[i]).value;
  return upright_pose(Vec3d(usual[0], usual[1], usual[2]), usual[3]);
}

/// Sets RoofTrackFit::in_box_m and in_box_deg.
void spread_in_boxes(const std::vector<RoofTrackFrame>& frames, const std::vector<Carrier>& carriers,
                     RoofTrackFit& fit) {
  std::vector<Eigen::Vector4d> places;
  Eigen::Vector4d mean = Eigen::Vector4d::Zero();
  for (std::size_t i = 0; i < frames.size(); ++i) {
    places.push_back(place_in_box(frames[i].carrier.label, carriers[i].velo_from_roof));
    mean += places.back() / static_cast<double>(frames.size());
  }
  double squares = 0, turns = 0;
  for (const Eigen::Vector4d& place : places) {
    squares += (place - mean).head<3>().squaredNorm();
    turns += (place - mean)[3] * (place - mean)[3];
  }
  const auto count = static_cast<double>(frames.size());
  fit.in_box_m = std::sqrt(squares / count);
  fit.in_box_deg = std::sqrt(turns / count) / kDegree;
}

constexpr double kAbsentSteps = 2.5;  // a longer step, in usual steps, means the vehicle was away

/// Duration of a frame (s), and whether the vehicle is away after it.
struct FrameDuration {
  double seconds = 0;
  bool away = false;
};

std::vector<FrameDuration> frame_durations(const std::vector<DriveFrame>& frames) {
  std::vector<double> steps;
  for (std::size_t i = 0; i + 1 < frames.size(); ++i) steps.push_back(frames[i + 1].time - frames[i].time);
  const double usual = steps.empty() ? 0 : median_interval(steps).value;
  std::vector<FrameDuration> stands(frames.size(), {usual, false});
  for (std::size_t i = 0; i < steps.size(); ++i)
    stands[i] =
        steps[i] <= kAbsentSteps * usual ? FrameDuration{steps[i], false} : FrameDuration{usual, true};
  return stands;
}

template <class Lacks>
double longest_run(const std::vector<FrameDuration>& stands, const Lacks& lacks) {
  double longest = 0, run = 0;
  for (std::size_t i = 0; i < stands.size(); ++i) {
    if (i > 0 && stands[i - 1].away) run = 0;
    run = lacks(i) ? run + stands[i].seconds : 0;
    longest = std::max(longest, run);
  }
  return longest;
}

constexpr std::pair<const char*, double DriveFrame::*> kColumns[] = {{"time_s", &DriveFrame::time},
                                                                     {"range_m", &DriveFrame::range},
                                                                     {"nearest_m", &DriveFrame::nearest},
                                                                     {"closing_mps", &DriveFrame::closing}};
constexpr int kMaxDriveCount = 1000000;  // frames, tracks

constexpr double kLateWithin = 10;  // m, range within which a confirmation is late

using Vehicles = std::vector<VehicleDrive>;
/// A figure of a vehicle's outcome in one version.
using DriveFigure = double (*)(const DriveOutcome&);

std::string cluster_name(const VehicleDrive& vehicle) {
  return fmt::format("{} {}", vehicle.sequence, vehicle.track);
}

template <class Is>
Vehicles vehicles_that(const Vehicles& vehicles, const Is& is) {
  Vehicles chosen;
  std::ranges::copy_if(vehicles, std::back_inserter(chosen), is);
  return chosen;
}

/// Number of vehicles in each version for whose outcome `is` holds.
template <class Is>
nlohmann::json counts_of(const Vehicles& vehicles, const Is& is) {
  return by_version([&](DriveVersion version) {
    return std::ranges::count_if(
        vehicles, [&](const VehicleDrive& vehicle) { return is(outcome_of(vehicle, version)); });
  });
}

template <class NumberOf>
nlohmann::json median_of(const Vehicles& vehicles, const NumberOf& number_of) {
  std::vector<double> values;
  for (const VehicleDrive& vehicle : vehicles) values.push_back(number_of(vehicle));
  return to_json(median_interval(values));
}

/// The median over vehicles of a figure's difference, version `of` minus `less`.
nlohmann::json median_difference(const Vehicles& vehicles, DriveVersion of, DriveVersion less,
                                 DriveFigure figure) {
  return median_of(vehicles, [&](const VehicleDrive& vehicle) {
    return figure(outcome_of(vehicle, of)) - figure(outcome_of(vehicle, less));
  });
}

/// Medians of a figure over vehicles, and of its differences.
nlohmann::json medians_of(const Vehicles& vehicles, DriveFigure figure) {
  nlohmann::json json = by_version([&](DriveVersion version) {
    return median_of(vehicles,
                     [&](const VehicleDrive& vehicle) { return figure(outcome_of(vehicle, version)); });
  });
  for (const DriveVersion other : {DriveVersion::clean, DriveVersion::random})
    json[fmt::format("attacked_less_{}", to_word(other))] =
        median_difference(vehicles, DriveVersion::attacked, other, figure);
  return json;
}

constexpr DriveFigure kGap = [](const DriveOutcome& of) { return of.gap_s; };
constexpr DriveFigure kTrackGap = [](const DriveOutcome& of) { return of.track_gap_s; };
constexpr DriveFigure kConfirmedAt = [](const DriveOutcome& of) {
  return of.confirmed ? of.confirmed->metres : 0;
};

/// s that the object adds to the longest gap of detection.
double added_gap(const VehicleDrive& vehicle) {
  return outcome_of(vehicle, DriveVersion::attacked).gap_s - outcome_of(vehicle, DriveVersion::clean).gap_s;
}

/// Medians of how much later vehicles are confirmed (m), over approaching vehicles.
nlohmann::json later_of(const Vehicles& vehicles) {
  const Vehicles nearing = vehicles_that(vehicles, [](const VehicleDrive& vehicle) {
    return vehicle.frames.back().range < vehicle.frames.front().range;
  });
  nlohmann::json json = {{"vehicles", nearing.size()}};
  if (nearing.empty()) return json;
  for (const DriveVersion than : {DriveVersion::clean, DriveVersion::random})
    json[fmt::format("than_{}", to_word(than))] =
        median_difference(nearing, than, DriveVersion::attacked, kConfirmedAt);
  return json;
}

/// Of the vehicles first seen beyond kLateWithin: number not confirmed before it.
nlohmann::json near_of(const Vehicles& vehicles) {
  const Vehicles from_afar = vehicles_that(
      vehicles, [](const VehicleDrive& vehicle) { return vehicle.frames.front().range > kLateWithin; });
  nlohmann::json json =
      counts_of(from_afar, [](const DriveOutcome& of) { return kConfirmedAt(of) <= kLateWithin; });
  json["metres"] = kLateWithin;
  json["vehicles"] = from_afar.size();
  return json;
}

constexpr double kStampError = 1e-4;  // s, tolerance of gaps, which are differences of time stamps

nlohmann::json survival_of(const Vehicles& vehicles, double seconds) {
  nlohmann::json row = by_version([&](DriveVersion version) {
    ClusteredShare share;
    for (const VehicleDrive& vehicle : vehicles)
      share.add(cluster_name(vehicle), outcome_of(vehicle, version).gap_s >= seconds - kStampError);
    return to_json(share.interval());
  });
  row["seconds"] = seconds;
  return row;
}

/// Gaps and phantoms at one of kDeaths.
nlohmann::json death_of(const Vehicles& vehicles, std::size_t death) {
  const auto gap = [&](DriveVersion version) {
    return median_of(vehicles, [&](const VehicleDrive& of) { return of.deaths[death].track_gap_s[version]; });
  };
  const auto phantoms = [&](DriveVersion version) {
    ClusteredShare share;
    for (const VehicleDrive& vehicle : vehicles)
      for (int i = 0; i < static_cast<int>(vehicle.frames.size()); ++i)
        share.add(cluster_name(vehicle), i < vehicle.deaths[death].phantom_frames[version]);
    return to_json(share.interval());
  };
  return {
      {"death", kDeaths[death]}, {"track_gap_s", by_version(gap)}, {"phantom_share", by_version(phantoms)}};
}

}  // namespace

double heading_of(const Transform& pose) {
  return std::atan2(pose(1, 0), pose(0, 0));
}

Transform upright_pose(const Vec3d& position, double yaw) {
  return velo_from_box({{position.x(), position.y(), 0, 0, yaw}, position.z(), 0});
}

RoofTrack roof_track(const std::vector<RoofTrackFrame>& frames) {
  constexpr double kBoxSigma = 0.15, kBoxHeightSigma = 0.08, kBoxYawSigma = 0.04;  // m, m, rad
  RoofTrack track;
  if (frames.empty()) return track;
  const Transform box_from_roof = usual_roof(frames);
  std::vector<PlaceMeasurement> measured;
  for (const auto& [moment, carrier] : frames) {
    PlaceMeasurement place;
    Transform velo_from_roof = carrier.velo_from_roof;
    if (carrier.from_box) {
      velo_from_roof = velo_from_box(carrier.label.box) * box_from_roof;
      place.sigma = Vec3d(kBoxSigma, kBoxSigma, kBoxHeightSigma);
      place.yaw_sigma = kBoxYawSigma;
    }
    const Transform world_from_roof = moment.world_from_ego * velo_from_roof;
    place.time = moment.time;
    place.position = world_from_roof.translation();
    place.yaw = heading_of(world_from_roof);
    measured.push_back(place);
  }
  const std::vector<SmoothPlace> places = smooth(measured);
  std::vector<Vec3d> found, smoothed;
  std::vector<double> times;
  double squares = 0, turns = 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const SmoothPlace& place = places[i];
    const Transform ego_from_world = frames[i].moment.world_from_ego.inverse();
    Carrier carrier = frames[i].carrier;
    // Upright in `velo`, like every roof and box.
    const Vec3d along = ego_from_world.linear() * Vec3d(std::cos(place.yaw), std::sin(place.yaw), 0);
    carrier.velo_from_roof = upright_pose(ego_from_world * place.position, std::atan2(along.y(), along.x()));
    const Transform box = carrier.velo_from_roof * box_from_roof.inverse();
    carrier.label.box.bev.x = box.translation().x();
    carrier.label.box.bev.y = box.translation().y();
    carrier.label.box.bev.yaw = heading_of(box);
    carrier.label.box.bottom = box.translation().z();
    if (carrier.shape) {
      const Transform moved = carrier.velo_from_roof * frames[i].carrier.velo_from_roof.inverse();
      Mesh mesh = *carrier.shape;
      for (Vec3d& v : mesh.vertices) v = moved * v;
      carrier.shape = std::make_shared<const Mesh>(std::move(mesh));
    }
    if (!carrier.from_box) {
      ++track.fit.fitted;
      squares += (measured[i].position - place.position).squaredNorm();
      const double turn = wrap_angle(measured[i].yaw - place.yaw);
      turns += turn * turn;
    }
    times.push_back(measured[i].time);
    found.push_back(measured[i].position);
    smoothed.push_back(place.position);
    track.carriers.push_back(std::move(carrier));
    track.velocities.push_back(place.velocity);
  }
  spread_in_boxes(frames, track.carriers, track.fit);
  track.fit.residual_m = std::sqrt(squares / std::max(1, track.fit.fitted));
  track.fit.residual_deg = std::sqrt(turns / std::max(1, track.fit.fitted)) / kDegree;
  track.fit.fit_jitter_m = jitter(found, times);
  track.fit.jitter_m = jitter(smoothed, times);
  return track;
}

RoofTrack roof_track(FrameStore& store, std::span<const std::pair<Moment, HostId>> frames) {
  std::vector<RoofTrackFrame> found;
  for (const auto& [moment, host] : frames) found.push_back({moment, store.placement(host).carrier.value()});
  return roof_track(found);
}

std::string vehicle_name(const std::string& sequence, int track) {
  return fmt::format("{}_{}", escape_name(sequence), track);
}

DriveOutcome outcome_of(const VehicleDrive& vehicle, DriveVersion version) {
  DriveOutcome outcome;
  const auto& frames = vehicle.frames;
  const auto observation = [&](std::size_t i) -> const DriveObservation& {
    return frames[i].observations[version];
  };
  const std::vector<FrameDuration> stands = frame_durations(frames);
  outcome.gap_s = longest_run(stands, [&](std::size_t i) { return !observation(i).found; });
  outcome.track_gap_s =
      longest_run(stands, [&](std::size_t i) { return observation(i).track == TrackStatus::lost; });
  for (std::size_t i = 0; i < frames.size(); ++i) {
    outcome.found += observation(i).found;
    outcome.phantom_frames += observation(i).phantoms > 0;
    outcome.phantom_s += observation(i).phantoms > 0 ? stands[i].seconds : 0;
    outcome.phantom_lane_s += observation(i).phantom_in_lane ? stands[i].seconds : 0;
    if (outcome.confirmed || observation(i).track == TrackStatus::lost) continue;
    const DriveFrame& frame = frames[i];
    outcome.confirmed = {frame.time - frames.front().time, frame.range, frame.closing, std::nullopt, {}};
    const double speed = std::max(0.0, frame.closing);
    if (speed > 0) outcome.confirmed->time_to_collision = frame.nearest / speed;
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
                         {"roof", {{"fitted", vehicle.roof.fitted}}}};
  for (const auto& [key, number] : kRoofTrackNumbers) json["roof"][key] = vehicle.roof.*number;
  auto& strip = json["strip"];
  for (const DriveFrame& frame : vehicle.frames) {
    strip["index"].push_back(frame.index);
    for (const auto& [key, number] : kColumns) strip[key].push_back(frame.*number);
  }
  for (const auto& [seconds, away] : frame_durations(vehicle.frames)) {
    strip["stands_s"].push_back(seconds);
    strip["away"].push_back(away ? 1 : 0);
  }
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
      if (at->time_to_collision) json["to_collision_s"][name] = *at->time_to_collision;
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
      const DriveObservation& observation = frame.observations[v];
      found += observation.found ? 'f' : '-';
      track += static_cast<char>(observation.track);
      phantoms.push_back(observation.phantoms);
      in_lane.push_back(observation.phantom_in_lane);
    }
    strip[name] = {{"found", found}, {"track", track}, {"phantoms", phantoms}, {"in_lane", in_lane}};
  }
  for (std::size_t d = 0; d < kDeaths.size(); ++d) {
    const DeathOutcome& of = vehicle.deaths[d];
    json["deaths"][std::to_string(kDeaths[d])] = {
        {"track_gap_s", by_version([&](DriveVersion version) { return of.track_gap_s[version]; })},
        {"phantom_frames", by_version([&](DriveVersion version) { return of.phantom_frames[version]; })}};
  }
  return json;
}

VehicleDrive read_vehicle_drive(const JsonFields& json) {
  VehicleDrive vehicle;
  vehicle.sequence = json.text("sequence");
  vehicle.type = json.text("type");
  vehicle.track = json.count("track");
  const JsonFields roof = json.object("roof"), strip = json.object("strip");
  vehicle.roof.fitted = roof.count("fitted", kMaxDriveCount);
  for (const auto& [key, number] : kRoofTrackNumbers) vehicle.roof.*number = roof.number(key, 0, Range::kMax);
  const auto count = as_size(json.count("frames", kMaxDriveCount));
  vehicle.frames.resize(count);
  const std::vector<double> index = strip.numbers("index", count, 0, kMaxDriveCount);
  for (std::size_t i = 0; i < count; ++i) vehicle.frames[i].index = static_cast<int>(index[i]);
  for (const auto& [key, number] : kColumns) {
    const std::vector<double> values = strip.numbers(key, count, -1e9, 1e9);
    for (std::size_t i = 0; i < count; ++i) vehicle.frames[i].*number = values[i];
  }
  for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
    vehicle.phantom_tracks[v] =
        json.object("phantoms").object(kDriveVersions[v]).count("tracks", kMaxDriveCount);
    const JsonFields of = strip.object(kDriveVersions[v]);
    const std::string found = of.text("found"), track = of.text("track");
    const std::vector<double> phantoms = of.numbers("phantoms", count, 0, kMaxDriveCount),
                              in_lane = of.numbers("in_lane", count, 0, 1);
    if (found.size() != count || found.find_first_not_of("f-") != found.npos)
      of.fail("found", "is not one f or - for each frame");
    if (track.size() != count || track.find_first_not_of("fcl") != track.npos)
      of.fail("track", "is not one f, c or l for each frame");
    for (std::size_t i = 0; i < count; ++i)
      vehicle.frames[i].observations[v] = {found[i] == 'f', static_cast<TrackStatus>(track[i]),
                                           static_cast<int>(phantoms[i]), in_lane[i] > 0};
  }
  for (std::size_t d = 0; d < kDeaths.size(); ++d) {
    const JsonFields at = json.object("deaths").object(std::to_string(kDeaths[d]));
    for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
      vehicle.deaths[d].track_gap_s[v] = at.object("track_gap_s").number(kDriveVersions[v], 0, Range::kMax);
      vehicle.deaths[d].phantom_frames[v] =
          at.object("phantom_frames").count(kDriveVersions[v], kMaxDriveCount);
    }
  }
  return vehicle;
}

nlohmann::json to_json(const DriveResult& result) {
  const Vehicles& vehicles = result.vehicles;
  nlohmann::json json = {
      {"frames", result.frames},
      {"left_out", to_json(result.left_out)},
      {"tracker", fields_json(result.clean)},
      {"gap_s", medians_of(vehicles, kGap)},
      {"track_gap_s", medians_of(vehicles, kTrackGap)},
      {"confirmed_m", medians_of(vehicles, kConfirmedAt)},
      {"later_m", later_of(vehicles)},
      {"near", near_of(vehicles)},
      {"never_confirmed", counts_of(vehicles, [](const DriveOutcome& of) { return !of.confirmed; })}};
  for (const VehicleDrive& vehicle : vehicles) json["vehicles"].push_back(to_json(vehicle));
  for (const auto& [key, number] : kRoofTrackNumbers)
    json["roof"][key] =
        median_of(vehicles, [number = number](const VehicleDrive& of) { return of.roof.*number; });
  for (const double seconds : {0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0})
    json["survival"].push_back(survival_of(vehicles, seconds));
  for (std::size_t d = 0; d < kDeaths.size(); ++d) json["deaths"].push_back(death_of(vehicles, d));
  return json;
}

std::vector<const VehicleDrive*> by_added_gap(const Vehicles& vehicles) {
  std::vector<const VehicleDrive*> sorted;
  for (const VehicleDrive& vehicle : vehicles) sorted.push_back(&vehicle);
  std::ranges::stable_sort(sorted, std::greater(), [](const auto* vehicle) { return added_gap(*vehicle); });
  return sorted;
}

DriveVehicles longest_hidden(const DriveResult& result, int count) {
  DriveVehicles chosen;
  for (const VehicleDrive* vehicle : by_added_gap(result.vehicles))
    if (added_gap(*vehicle) > 0 && static_cast<int>(chosen.size()) < count)
      chosen.emplace(vehicle->sequence, vehicle->track);
  return chosen;
}

nlohmann::json by_renderer(const DriveResult& result, const DriveResult& plain) {
  Vehicles same;
  for (const VehicleDrive& vehicle : result.vehicles)
    for (const VehicleDrive& other : plain.vehicles)
      if (other.sequence == vehicle.sequence && other.track == vehicle.track) same.push_back(other);
  nlohmann::json json = {{"gap_s", medians_of(result.vehicles, kGap)},
                         {"track_gap_s", medians_of(result.vehicles, kTrackGap)},
                         {"raster_gap_s", medians_of(same, kGap)}};
  ClusteredShare kept;
  for (std::size_t i = 0; i < same.size(); ++i) {
    json["vehicles"].push_back(to_json(result.vehicles[i]));
    kept.add(cluster_name(same[i]), added_gap(result.vehicles[i]) / added_gap(same[i]), 0,
             added_gap(same[i]));
  }
  json["kept"] = to_json(kept.mean_interval());
  return json;
}

}  // namespace mirage
