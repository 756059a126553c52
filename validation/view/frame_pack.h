// One frame of `mirage view` as the page carries it.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "frames/host_id.h"
#include "scene/data/kitti_rows.h"
#include "scene/frame.h"
#include "sensors/lidar_model.h"
#include "simulation/simulation.h"

namespace mirage {

/// A confirmed track of a drive.
struct ViewTrack {
  int identity = 0;
  Box3 box;
  bool detected = false;  ///< else it coasts
};

/// The boxes that were found in one frame, and the tracks.
struct ViewDetections {
  std::vector<KittiDetection> found;
  bool looked = false;  ///< the frame was looked at: no boxes means that nothing was found
  std::vector<ViewTrack> tracks = {};
};

/// The frame with the adversary on one host.
struct ViewAttack {
  std::string name;  ///< host_name()
  int label = 0;     ///< of the host
  /// The label whose detection is judged, if not the host's: the neighbour's with Victim::neighbour, the
  /// object's own with Victim::object.
  std::optional<int> victim = {};
  std::optional<Label> object = {};  ///< in_a_camera()
  /// The changed part of a camera's picture.
  struct Patch {
    std::size_t camera = 0;  ///< by its number
    PixelRect rect;
    ImageF patch;  ///< rect-sized, scene-linear RGB
  };
  std::vector<Patch> patches;
  std::vector<bool> removed;  ///< of each point of the frame's sweep: the object hides it
  Sweep added;                ///< returns on the object
  ViewDetections found;       ///< by the run's detector
  nlohmann::json outcome;     ///< clean_score, attacked_score, …; null without a detector
};

struct ViewFrame {
  Frame frame;
  std::vector<int> instance;        ///< of each point: its label's number, −1 for none
  bool true_instance = false;       ///< by the generator's truth; else by the labelled boxes
  ViewDetections found, from_file;  ///< by the run's detector; from --detections
  std::vector<ViewAttack> attacks;
};

/// Instances of the sweep's points: training/instance_velodyne where the data set has it, else the first
/// label in whose box they lie.
void find_instances(const std::filesystem::path& data, ViewFrame& view);

/// The changes that the object on that host makes to the frame, without detections: `outcome` has visible,
/// returns and removed. `prepared`: of view.frame.
ViewAttack attack_of(const ViewFrame& view, const PreparedFrame& prepared, const HostId& host,
                     const Simulated& simulated);

/// How much a frame was thinned to fit.
struct PackSettings {
  int quality = 85;  ///< of the JPEG picture
  int step =
      1;  ///< one return in `step` is kept, and all within labelled boxes and all that the object hides
};

struct PackedFrame {
  std::string text;  ///< base64(gzip(container)), see pack()
  PackSettings settings;
  std::size_t points = 0, kept = 0;
  double lowest = 0, highest = 0, brightest = 0;  ///< 1 % and 99 % quantiles of z (m), 99 % of reflectance
};

/// The frame in at most `limit` characters, thinned from `start` on as far as needed. The container: the
/// JSON's length (4 bytes, little endian), the JSON, and blobs that it names as [offset, length]: for each of
/// `cameras` its `photo` (JPEG), `points` (packed_points), for each of `attacks` its `patches` (JPEG),
/// `removed` (indices of kept points, 4 bytes each) and `added` (packed_points). InputError, naming --size,
/// if it can't be.
PackedFrame pack(const ViewFrame& view, std::size_t limit, PackSettings start);

}  // namespace mirage
