// `mirage drive`: every vehicle of a drive carries the object once, through all its frames. A detector
// processes each frame, a tracker (tracking/tracker.h) the whole drive. How long and until what distance the
// vehicle goes unseen is compared with the drive as recorded, and with a random object of the same size.
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
  Detector* tracker = nullptr;         ///< reads kDetections, in place of settings.tracker; null: that
  ObjectRenderer* renderer = nullptr;  ///< draws both objects for the detector; null: the rasteriser
  std::optional<DriveVehicles> only;   ///< these alone are judged; none: all
  /// Finished vehicles are written here, as SEQUENCE_TRACK.json; empty: they are not. Such a file also holds
  /// what the vehicle's frames showed: by version, a list a frame of boxes [x, y, bottom, length, width,
  /// height, yaw, score] and of confirmed tracks [identity, x, y, bottom, length, width, height, yaw, whether
  /// it has a detection] (m, rad, `velo`).
  std::filesystem::path folder;
  Provenance provenance;
  /// Finished vehicles are read again while `provenance` says the same. Not so where it cannot say all: of a
  /// detector without a detector_identity(), or of a tracker that tells no version.
  bool goes_on = true;
};

/// InputError if the detector finds boxes in the picture alone or is judged there, if no vehicle has frames
/// enough, and for a tracker that does not read kDetections alone, remembers nothing or gives a box no
/// identity. After Ctrl-C, Interrupted: finished vehicles go on where DriveRequest::goes_on. Ranks share the
/// vehicles. Results do not depend on the number of detectors or ranks.
DriveResult judge_drive(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request);

// The tracker works in a world laid flat: x, y and heading move with the car's pose, heights are over the
// car's road, because a detector's boxes follow the road and not the horizon.

/// The box in the flat world, or back with the inverse: `pose` moves x, y and heading alone.
Box3 moved_flat(const Box3& box, const Transform& pose);
/// world_from_ego, or its inverse, laid flat.
Transform laid_flat(const Transform& pose);

}  // namespace mirage
