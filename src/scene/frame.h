// One recorded or generated moment: photographs, sweep, calibration and labels.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "base/image.h"
#include "base/parallel.h"
#include "geometry/box.h"
#include "sensors/camera.h"
#include "sensors/lidar_model.h"
#include "sensors/lighting.h"

namespace mirage {

/// Calibration of a KITTI frame. `camera` here is the left colour camera (P2) itself: P2's fourth column is
/// folded into camera_from_velo, so that pixels come from one pinhole and one rigid transform.
/// The last two fields matter to KITTI files only: labels are kept in the rectified frame of camera 0
/// (`rect`), 6 cm beside the colour camera. Their defaults are right for a rig without such an offset.
struct Calibration {
  PinholeCamera camera;  ///< from P2 and the image's size
  Transform camera_from_velo = Transform::Identity();
  Transform camera_from_rect = Transform::Identity();  ///< a translation: K⁻¹ times P2's fourth column
  Eigen::Matrix3d rect_from_cam0 = Eigen::Matrix3d::Identity();  ///< R0_rect, to write the file again

  /// The transform to the frame of labels in KITTI's files.
  Transform rect_from_velo() const { return camera_from_rect.inverse() * camera_from_velo; }
};

/// A ground-truth object, as labelled, with its box in `velo`.
struct Label {
  std::string type;                                 ///< "Car", "Van", …, "DontCare" (data/data_set.h)
  double truncated = 0;                             ///< 0 … 1
  int occluded = 0;                                 ///< 0 fully visible … 3 unknown
  double left = 0, top = 0, right = 0, bottom = 0;  ///< 2-D box, pixels
  Box3 box;                                         ///< in `velo`; meaningless unless has_box()
  int track = -1;                                   ///< the vehicle's track id in the data set; -1: unknown
  bool in_space = true;                             ///< false: the label has a 2-D box only
  std::string category = {};                        ///< the class as labelled: "Tram", "vehicle.bus.rigid"
  std::optional<Vec3d> velocity = {};  ///< m/s over ground along the axes of `velo`; nullopt: unknown
  int camera = 0;                      ///< of its 2-D box: 0 the first, k the frame's others[k − 1]
  std::optional<bool> sought = {};     ///< whether its class is sought (FrameSource::classes)
};

/// Whether the label's class carries the object and has to be detected: as marked, otherwise a car.
inline bool is_sought(const Label& label) {
  return label.sought.value_or(label.type == "Car");
}

/// Whether the label has a 3-D box: not DontCare regions, nor labels with a 2-D box only.
inline bool has_box(const Label& label) {
  return label.in_space && label.type != "DontCare";
}

/// Time of a frame and pose of the car. The ego frame is `velo`.
struct Moment {
  std::string sequence;  ///< the drive, scene or sequence, by its name in the data set
  int index = 0;         ///< the frame's number in it, as the data set counts
  double time = 0;       ///< s, of the sweep; all frames of a sequence count from one start
  Transform world_from_ego = Transform::Identity();  ///< world: of the sequence, z up (m)
};

/// The cameras used of a set with several.
enum class Cameras {
  first,  ///< the one that the layout names (data/data_set.h), and the labels in its view
  all,    ///< every camera, and the labels that any of them sees
};
constexpr auto words_of(Cameras) {
  return std::to_array<const char*>({"first", "all"});
}

/// A camera after the frame's first.
struct SideCamera {
  std::string name;         ///< "CAM_BACK"
  Calibration calibration;  ///< its pose at its own picture's time
  Lazy<ImageF> image;       ///< scene-linear RGB; read on first use
};

/// Data of a sensor that is neither camera nor LiDAR: an array whose meaning its pass defines
/// (simulation/sensor_abi.h).
struct Measurement {
  std::string name;  ///< "radar"
  Transform sensor_from_ego = Transform::Identity();
  std::array<std::int64_t, 3> shape = {};  ///< of `data`, row-major
  std::vector<float> data = {};
};

/// One moment: the sensors' data, their poses, and the scene's labels and light.
struct Frame {
  std::string id;  ///< "000008"
  ImageF image;    ///< scene-linear RGB
  Sweep sweep;     ///< `velo`
  Calibration calibration;
  std::vector<Label> labels;
  bool labelled = true;  ///< false: not labelled, as opposed to labelled and empty
  Lighting lighting;     ///< known for generated frames (lighting/ID.json), a default for recorded ones
  std::optional<Moment> moment = {};           ///< nullopt: not in the data set
  std::string camera = "camera";               ///< the first camera's name: that of `image` and `calibration`
  std::vector<SideCamera> others = {};         ///< cameras after it
  std::vector<Measurement> measurements = {};  ///< of sensors that are neither camera nor LiDAR

  // By a camera's index (Label::camera).
  std::size_t cameras() const { return 1 + others.size(); }
  /// The camera's name; 0: the first camera's.
  const std::string& name_of(std::size_t of) const { return of == 0 ? camera : others.at(of - 1).name; }
  /// The camera's calibration.
  const Calibration& calibration_of(std::size_t of) const {
    return of == 0 ? calibration : others.at(of - 1).calibration;
  }
  /// The camera's picture, scene-linear RGB; pictures of `others` are read on first use. InputError if that
  /// fails.
  const ImageF& image_of(std::size_t of) const { return of == 0 ? image : others.at(of - 1).image.get(); }
};

}  // namespace mirage
