// `mirage drive`: every vehicle of a drive carries the object once, through all its frames. A detector
// processes each frame, a tracker (tracking/tracker.h) the whole drive. The vehicle's undetected time and
// distance are compared with the drive as recorded, and with a random object of the same size.
//
// Vehicles are cars and vans that the data set follows through at least `least_frames` frames in the
// detector's region. The object rides on the vehicle's smoothed track (attack/vehicle_drive.h). Frames in
// which the vehicle is not labelled are as recorded.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "attack/evaluation.h"
#include "attack/observation.h"
#include "attack/vehicle_drive.h"
#include "base/provenance.h"
#include "frames/frame_store.h"
#include "scene/data/read_frames.h"
#include "tracking/tracker.h"

namespace mirage {

/// Settings for judging a drive.
struct DriveSettings {
  TrackerSettings tracker;
  int least_frames = 20;  ///< fewest frames of a vehicle's track
  int sweeps = 1;         ///< seen at a time: the frame's own and earlier ones
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

/// Input of a user's tracker: a sensor of kind other, N × 8 float32: x, y, z of the centre, length, width,
/// height, yaw (m, rad, ego frame), score.
inline constexpr const char* kDetections = "detections";

/// A drive to be judged.
struct DriveRequest {
  std::filesystem::path data;
  std::vector<Sequence> sequences;
  TexturedMesh object, random;                      ///< in the adversary frame
  PlaceChoice place = {};                           ///< where on the vehicle, or beside it
  std::vector<std::string> types = {"Car", "Van"};  ///< of labels that are judged
  SimulationSettings simulation;
  EvaluationSettings evaluation;  ///< the score of a detection, and the identity of the detector
  DriveSettings settings;
  Detector* tracker = nullptr;         ///< reads kDetections; null: settings.tracker
  ObjectRenderer* renderer = nullptr;  ///< draws both objects for the detector; null: the rasteriser
  std::optional<DriveVehicles> only;   ///< judges only these; nullopt: all
  /// Finished vehicles are written here as SEQUENCE_TRACK.json; empty: not written. The file also holds boxes
  /// and confirmed tracks by version and frame (m, rad, `velo`): [x, y, bottom, length, width, height, yaw,
  /// score] and [identity, x, y, bottom, length, width, height, yaw, whether it has a detection].
  std::filesystem::path folder;
  Provenance provenance;
  /// Reads finished vehicles from `folder` if their `provenance` is the same. False if the provenance is
  /// incomplete: the detector has no detector_identity(), or the tracker no version.
  bool goes_on = true;
};

/// InputError if the detector finds boxes in the picture alone or is judged there, or if no vehicle has
/// enough frames. InputError for a tracker that reads anything but kDetections, remembers nothing, or returns
/// a box without an identity. Interrupted after Ctrl-C: with DriveRequest::goes_on, finished vehicles are
/// kept. Ranks share the vehicles. Results do not depend on the number of detectors or ranks.
DriveResult judge_drive(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request);

// The tracker works in a flattened world: x, y and heading move with the ego pose, and heights are over the
// ego's road. A detector's boxes follow the road, not the horizon.

/// Moves the box into the flat world, or back with the inverse: `pose` changes x, y and heading alone.
Box3 moved_flat(const Box3& box, const Transform& pose);
/// world_from_ego, or its inverse, without roll, pitch and z.
Transform laid_flat(const Transform& pose);

}  // namespace mirage
