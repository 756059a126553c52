#include "scene/kitti_results.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/error.h"
#include "base/files.h"
#include "scene/kitti_rows.h"

namespace mirage {
namespace {

constexpr double kNear = 0.1;  // m before the camera: nearer parts of a box aren't seen
constexpr const char* kNoBox = "-1 -1 -1 -1000 -1000 -1000 -10";
constexpr const char* kColumns[] = {"type",  "truncated", "occluded",   "alpha", "left",   "top",
                                    "right", "bottom",    "height",     "width", "length", "x",
                                    "y",     "z",         "rotation_y", "score"};

}  // namespace

std::optional<PictureBox> projected(const Box3& box, const Calibration& calibration) {
  const auto at = corners(box);
  const PinholeCamera& camera = calibration.camera;
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  PictureBox seen{kInfinity, kInfinity, -kInfinity, -kInfinity};
  const auto join = [&](const Vec3d& p_camera) {
    const Vec2d p = camera.project(p_camera);
    seen = {std::min(seen.left, p.x()), std::min(seen.top, p.y()), std::max(seen.right, p.x()),
            std::max(seen.bottom, p.y())};
  };
  // What is seen is convex: its corners are the box's before the camera and where its edges pass the near
  // plane.
  for (int k = 0; k < 4; ++k)
    for (const auto& [from, to] :
         {std::pair(k, (k + 1) % 4), std::pair(k + 4, (k + 1) % 4 + 4), std::pair(k, k + 4)}) {
      const Vec3d a = calibration.camera_from_velo * at[from], b = calibration.camera_from_velo * at[to];
      for (const Vec3d& end : {a, b})
        if (end.z() >= kNear) join(end);
      if ((a.z() < kNear) != (b.z() < kNear)) join(a + (kNear - a.z()) / (b.z() - a.z()) * (b - a));
    }
  const double right = camera.width - 1, bottom = camera.height - 1;
  if (!(seen.left < right && seen.top < bottom && seen.right > 0 && seen.bottom > 0)) return std::nullopt;
  return PictureBox{std::max(seen.left, 0.0), std::max(seen.top, 0.0), std::min(seen.right, right),
                    std::min(seen.bottom, bottom)};
}

void write_results(const std::filesystem::path& file, std::span<const KittiDetection> found,
                   const Calibration& calibration) {
  std::string text;
  for (const KittiDetection& one : found) {
    const PictureBox in_picture =
        one.picture ? *one.picture
                    : (one.box ? projected(*one.box, calibration) : std::nullopt).value_or(PictureBox{});
    const std::optional<RectBox> box =
        one.box ? std::optional(rect_box(*one.box, calibration)) : std::nullopt;
    text += fmt::format("{} -1 -1 {:.6f} {:.2f} {:.2f} {:.2f} {:.2f} {} {:.12g}\n", one.type,
                        box ? observation_angle(*box) : -10.0, in_picture.left, in_picture.top,
                        in_picture.right, in_picture.bottom, box ? to_row(*box) : kNoBox, one.score);
  }
  write_file(file, text);
}

std::vector<KittiDetection> read_results(const std::filesystem::path& file, const Calibration& calibration) {
  const std::string text = read_file(file);
  std::vector<KittiDetection> found;
  int row = 0;
  for (std::string_view rest = text; !rest.empty();) {
    ++row;
    const auto end = std::min(rest.find('\n'), rest.size());
    const auto words = split(rest.substr(0, end), " \t\r");
    rest.remove_prefix(std::min(end + 1, rest.size()));
    if (words.empty()) continue;
    if (words.size() != 15 && words.size() != 16)
      throw InputError(file.string(), fmt::format("row {}", row),
                       fmt::format("{} columns where 16 belong", words.size()),
                       "write the rows that KITTI's development kit asks for");
    double value[16] = {};
    value[15] = 1;
    const auto field = [&](int column) { return fmt::format("row {}, {}", row, kColumns[column]); };
    for (std::size_t i = 1; i < words.size(); ++i)
      value[i] = to_number(words[i], file, field(static_cast<int>(i)));
    if (words[0] == "DontCare") continue;
    const auto demand = [&](bool good, int column, const char* problem) {
      if (!good)
        throw InputError(file.string(), field(column), fmt::format("{} {}", words[column], problem),
                         "correct the row or delete it");
    };
    KittiDetection one;
    one.type = words[0];
    one.score = value[15];
    if (value[6] > value[4] && value[7] > value[5]) one.picture = {value[4], value[5], value[6], value[7]};
    const bool left_out = value[8] <= 0 && value[9] <= 0 && value[10] <= 0;
    if (!left_out) {
      for (int i = 8; i < 11; ++i) demand(value[i] > 0 && value[i] <= 50, i, "m is no size of a road user");
      for (int i = 11; i < 14; ++i) demand(std::abs(value[i]) <= 1000, i, "m is further than 1 km away");
      one.box =
          velo_box({value[8], value[9], value[10], value[11], value[12], value[13], value[14]}, calibration);
    }
    demand(one.box || one.picture, 8, "is no size, and the 2-D box is empty");
    found.push_back(one);
  }
  return found;
}

}  // namespace mirage
