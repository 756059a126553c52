// One recorded or generated moment: photograph, sweep, calibration and labels.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "base/image.h"
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

  /// Where labels are kept in KITTI's files.
  Transform rect_from_velo() const { return camera_from_rect.inverse() * camera_from_velo; }
};

/// A ground-truth object, as labelled, with its box in `velo`.
struct Label {
  std::string type;                                 ///< "Car", "Van", …, "DontCare" (data/label_types.h)
  double truncated = 0;                             ///< 0 … 1
  int occluded = 0;                                 ///< 0 fully visible … 3 unknown
  double left = 0, top = 0, right = 0, bottom = 0;  ///< 2-D box, pixels
  Box3 box;                                         ///< in `velo`; meaningless unless has_box()
  int track = -1;                                   ///< the vehicle's identity in the data set; -1: unknown
  bool in_space = true;                             ///< false: labelled in the picture alone
  std::string category = {};                        ///< the class as labelled: "Tram", "vehicle.bus.rigid"
  std::optional<Vec3d> velocity = {};  ///< m/s over ground along the axes of `velo`; none: not known
};

/// Whether it is known where the object stands: not of DontCare regions, nor of labels of the picture alone.
inline bool has_box(const Label& label) {
  return label.in_space && label.type != "DontCare";
}

/// When a frame was taken and where the car stood. The ego frame is `velo`.
struct Moment {
  std::string sequence;  ///< the drive, scene or sequence, by its name in the data set
  int index = 0;         ///< the frame's number there, as the data set counts
  double time = 0;       ///< s, of the sweep; all frames of a sequence count from one start
  Transform world_from_ego = Transform::Identity();  ///< world: of the sequence, z up (m)
};

/// One moment: what both sensors saw, where they stood, and what is known of the scene.
struct Frame {
  std::string id;  ///< "000008"
  ImageF image;    ///< scene-linear RGB
  Sweep sweep;     ///< `velo`
  Calibration calibration;
  std::vector<Label> labels;
  bool labelled = true;  ///< false: nobody has labelled the frame, which is other than that it shows nothing
  Lighting lighting;     ///< known for generated frames (lighting/ID.json), a default for recorded ones
  std::optional<Moment> moment = {};  ///< none: the data set does not say
};

}  // namespace mirage
