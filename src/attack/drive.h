// What `mirage drive` does: every vehicle of a drive carries the object once, through all its frames; a
// detector looks at each frame, a tracker (tracking/tracker.h) goes through the whole drive, and what is seen
// of the vehicle is told in seconds and metres, beside the drive as recorded and a random object of the same
// size.
//
// Vehicles are cars and vans that the data set follows through at least `least_frames` frames in the
// detector's region. The object rides on the vehicle's smoothed track (attack/vehicle_drive.h). Frames in
// which the vehicle is not labelled are as recorded.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "attack/evaluation.h"
#include "attack/observation.h"
#include "attack/vehicle_drive.h"
#include "base/parallel.h"
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

// One sequence of a drive, as all its vehicles share it: its frames before anything is inserted, what a
// detector finds in them, as recorded or with an object on a vehicle, and the tracks through them.
//
// The tracker works in a world laid flat: x, y and heading move with the car's pose, heights are over the
// car's road, because a detector's boxes follow the road and not the horizon.

/// A frame of a sequence with all that is known of it before anything is inserted.
struct SceneFrame {
  std::string id;
  Moment moment;
  std::vector<Label> labels;
  Calibration calibration;
};

/// What a detector finds in each frame of a scene.
using SceneDetections = std::vector<std::vector<Detection>>;
/// The tracks that live in each frame of a scene, in `velo`.
using Tracks = std::vector<std::vector<TrackState>>;

/// Tracks through one version of a scene: by whoever tracks in the drive, and by our tracker at each of
/// kDeaths.
struct VersionTracks {
  Tracks own;
  std::array<Tracks, kDeaths.size()> others;  ///< none where our tracker at this death is `own`
  /// The tracks by our tracker at kDeaths[death].
  const Tracks& at(std::size_t death) const { return others[death].empty() ? own : others[death]; }
};

/// The vehicle that carries the object in a frame; null where it is not followed.
struct FrameCarrier {
  const Carrier* carrier = nullptr;
  HostId host;
};
/// By the place of a frame in its scene.
using FrameCarriers = std::vector<FrameCarrier>;

/// One way through a scene: an object on one vehicle, or nothing on any.
struct Pass {
  const FrameCarriers* carriers = nullptr;
  const TexturedMesh* object = nullptr;
};

/// See the header. What it is made of outlives it.
class DriveScene {
 public:
  /// Reads the sequence, and looks at it and follows it as recorded. InputError as judge_drive's.
  DriveScene(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request,
             const Sequence& sequence);

  /// The sequence's name.
  const std::string& name() const { return name_; }
  /// The sequence's frames, by rising time.
  const std::vector<SceneFrame>& frames() const { return frames_; }
  const SceneDetections& clean() const { return clean_; }              ///< as recorded
  const VersionTracks& clean_tracks() const { return clean_tracks_; }  ///< as recorded

  /// Whether a frame's answer depends on others.
  bool needs_all() const { return can_.remembers || request_.settings.sweeps > 1; }
  /// What the detector finds in each pass. Passes go through a frame one after the other, so that what it
  /// makes of the frame without an object serves them all. After Ctrl-C, Interrupted.
  std::vector<SceneDetections> see(const std::vector<Pass>& passes,
                                   const std::function<void()>& frame_done) const;

  /// `own` by the detector itself, the user's tracker, or ours.
  VersionTracks follow(const SceneDetections& scene_detections) const;
  /// How boxes are compared with the vehicle's label.
  Matching matching() const { return can_.matching(); }
  /// Detections that confirm a track on a vehicle: a tracker of the user's confirms by its own rule.
  int birth() const { return request_.tracker || can_.remembers ? 1 : request_.settings.tracker.birth; }
  /// The detection's box; one from above is given a height.
  Box3 upright(const Box3& box) const;

 private:
  SceneDetections recorded() const;
  Sweep merged(std::size_t i, const std::vector<Lazy<Sweep>>& sweeps) const;
  std::vector<Detection> seen(Detector& detector, std::size_t i, const Pass& pass,
                              const std::vector<Lazy<Sweep>>& sweeps, RenderedPictures* pictures) const;

  const DetectorPool& detectors_;
  FrameStore& store_;
  const DriveRequest& request_;
  Capabilities can_;
  std::string name_;
  std::vector<SceneFrame> frames_;
  double road_ = 0;  ///< m, its z in `velo`
  SceneDetections clean_;
  VersionTracks clean_tracks_;
};

/// The box in the flat world, or back with the inverse: `pose` moves x, y and heading alone.
Box3 moved_flat(const Box3& box, const Transform& pose);
/// world_from_ego, or its inverse, laid flat.
Transform laid_flat(const Transform& pose);

}  // namespace mirage
