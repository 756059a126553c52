// What labels and results of KITTI share (kitti_text.cpp, kitti_results.cpp): rows, numbers, and a box's
// seven of them.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "scene/frame.h"

namespace mirage {

/// The parts between any of `separators`; none is empty.
std::vector<std::string_view> split(std::string_view text, std::string_view separators);
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
/// "h w l x y z ry" to a micrometre and a microradian.
std::string to_row(const RectBox& box);

/// What the errors of a file of rows say.
struct RowAdvice {
  const char* columns;      ///< how many belong into a row
  const char* fix_columns;  ///< of a row with another number of them
  const char* fix_value;    ///< of a value that cannot be
};
/// A row of a label or result file.
struct KittiRow {
  const std::filesystem::path& file;
  const RowAdvice& advice;
  int number;  ///< from 1
  const std::vector<std::string_view>& words;
  /// By column: left, top, right, bottom are 4 to 7, the box's seven numbers 8 to 14; the score, 15, is 1
  /// where the row has none. 0, the type, is a word.
  std::array<double, 16> value = {};

  /// InputError naming file, row and column, and the word there, unless `good`.
  void demand(bool good, int column, const std::string& problem) const;
  /// The row's box. InputError for a size or a place that no road user has.
  Box3 box(const Calibration& calibration) const;
};
/// Visits the rows that are not empty. InputError, at its row, for a number of columns that is neither 15 nor
/// 16 and for what is no finite number.
void for_each_row(const std::filesystem::path& file, const RowAdvice& advice,
                  const std::function<void(const KittiRow&)>& visit);

}  // namespace mirage
