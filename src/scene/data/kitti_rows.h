// What the text files of KITTI's layouts share (kitti.cpp, kitti_drives.cpp): rows, numbers, matrices, and a
// box's seven numbers.
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

/// Bytes of the largest file of each kind that is read: a frame's small texts (calibration, identities,
/// light), labels (a sequence's or a drive's too) and a sweep. Those on record have a tenth of that at most.
inline constexpr std::uintmax_t kMaxTextBytes = 1 << 20, kMaxLabelBytes = 1 << 24, kMaxSweepBytes = 1 << 28;

/// A word of the file in a message: a damaged file may have no blanks.
std::string_view shown(std::string_view word);
/// InputError naming file and field for what is no finite number.
double to_number(std::string_view text, const std::filesystem::path& file, const std::string& field);

/// A box as KITTI's rows have it: (x, y, z) is the bottom centre in `rect` (m), the heading there is
/// (cos ry, 0, −sin ry).
struct RectBox {
  double height = 0, width = 0, length = 0, x = 0, y = 0, z = 0, ry = 0;
};
/// The upright box in `velo`: same bottom centre and sizes, the heading laid flat (kitti.h).
Box3 velo_box(const RectBox& box, const Calibration& calibration);
/// The exact inverse.
RectBox rect_box(const Box3& box, const Calibration& calibration);
/// The observation angle ry − atan2(x, z), in [−π, π].
double observation_angle(const RectBox& box);
/// The seven numbers of a row whose box is of the picture alone.
inline constexpr const char* kNoBox = "-1 -1 -1 -1000 -1000 -1000 -10";
/// "h w l x y z ry" to a micrometre and a microradian.
std::string to_row(const RectBox& box);

/// What the errors of a file of rows say.
struct RowAdvice {
  const char* columns;      ///< how many belong into a row
  const char* fix_columns;  ///< of a row with another number of them
  const char* fix_value;    ///< of a value that cannot be
  std::size_t before = 0;   ///< numbers before the type: frame and identity in the tracking benchmark
};
/// A row of a label or result file.
struct KittiRow {
  const std::filesystem::path& file;
  const RowAdvice& advice;
  int number;                      ///< from 1
  std::span<const double> before;  ///< the numbers before the type
  std::span<const std::string_view> words;
  /// By column: left, top, right, bottom are 4 to 7, the box's seven numbers 8 to 14; the score, 15, is 1
  /// where the row has none. 0, the type, is a word.
  std::array<double, 16> value = {};

  /// InputError naming file, row and column, and the word there, unless `good`.
  void demand(bool good, int column, const std::string& problem) const;
  /// Whether the row says nothing of the box in space: sizes of 0 or -1.
  bool leaves_box_out() const { return value[8] <= 0 && value[9] <= 0 && value[10] <= 0; }
  /// The row's box. InputError for a size or a place that no road user has.
  Box3 box(const Calibration& calibration) const;
};
/// Visits the rows that are not empty. InputError, at its row, for a number of columns that is neither 15 nor
/// 16 (and those before) and for what is no finite number.
void for_each_row(const std::filesystem::path& file, const RowAdvice& advice,
                  const std::function<void(const KittiRow&)>& visit);
/// The row as a label of the object benchmark, of its KITTI type. A box in the picture that
/// passes its edge is clipped, one that is missing (of no size) or lies beside the picture is projected from
/// the box in space; `notes` counts both. Zeros or -1 for the sizes: labelled in the picture alone.
/// InputError, at row and column, for what no label can be.
Label label_of(const KittiRow& row, const Calibration& calibration, LabelNotes& notes);
/// Adds the row's label to those of its frame. InputError, at the row, where one of these stands in its
/// place.
void add_label(const KittiRow& row, Label label, std::vector<Label>& labels);

/// A row of a calibration file, and where it stands.
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
  /// By the first of its names that the file has: the benchmarks call the same row R0_rect and R_rect.
  /// InputError if it is missing, stands twice (as the names say, or otherwise), does not hold `count` words
  /// or one of them is no finite number.
  MatrixRow row(std::initializer_list<const char*> names, std::size_t count) const;

 private:
  using Words = std::vector<std::string_view>;
  std::filesystem::path file_;
  std::string text_;
  std::map<std::string, std::vector<Words>, std::less<>> rows_;  ///< each as often as it stands there
};
/// A rigid transform of 12 numbers. InputError if its turning part is further than 1e-3 from a rotation, or
/// it moves by more than 20 m.
Transform rigid(const MatrixRow& row);
/// From a projection (12 numbers), the rectifying rotation (9) and the LiDAR's pose in the reference camera
/// (12); `width`, `height`: the picture's. Errors as read_calibration's (kitti.h).
Calibration calibration_of(const MatrixRow& projection, const MatrixRow& rectification, const MatrixRow& pose,
                           int width, int height);

// Detections in the format that KITTI's object benchmark takes them in (Geiger et al., CVPR 2012): a file
// ID.txt for each frame, a row for each detection,
//     type -1 -1 alpha left top right bottom height width length x y z rotation_y score
// with the box in `rect` as in a label. Detectors of the picture alone leave the box out: its sizes are -1,
// its place -1000, its angles -10.

/// A row of a KITTI result file: a box in space, in the picture, or both.
struct KittiDetection {
  std::string type = "Car";
  std::optional<Box3> box = {};            ///< in `velo`
  std::optional<PictureBox> picture = {};  ///< pixels
  double score = 0;                        ///< the higher the surer
  std::string camera = {};  ///< whose picture (Frame::name_of); empty: the first, which the files have alone
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
