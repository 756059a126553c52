#include "attack/drive_result.h"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <string>

#include "base/fields.h"
#include "base/intervals.h"

namespace mirage {
namespace {

constexpr double kLateWithin = 10;  // m within which a confirmation comes late

using Vehicles = std::vector<VehicleDrive>;
/// What is told of one version of a vehicle.
using DriveFigure = double (*)(const DriveOutcome&);

std::string cluster_name(const VehicleDrive& vehicle) {
  return fmt::format("{} {}", vehicle.sequence, vehicle.track);
}

template <class Is>
Vehicles vehicles_that(const Vehicles& vehicles, const Is& is) {
  Vehicles chosen;
  std::copy_if(vehicles.begin(), vehicles.end(), std::back_inserter(chosen), is);
  return chosen;
}

/// How many are so in each version: is(what follows for it).
template <class Is>
nlohmann::json counts_of(const Vehicles& vehicles, const Is& is) {
  return by_version([&](DriveVersion version) {
    return std::count_if(vehicles.begin(), vehicles.end(),
                         [&](const VehicleDrive& vehicle) { return is(outcome_of(vehicle, version)); });
  });
}

template <class NumberOf>
nlohmann::json median_of(const Vehicles& vehicles, const NumberOf& number_of) {
  std::vector<double> values;
  for (const VehicleDrive& vehicle : vehicles) values.push_back(number_of(vehicle));
  return to_json(median_interval(values));
}

/// The median over vehicles of a figure of one version less that of another.
nlohmann::json median_difference(const Vehicles& vehicles, DriveVersion of, DriveVersion less,
                                 DriveFigure figure) {
  return median_of(vehicles, [&](const VehicleDrive& vehicle) {
    return figure(outcome_of(vehicle, of)) - figure(outcome_of(vehicle, less));
  });
}

/// A figure of each vehicle, and differences, as medians.
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

/// Over those that come nearer.
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

/// Of those that are first seen beyond kLateWithin: how many are confirmed no earlier than there.
nlohmann::json near_of(const Vehicles& vehicles) {
  const Vehicles from_afar = vehicles_that(
      vehicles, [](const VehicleDrive& vehicle) { return vehicle.frames.front().range > kLateWithin; });
  nlohmann::json json =
      counts_of(from_afar, [](const DriveOutcome& of) { return kConfirmedAt(of) <= kLateWithin; });
  json["metres"] = kLateWithin;
  json["vehicles"] = from_afar.size();
  return json;
}

nlohmann::json survival_of(const Vehicles& vehicles, double seconds) {
  nlohmann::json row = by_version([&](DriveVersion version) {
    ClusteredShare share;
    for (const VehicleDrive& vehicle : vehicles)
      share.add(cluster_name(vehicle), outcome_of(vehicle, version).gap_s >= seconds);
    return to_json(share.interval());
  });
  row["seconds"] = seconds;
  return row;
}

/// What one of kDeaths gives and costs.
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

nlohmann::json to_json(const DriveResult& result) {
  const Vehicles& vehicles = result.vehicles;
  nlohmann::json json = {
      {"frames", result.frames},
      {"left_out", to_json(result.left_out)},
      {"tracker", to_json(result.clean)},
      {"gap_s", medians_of(vehicles, kGap)},
      {"track_gap_s", medians_of(vehicles, kTrackGap)},
      {"confirmed_m", medians_of(vehicles, kConfirmedAt)},
      {"later_m", later_of(vehicles)},
      {"near", near_of(vehicles)},
      {"never_confirmed", counts_of(vehicles, [](const DriveOutcome& of) { return !of.confirmed; })}};
  for (const VehicleDrive& vehicle : vehicles) json["vehicles"].push_back(to_json(vehicle));
  for (const auto& [key, number] : kRideNumbers)
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
  std::stable_sort(sorted.begin(), sorted.end(),
                   [](const auto* a, const auto* b) { return added_gap(*a) > added_gap(*b); });
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
