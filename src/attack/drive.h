// What `mirage drive` does: every vehicle of a drive carries the object once, through all its frames; a
// detector looks at each frame, a tracker (tracking/tracker.h) goes through the whole drive, and what is seen
// of the vehicle is told in seconds and metres, beside the drive as recorded and a random object of the same
// size.
//
// Vehicles are cars and vans that the data set follows through at least `least_frames` frames in the
// detector's region. The object rides on the vehicle's smoothed track (attack/vehicle_drive.h). Frames in
// which the vehicle is not labelled are as recorded. The tracker works in a world laid flat: x, y and heading
// move with the car's pose, heights are over the car's road, because a detector's boxes follow the road and
// not the horizon.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "attack/evaluation.h"
#include "attack/object_renderer.h"
#include "attack/vehicle_drive.h"
#include "base/provenance.h"
#include "scene/data/sequences.h"
#include "tracking/track_scores.h"
#include "tracking/tracker.h"

namespace mirage {

/// What a drive is judged by.
struct DriveSettings {
  TrackerSettings tracker;
  int least_frames = 20;  ///< of a vehicle's track
  int sweeps = 1;         ///< that a detector sees at a time: the frame's own and those before it
};

template <class Visitor, FieldsOf<DriveSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, s.tracker);
  visit({.name = "least_frames",
         .help = "frames in the detector's region that a vehicle needs to be judged",
         .range = {3, 100000}},
        s.least_frames);
  visit({.name = "sweeps",
         .help = "sweeps that the detector sees at a time: the frame's own, and those before it moved by the "
                 "car's pose",
         .range = {1, 20}},
        s.sweeps);
}

/// What a tracker of the user's reads: a sensor of kind other, N × 8 float32: x, y, z of the centre, length,
/// width, height, yaw (m, rad, ego frame), score.
inline constexpr const char* kDetections = "detections";

/// Vehicles of a drive, by sequence and identity.
using DriveVehicles = std::set<std::pair<std::string, int>>;

/// What all vehicles are judged with.
struct DriveRequest {
  std::filesystem::path data;
  std::vector<Sequence> sequences;
  TexturedMesh object, random;  ///< in the adversary frame
  PlaceChoice place = {};       ///< where on the vehicle, or beside it
  SimulationSettings simulation;
  EvaluationSettings evaluation;  ///< the score of a detection, and the identity of the detector
  DriveSettings settings;
  Detector* tracker = nullptr;         ///< reads kDetections, in place of settings.tracker; null: that
  ObjectRenderer* renderer = nullptr;  ///< draws both objects for the detector; null: the rasteriser
  std::optional<DriveVehicles> only;   ///< these alone are judged; none: all
  /// Finished vehicles are kept here, as SEQUENCE_TRACK.json, and read again while `made_of` says the same;
  /// empty: they are not. Such a file also holds what the vehicle's frames showed: by version, a list a frame
  /// of boxes [x, y, bottom, length, width, height, yaw, score] and of confirmed tracks [identity, x, y,
  /// bottom, length, width, height, yaw, whether it has a detection] (m, rad, `velo`).
  std::filesystem::path folder;
  Provenance made_of;
};

/// A drive, judged.
struct DriveResult {
  std::vector<VehicleDrive> vehicles;  ///< by sequence, then by identity
  TrackScores clean;  ///< of tracks of cars and vans as recorded, at an IoU of 0.5 from above
  int frames = 0;
};

/// InputError if the detector finds boxes in the picture alone, if no vehicle has frames enough, and for a
/// tracker that does not read kDetections alone, remembers nothing or gives a box no identity. After Ctrl-C,
/// Interrupted: finished vehicles are kept. Ranks share the vehicles. Results do not depend on the number of
/// detectors or ranks.
DriveResult judge_drive(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request);

/// {vehicles: as to_json(VehicleDrive), gap_s, track_gap_s, confirmed_m: medians over vehicles {clean,
/// attacked, random, attacked_less_clean, attacked_less_random: {value, low, high}} (median_interval; a
/// vehicle that is never confirmed counts as confirmed at 0 m), later_m: {vehicles, than_clean, than_random}:
/// by how many metres less far the attacked one is confirmed, over those that come nearer, near: {metres,
/// vehicles: first seen beyond, clean, …: of these, not confirmed before}, never_confirmed: {clean, …},
/// deaths:
/// [{death, track_gap_s: medians, phantom_share: of the frames}] for kDeaths, roof: medians of
/// Ride's figures, survival:
/// [{seconds, clean, attacked, random: share of vehicles with a gap of so long or more}], tracker:
/// TrackScores as recorded, frames}
nlohmann::json to_json(const DriveResult& result);

/// At most `count` vehicles, those of the longest gap that the object adds to the recorded one. Only where it
/// adds any.
DriveVehicles longest_hidden(const DriveResult& result, int count);
/// The same vehicles by another renderer: {vehicles: [as above], gap_s, track_gap_s: medians as above,
/// raster_gap_s: the same of `plain`, kept: {value, low, high}: what the object adds to the gaps, as a share
/// of what it adds in `plain`}. They were chosen for their gaps in `plain`, so kept is rather too low.
nlohmann::json by_renderer(const DriveResult& result, const DriveResult& plain);

/// The ride of a vehicle over its track, given the label that it has in each frame.
Ride ride(FrameStore& store, std::span<const std::pair<Moment, HostId>> frames);

/// The box in the flat world, or back with the inverse: `pose` moves x, y and heading alone.
Box3 moved_flat(const Box3& box, const Transform& pose);
/// world_from_ego, or its inverse, laid flat.
Transform laid_flat(const Transform& pose);

}  // namespace mirage
