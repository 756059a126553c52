// What a drive says over all its vehicles: medians, shares and how much the object adds.
#pragma once

#include <nlohmann/json.hpp>
#include <vector>

#include "attack/vehicle_drive.h"
#include "frames/hosts.h"
#include "tracking/track_scores.h"

namespace mirage {

/// A drive, judged.
struct DriveResult {
  std::vector<VehicleDrive> vehicles;  ///< by sequence, then by identity
  TrackScores clean;  ///< of tracks of cars and vans as recorded, at an IoU of 0.5 from above
  int frames = 0;
  HostsLeftOut left_out;  ///< vehicles beside which the object has no room in some frame
};

/// {vehicles: as to_json(VehicleDrive), gap_s, track_gap_s, confirmed_m: medians over vehicles {clean,
/// attacked, random, attacked_less_clean, attacked_less_random: {value, low, high}} (median_interval; a
/// vehicle that is never confirmed counts as confirmed at 0 m), later_m: {vehicles, than_clean, than_random}:
/// by how many metres less far the attacked one is confirmed, over those that come nearer, near: {metres,
/// vehicles: first seen beyond, clean, …: of these, not confirmed before}, never_confirmed: {clean, …},
/// deaths: [{death, track_gap_s: medians, phantom_share: of the frames}] for kDeaths, roof: medians of
/// kRideNumbers, survival: [{seconds, clean, attacked, random: share of vehicles with a gap of so long or
/// more}], tracker: TrackScores as recorded, frames, left_out}
nlohmann::json to_json(const DriveResult& result);

/// By what the object adds to the longest gap of detection, the most first.
std::vector<const VehicleDrive*> by_added_gap(const std::vector<VehicleDrive>& vehicles);
/// At most `count` vehicles, those of the longest gap that the object adds to the recorded one. Only where it
/// adds any.
DriveVehicles longest_hidden(const DriveResult& result, int count);
/// The same vehicles by another renderer: {vehicles: [as above], gap_s, track_gap_s: medians as above,
/// raster_gap_s: the same of `plain`, kept: {value, low, high}: what the object adds to the gaps, as a share
/// of what it adds in `plain`}. They were chosen for their gaps in `plain`, so kept is rather too low.
nlohmann::json by_renderer(const DriveResult& result, const DriveResult& plain);

}  // namespace mirage
