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
#include <span>
#include <string>
#include <vector>

#include "attack/evaluation.h"
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
};

template <class Visitor, FieldsOf<DriveSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, s.tracker);
  visit({.name = "least_frames",
         .help = "frames in the detector's region that a vehicle needs to be judged",
         .range = {3, 100000}},
        s.least_frames);
}

/// What all vehicles are judged with.
struct DriveRequest {
  std::filesystem::path data;
  std::vector<Sequence> sequences;
  TexturedMesh object, random;  ///< in the adversary frame
  PlaceChoice place = {};       ///< where on the vehicle, or beside it
  SimulationSettings simulation;
  EvaluationSettings evaluation;  ///< the score of a detection, and the identity of the detector
  DriveSettings settings;
  /// Finished vehicles are kept here, as SEQUENCE_TRACK.json, and read again while `made_of` says the same;
  /// empty: they are not.
  std::filesystem::path folder;
  Provenance made_of;
};

/// A drive, judged.
struct DriveResult {
  std::vector<VehicleDrive> vehicles;  ///< by sequence, then by identity
  TrackScores clean;  ///< of tracks of cars and vans as recorded, at an IoU of 0.5 from above
  int frames = 0;
};

/// InputError if the detector finds boxes in the picture alone, and if no vehicle has frames enough. After
/// Ctrl-C, Interrupted: finished vehicles are kept. Results do not depend on the number of detectors.
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

/// The box in the flat world, or back with the inverse: `pose` moves x, y and heading alone.
Box3 moved_flat(const Box3& box, const Transform& pose);
/// world_from_ego, or its inverse, laid flat.
Transform laid_flat(const Transform& pose);

}  // namespace mirage
