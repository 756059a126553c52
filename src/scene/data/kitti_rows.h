// Common parts of the text files of KITTI's layouts (kitti.cpp, kitti_drives.cpp): rows, numbers, matrices,
// and a box's seven numbers.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <initializer_list>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "geometry/box.h"
#include "scene/data/data_set.h"
#include "scene/frame.h"

namespace mirage {

/// Size limits, in bytes, of the files that are read: a frame's small texts (calibration, track ids, light),
/// labels (also of a sequence or a drive) and a sweep. Known files have at most a tenth of that.
inline constexpr std::uintmax_t kMaxTextBytes = 1 << 20, kMaxLabelBytes = 1 << 24, kMaxSweepBytes = 1 << 28;

/// A word of the file, shortened for a message: a damaged file may have no blanks.
std::string_view shown(std::string_view word);
/// Parses a number. InputError naming file and field if it is not a finite number.
double to_number(std::string_view text, const std::filesystem::path& file, const std::string& field);

/// A box as in KITTI's rows: (x, y, z) is the bottom centre in `rect` (m), the heading there is (cos ry, 0,
/// −sin ry).
struct RectBox {
  double height = 0, width = 0, length = 0, x = 0, y = 0, z = 0, ry = 0;
};
/// The upright box in `velo`: same bottom centre and sizes, the heading laid flat (kitti.h).
Box3 velo_box(const RectBox& box, const Calibration& calibration);
/// The exact inverse.
RectBox rect_box(const Box3& box, const Calibration& calibration);
/// The observation angle ry − atan2(x, z), in [−π, π].
double observation_angle(const RectBox& box);
/// The seven numbers of a row that has a 2-D box only.
inline constexpr const char* kNoBox = "-1 -1 -1 -1000 -1000 -1000 -10";
/// "h w l x y z ry" to a micrometre and a microradian.
std::string to_row(const RectBox& box);

/// Texts for the errors of a file of rows.
struct RowAdvice {
  const char* columns;      ///< the expected number of columns
  const char* fix_columns;  ///< for a row with another number of columns
  const char* fix_value;    ///< for an impossible value
  std::size_t before = 0;   ///< numbers before the type: frame and track id in the tracking benchmark
};
/// A row of a label or result file.
struct KittiRow {
  const std::filesystem::path& file;
  const RowAdvice& advice;
  int number;                      ///< from 1
  std::span<const double> before;  ///< the numbers before the type
  std::span<const std::string_view> words;
  /// By column: left, top, right, bottom are 4 to 7, the box's seven numbers 8 to 14; the score, 15, is 1 if
  /// the row has none. Column 0, the type, is a word.
  std::array<double, 16> value = {};

  /// InputError naming file, row, column and word, unless `good`.
  void demand(bool good, int column, const std::string& problem) const;
  /// Whether the row has no 3-D box: sizes of 0 or -1.
  bool leaves_box_out() const { return value[8] <= 0 && value[9] <= 0 && value[10] <= 0; }
  /// The row's 3-D box. InputError for a size or a position that no road user has.
  Box3 box(const Calibration& calibration) const;
};
/// Visits the rows that are not empty. InputError, naming the row, if it has neither 15 nor 16 columns (after
/// RowAdvice::before) or a value that is not a finite number.
void for_each_row(const std::filesystem::path& file, const RowAdvice& advice,
                  const std::function<void(const KittiRow&)>& visit);
/// The row as a label of the object benchmark, of its KITTI type. A 2-D box that passes the picture's edge is
/// clipped; one that is missing (has no size) or lies outside the picture is projected from the 3-D box.
/// `notes` counts both. Sizes of 0 or -1: a label with a 2-D box only. InputError, naming row and column, for
/// an impossible label.
Label label_of(const KittiRow& row, const Calibration& calibration, LabelNotes& notes);
/// Adds the row's label to those of its frame. InputError, naming the row, if one of them has the same centre
/// and heading.
void add_label(const KittiRow& row, Label label, std::vector<Label>& labels);

/// A row of a calibration file, and its file.
struct MatrixRow {
  std::filesystem::path file;
  std::string name;            ///< "P2"
  std::vector<double> values;  ///< row by row
};
/// A calibration file: rows "NAME: numbers"; the tracking benchmark leaves some colons out.
class CalibrationFile {
 public:
  /// Reads the rows. InputError naming the file if it cannot be read or holds more than kMaxTextBytes bytes.
  explicit CalibrationFile(std::filesystem::path file);
  /// The row with the first of these names that the file has: the benchmarks call the same row R0_rect and
  /// R_rect. InputError if it is missing, occurs twice, or does not hold `count` finite numbers.
  MatrixRow row(std::initializer_list<const char*> names, std::size_t count) const;

 private:
  using Words = std::vector<std::string_view>;
  std::filesystem::path file_;
  std::string text_;
  std::map<std::string, std::vector<Words>, std::less<>> rows_;  ///< all rows of each name
};
/// A rigid transform of 12 numbers. InputError if its linear part is further than 1e-3 from a rotation, or
/// its translation is longer than 20 m.
Transform rigid(const MatrixRow& row);
/// From a projection (12 numbers), the rectifying rotation (9) and the LiDAR's pose in the reference camera
/// (12); `width`, `height`: the picture's. Errors as read_calibration's (kitti.h).
Calibration calibration_of(const MatrixRow& projection, const MatrixRow& rectification, const MatrixRow& pose,
                           int width, int height);

// Detections in the result format of KITTI's object benchmark (Geiger et al., CVPR 2012): a file ID.txt for
// each frame, a row for each detection,
//     type -1 -1 alpha left top right bottom height width length x y z rotation_y score
// with the box in `rect` as in a label. Picture detectors omit the 3-D box: its sizes are -1, its position
// -1000, its angles -10.

/// A row of a KITTI result file: a 3-D box, a 2-D box, or both.
struct KittiDetection {
  std::string type = "Car";
  std::optional<Box3> box = {};            ///< in `velo`
  std::optional<PictureBox> picture = {};  ///< pixels
  double score = 0;                        ///< higher is more confident
  std::string camera = {};  ///< name (Frame::name_of); empty: the first, the only one in the files
};

/// The smallest 2-D box, within the picture, around the visible part of the 3-D box; nullopt if the camera
/// sees nothing of it.
std::optional<PictureBox> projected(const Box3& box, const Calibration& calibration);
/// The share of the box's extent in the image plane that lies outside the picture.
double cut_off_share(const Box3& box, const Calibration& calibration);

/// Writes a frame's detections, atomically; an empty file if there are none. The 2-D box is `picture`,
/// otherwise projected(), otherwise 0 0 0 0.
void write_results(const std::filesystem::path& file, std::span<const KittiDetection> detections,
                   const Calibration& calibration);

/// Reads results of any detector: rows of 16 columns (15, as a label's, have score 1); skips DontCare. A 2-D
/// box may pass the image's edges. InputError naming file, row and column for a value that is not a finite
/// number, for a size ≤ 0 or > 50 m or a position beyond 1 km (except the -1 and -1000 of an omitted box),
/// and for a row with neither box.
std::vector<KittiDetection> read_results(const std::filesystem::path& file, const Calibration& calibration);

}  // namespace mirage
