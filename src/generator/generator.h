// Generated driving frames: streets rendered by the ray-traced camera and the LiDAR model.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "base/image.h"
#include "generator/street.h"
#include "scene/frame.h"
#include "sensors/ray_camera.h"

namespace mirage {

/// A rig file (scenes/rigs/NAME.toml): [camera], [lidar], their mount, and the look that generated streets
/// have; cameras beside the first as [cameras.NAME].
struct Rig {
  std::string name;
  Calibration calibration;
  std::string camera = "camera";  ///< the first one's name
  /// A camera beside the first.
  struct Side {
    std::string name;
    Calibration calibration;
  };
  std::vector<Side> others = {};  ///< by name
  LidarModel lidar;
  Look look = Look::european;
  std::string text;  ///< a rig file that holds this camera and this unit
};
/// Reads a rig file (scenes/rigs/kitti64.toml says what each key means). InputError naming file and key.
Rig read_rig(const std::filesystem::path& file);
/// The same rig with another unit (see lidar_file) in place of its own, at the mount pose that the unit's
/// file gives; the velo origin keeps its height over the ground. The name becomes "RIG+UNIT".
Rig with_lidar(Rig rig, const std::string& unit);
/// The same rig with another look, in its text too.
Rig with_look(Rig rig, Look look);

/// The truth of a generated frame beyond its labels. Pixels: by the ray nearest to the pixel's centre.
struct FrameTruth {
  ImageF depth;                        ///< H×W, planar depth (m); 0 where the ray meets nothing (sky)
  Image<std::uint16_t> instance;       ///< H×W: k + 1 where the pixel shows the thing of label k, else 0
  std::vector<std::uint32_t> returns;  ///< one a point of the sweep: (k + 1) << 16 | class, as below
};
/// Class of a label's type in SemanticKITTI's numbers (Behley et al., ICCV 2019): 10 car (vans with one body
/// are cars there), 18 truck, 20 other vehicle, 30 person, 31 bicyclist, 0 for anything else. A return has a
/// class even if k + 1 is 0: things that the image does not show have no label.
std::uint16_t semantic_class(const std::string& type);

/// One frame; depends only on (rig, seed, index), and not on whether `truth` is asked for. Labels follow
/// KITTI (2-D box, truncation, occlusion from what the camera sees of each vehicle). A thing is labelled if a
/// return came from it or if it shows 25 pixels of height, within the picture's frame. Things that only a
/// LiDAR takes for cars are "Misc", and so is a school bus. For a rig with several cameras the street goes on
/// behind the car, and things that the first camera misses are labelled in the one that cuts off least.
Frame generate_frame(const Rig& rig, std::uint64_t seed, std::uint64_t index, FrameTruth* truth = nullptr);

inline constexpr double kDriveStep = 0.1;  ///< s from a drive's frame to the next

/// A frame of a drive at a time (s), as generate_frame makes one; `index` is the drive's. `standing`: a scene
/// of street.standing. The sweep is taken in motion, and written as seen from the car's place at that time; a
/// label's identity is its thing's index in MovingStreet::at. Id: "DRIVE_FRAME", counted by kDriveStep.
Frame generate_drive_frame(const Rig& rig, const generator::MovingStreet& street, const RayScene& standing,
                           std::uint64_t seed, std::uint64_t index, double time);

}  // namespace mirage

// Light and camera of a generated frame.

namespace mirage::generator {

/// Sun, sky and exposure of frame `index` of a seed, the same for every look: sun 14 to 60 degrees up
/// anywhere around; a quarter of the frames overcast (sun 7 to 44 % as strong, sky nearly even), the rest
/// clear or with clouds; exposure 0.85 to 1.5, so that skies and white cars clip now and then as in street
/// pictures.
SceneLight make_light(std::uint64_t seed, std::uint64_t index);

/// Applies lens and sensor to the rendered picture: a blur of 0.5 to 0.85 pixels (sigma), then shot noise of
/// 2e-5 to 1.2e-4 of the signal (variance) and read noise of 0.5e-3 to 2e-3 (sigma), scene-linear. Lens and
/// sensor are those of `index`, the noise is drawn by `moment`.
void expose(ImageF& image, std::uint64_t seed, std::uint64_t index, std::uint64_t moment);

// KITTI labels of the things in a generated street.

/// Labels of the placed things that a return came from or that show 25 rows of pixels in `object` (ids at
/// pixel centres), if any part of them is within the picture's frame. 2-D box: the projected surfaces,
/// clipped to the image, without what is on the roof; truncation: the share of that box cut off; occlusion:
/// from the share of the thing's own pixels that are visible (> 0.8: 0, > 0.35: 1, else 2; no pixel at all:
/// 3, as KITTI's "unknown": detection then asks for nothing).
struct StreetLabels {
  std::vector<Label> labels;
  std::vector<int> line;  ///< of each placed thing: its index in `labels`, −1 where it has none
};
/// `returned`: the thing that each return of the sweep came from, −1 for none of them (simulate_sweep).
StreetLabels label_street(const Street& street, const Calibration& calibration, const Image<int>& object,
                          std::span<const int> returned);

}  // namespace mirage::generator
