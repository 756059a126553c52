// Files of KITTI's object-benchmark layout (Geiger et al., CVPR 2012):
// DIR/training/{image_2,velodyne,calib,label_2}. Generated data sets add training/lighting/ID.json (the
// Lighting of the frame) and dataset.json. The optional training/track_2/ID.txt tells which boxes show the
// same vehicle: for each line of label_2/ID.txt a line with the vehicle's number, or -1 if unknown.
#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/image.h"
#include "scene/data/data_set.h"

namespace mirage {

/// Writes the frame's files (each atomically); track_2 if a label has a track id. Labels' 2-D boxes,
/// truncation and occlusion are written as they are. The image is encoded to 8-bit sRGB.
void write_frame(const std::filesystem::path& data, const Frame& frame);

/// KITTI's .bin: four floats a point. Points that are not finite, or at the origin, are not returns: they are
/// left out, with a warning that counts them, once per process and folder. InputError naming file and byte if
/// it can't be read, is empty or cut off, has a point beyond 1 km or no return, or if the values show another
/// number of floats a point.
Sweep read_sweep(const std::filesystem::path& file);
/// KITTI's .bin, atomically.
void write_sweep(const std::filesystem::path& file, const Sweep& sweep);
/// `width`, `height`: the image's.
///
/// R0_rect and Tr_velo_to_cam are printed with 7 digits; their product is replaced by the nearest rotation.
/// InputError if it is further than 1e-3 from one, or if P2 is not K·[I | t] with an upright K.
Calibration read_calibration(const std::filesystem::path& file, int width, int height);
/// KITTI's calib/ID.txt, 13 digits a number, atomically.
void write_calibration(const std::filesystem::path& file, const Calibration& calibration);

/// A label's (x, y, z) is the bottom centre in `rect`; its heading there is (cos ry, 0, −sin ry). The box in
/// `velo` has the same bottom centre, sizes and the yaw of that heading turned into `velo` and laid flat
/// (the two frames' verticals differ by about 1°, which upright boxes can't express). Types and 2-D boxes:
/// label_of (kitti_rows.h); `notes`, unless null, counts the changed 2-D boxes.
std::vector<Label> read_labels(const std::filesystem::path& file, const Calibration& calibration,
                               LabelNotes* notes = nullptr);
/// The exact inverse; alpha = ry − atan2(x, z).
void write_labels(const std::filesystem::path& file, const std::vector<Label>& labels,
                  const Calibration& calibration);

/// Path of a generated frame's true depth: DIR/training/depth/ID.png (write_depth_png; sky is 0).
std::filesystem::path true_depth_file(const std::filesystem::path& data, const std::string& id);

// A generated frame's truth, besides its labels: the owner of each pixel and each return.

/// The truth that is written for a frame, besides its labels.
enum class Truth {
  none,
  depth,  ///< true_depth_file()
  all     ///< and instance_file(), point_label_file()
};
/// DIR/training/instance_2/ID.png: FrameTruth::instance (write_index_png).
std::filesystem::path instance_file(const std::filesystem::path& data, const std::string& id);
/// InputError if it can't be read or is not of the image's size.
Image<std::uint16_t> read_instances(const std::filesystem::path& data, const std::string& id, int width,
                                    int height);
/// DIR/training/instance_velodyne/ID.label: FrameTruth::returns, little-endian, in the sweep's order
/// (SemanticKITTI's layout).
std::filesystem::path point_label_file(const std::filesystem::path& data, const std::string& id);
/// One word a point of the sweep, little-endian, atomically.
void write_point_labels(const std::filesystem::path& file, const std::vector<std::uint32_t>& labels);
/// InputError if the file can't be read or does not hold `points` words.
std::vector<std::uint32_t> read_point_labels(const std::filesystem::path& file, std::size_t points);

/// DIR/training/lighting/ID.json: the light of a generated frame.
std::filesystem::path lighting_file(const std::filesystem::path& data, const std::string& id);
/// The light in lighting_file(); nullopt if there is no such file.
std::optional<Lighting> generated_lighting(const std::filesystem::path& data, const std::string& id);
/// {"to_sun_velo": [x, y, z], "sun": [r, g, b], "ambient": …, "hemisphere": …}
Lighting read_lighting(const std::filesystem::path& file);
/// The inverse of read_lighting.
nlohmann::json to_json(const Lighting& lighting);

}  // namespace mirage
