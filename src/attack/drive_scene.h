// One sequence of a drive, as all its vehicles share it: its frames before anything is inserted, what a
// detector finds in them, as recorded or with an object on a vehicle, and the tracks through them.
//
// The tracker works in a world laid flat: x, y and heading move with the car's pose, heights are over the
// car's road, because a detector's boxes follow the road and not the horizon.
#pragma once

#include <array>
#include <functional>
#include <string>
#include <vector>

#include "attack/drive.h"
#include "base/lazy.h"
#include "frames/frame_store.h"

namespace mirage {

/// A frame of a sequence with all that is known of it before anything is inserted.
struct SceneFrame {
  std::string id;
  Moment moment;
  std::vector<Label> labels;
  Calibration calibration;
};

/// What a detector finds in each frame of a scene.
using Sights = std::vector<std::vector<Detection>>;
/// The tracks that live in each frame of a scene, in `velo`.
using Tracks = std::vector<std::vector<TrackState>>;

/// Tracks through one version of a scene: by whoever tracks in the drive, and by our tracker at each of
/// kDeaths.
struct VersionTracks {
  Tracks own;
  std::array<Tracks, kDeaths.size()> others;  ///< none where our tracker at this death is `own`
  const Tracks& at(std::size_t death) const { return others[death].empty() ? own : others[death]; }
};

/// The vehicle that carries the object in a frame; null where it is not followed.
struct Rider {
  const Carrier* carrier = nullptr;
  HostId host;
};
/// By the place of a frame in its scene.
using Riders = std::vector<Rider>;

/// One way through a scene: an object on one vehicle, or nothing on any.
struct Pass {
  const Riders* riders = nullptr;
  const TexturedMesh* object = nullptr;
};

/// See the header. What it is made of outlives it.
class DriveScene {
 public:
  /// Reads the sequence, and looks at it and follows it as recorded. InputError as judge_drive's.
  DriveScene(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request,
             const Sequence& sequence);

  const std::string& name() const { return name_; }
  const std::vector<SceneFrame>& frames() const { return frames_; }
  const Sights& clean() const { return clean_; }  ///< as recorded
  const VersionTracks& clean_tracks() const { return clean_tracks_; }

  /// Whether a frame's answer depends on others.
  bool needs_all() const { return can_.remembers || request_.settings.sweeps > 1; }
  /// What the detector finds in each pass. Passes go through a frame one after the other, so that what it
  /// makes of the frame without an object serves them all. After Ctrl-C, Interrupted.
  std::vector<Sights> see(const std::vector<Pass>& passes, const std::function<void()>& frame_done) const;

  /// `own` by the detector itself, the user's tracker, or ours.
  VersionTracks follow(const Sights& sights) const;
  /// Detections that confirm a track on a vehicle: a tracker of the user's confirms by its own rule.
  int birth() const { return request_.tracker || can_.remembers ? 1 : request_.settings.tracker.birth; }
  /// The detection's box; one from above is given a height.
  Box3 upright(const Box3& box) const;

 private:
  Sights recorded() const;
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
  Sights clean_;
  VersionTracks clean_tracks_;
};

/// The box in the flat world, or back with the inverse: `pose` moves x, y and heading alone.
Box3 moved_flat(const Box3& box, const Transform& pose);
/// world_from_ego, or its inverse, laid flat.
Transform laid_flat(const Transform& pose);

}  // namespace mirage
