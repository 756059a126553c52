// What labels and results of KITTI share (kitti_text.cpp, kitti_results.cpp): words, numbers, and a box's
// seven of them.
#pragma once

#include <filesystem>
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

}  // namespace mirage
