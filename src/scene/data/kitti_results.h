// Detections in the format that KITTI's object benchmark takes them in (Geiger et al., CVPR 2012): a file
// ID.txt for each frame, a row for each detection,
//     type -1 -1 alpha left top right bottom height width length x y z rotation_y score
// with the box in `rect` as in a label. Detectors of the picture alone leave the box out: its sizes are -1,
// its place -1000, its angles -10.
#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "geometry/box.h"
#include "scene/frame.h"

namespace mirage {

/// A row of a KITTI result file: a box in space, in the picture, or both.
struct KittiDetection {
  std::string type = "Car";
  std::optional<Box3> box = {};            ///< in `velo`
  std::optional<PictureBox> picture = {};  ///< pixels
  double score = 0;                        ///< the higher the surer
};

/// The smallest box in the picture that holds what the camera sees of the upright box; none if that is
/// nothing.
std::optional<PictureBox> projected(const Box3& box, const Calibration& calibration);
/// The share of the box's extent in the picture's plane that the picture's frame cuts off.
double cut_off_share(const Box3& box, const Calibration& calibration);

/// Writes a frame's detections, atomically; a file without rows for none. The 2-D box is `picture`, else
/// projected(), else 0 0 0 0.
void write_results(const std::filesystem::path& file, std::span<const KittiDetection> detections,
                   const Calibration& calibration);

/// Reads results of any detector: rows of 16 columns (15, a label's, have score 1), of which DontCare is left
/// out. A 2-D box may pass the image's edges. InputError naming file, row and column for what is no finite
/// number, for a size ≤ 0 or > 50 m or a place beyond 1 km (but for the -1 and -1000 of a box that is left
/// out), and for a row with neither box.
std::vector<KittiDetection> read_results(const std::filesystem::path& file, const Calibration& calibration);

}  // namespace mirage
