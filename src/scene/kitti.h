// KITTI object-benchmark layout (Geiger et al., CVPR 2012): DIR/training/{image_2,velodyne,calib,label_2}.
// Generated data sets add training/lighting/ID.json (the Lighting of the frame) and dataset.json. Where it is
// known which boxes show the same vehicle, training/track_2/ID.txt says so: a line for each line of
// label_2/ID.txt, the vehicle's number, or -1 where it is unknown.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "scene/frame.h"

namespace mirage {

/// Ids of the frames that have a sweep, sorted. InputError if the folder is missing or holds none.
std::vector<std::string> list_frames(const std::filesystem::path& data);

/// Reads one frame whole, with its labels' identities where training/track_2 has the frame. InputError,
/// naming file, field and fix, for: a missing file; a sweep whose size is not a multiple of 16 bytes or that
/// holds non-finite values; a missing or short calibration row; an image whose size contradicts the
/// calibration (principal point outside); a label with too few columns, non-finite or absurd numbers
/// (|position| > 1 km, size ≤ 0 or > 50 m), or a 2-D box beyond the image; another number of identities than
/// of labels.
Frame read_frame(const std::filesystem::path& data, const std::string& id);

/// Tells whether a frame is the same as before: content_hash over the bytes of its sweep, image, calibration
/// and labels (not of its lighting, nor of its labels' identities). InputError for a missing file.
std::string frame_hash(const std::filesystem::path& data, const std::string& id);

/// Writes the frame's files (atomically, each); track_2 if a label has an identity. Labels' 2-D boxes,
/// truncation and occlusion are written as they are. The image is encoded to 8-bit sRGB.
void write_frame(const std::filesystem::path& data, const Frame& frame);

/// KITTI's .bin: four floats a point. InputError naming file and byte: it can't be read, is empty or cut off,
/// or a point is not finite or farther than 1 km.
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
/// (the two frames' verticals differ by about 1°, which upright boxes can't express).
std::vector<Label> read_labels(const std::filesystem::path& file, const Calibration& calibration);
/// The exact inverse; alpha = ry − atan2(x, z).
void write_labels(const std::filesystem::path& file, const std::vector<Label>& labels,
                  const Calibration& calibration);

/// Identities of the frame's labels, in their order: training/track_2/ID.txt. None where there is no such
/// file. InputError for a line that is no whole number, or less than -1.
std::optional<std::vector<int>> read_tracks(const std::filesystem::path& data, const std::string& id);

/// Where generated sets keep a frame's true depth: DIR/training/depth/ID.png (write_depth_png; sky is 0).
std::filesystem::path true_depth_file(const std::filesystem::path& data, const std::string& id);

/// {"to_sun_velo": [x, y, z], "sun": [r, g, b], "ambient": …, "hemisphere": …}
Lighting read_lighting(const std::filesystem::path& file);
/// What read_lighting reads, atomically.
void write_lighting(const std::filesystem::path& file, const Lighting& lighting);

}  // namespace mirage
