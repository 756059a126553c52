#include "scene/data/kitti_rows.h"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "base/error.h"
#include "base/files.h"
#include "base/names.h"
#include "base/sizes.h"
#include "base/types.h"

namespace mirage {
namespace {

/// velo's (x, y) components of a heading (cos ry, 0, −sin ry) in `rect`, as a matrix on (cos ry, sin ry).
Eigen::Matrix2d flat_heading(const Transform& rect_from_velo) {
  const Eigen::Matrix3d velo_from_rect = rect_from_velo.linear().transpose();
  Eigen::Matrix2d matrix;
  matrix.col(0) = velo_from_rect.col(0).head<2>();
  matrix.col(1) = -velo_from_rect.col(2).head<2>();
  return matrix;
}

/// "row 3, left".
std::string place(int row, int column) {
  static constexpr const char* kColumns[] = {"type",  "truncated", "occluded",   "alpha", "left",   "top",
                                             "right", "bottom",    "height",     "width", "length", "x",
                                             "y",     "z",         "rotation_y", "score"};
  return fmt::format("row {}, {}", row, kColumns[column]);
}

constexpr double kNearCamera = 0.1;  // m in front of the camera: nearer parts of a box aren't seen

/// The smallest 2-D box around the part of the 3-D box in front of the camera, not clipped to the picture.
PictureBox extent(const Box3& box, const Calibration& calibration) {
  const auto at = corners(box);
  const PinholeCamera& camera = calibration.camera;
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  PictureBox seen{kInfinity, kInfinity, -kInfinity, -kInfinity};
  const auto join = [&](const Vec3d& p_camera) {
    const Vec2d p = camera.project(p_camera);
    seen = {std::min(seen.left, p.x()), std::min(seen.top, p.y()), std::max(seen.right, p.x()),
            std::max(seen.bottom, p.y())};
  };
  // The visible part is convex: its corners are the box's corners in front of the camera and its edges'
  // crossings of the near plane.
  for (int k = 0; k < 4; ++k)
    for (const auto& [from, to] :
         {std::pair(k, (k + 1) % 4), std::pair(k + 4, (k + 1) % 4 + 4), std::pair(k, k + 4)}) {
      const Vec3d a = calibration.camera_from_velo * at[as_size(from)],
                  b = calibration.camera_from_velo * at[as_size(to)];
      for (const Vec3d& end : {a, b})
        if (end.z() >= kNearCamera) join(end);
      if ((a.z() < kNearCamera) != (b.z() < kNearCamera))
        join(a + (kNearCamera - a.z()) / (b.z() - a.z()) * (b - a));
    }
  return seen;
}

}  // namespace

std::string_view shown(std::string_view word) {
  return word.substr(0, 40);
}

double to_number(std::string_view text, const std::filesystem::path& file, const std::string& field) {
  const auto value = try_parse_number<double>(text, true);
  if (!value)
    throw InputError(file.string(), field, fmt::format("'{}' is not a number", shown(text)),
                     "correct the row");
  if (!std::isfinite(*value))
    throw InputError(file.string(), field, fmt::format("'{}' is not finite", shown(text)), "correct the row");
  return *value;
}

Box3 velo_box(const RectBox& box, const Calibration& calibration) {
  const Transform rect_from_velo = calibration.rect_from_velo();
  const Vec3d bottom = rect_from_velo.inverse() * Vec3d(box.x, box.y, box.z);
  const Vec2d along = flat_heading(rect_from_velo) * Vec2d(std::cos(box.ry), std::sin(box.ry));
  return {{bottom.x(), bottom.y(), box.length, box.width, std::atan2(along.y(), along.x())},
          bottom.z(),
          box.height};
}

RectBox rect_box(const Box3& box, const Calibration& calibration) {
  const Transform rect_from_velo = calibration.rect_from_velo();
  const BevBox& bev = box.bev;
  const Vec3d p = rect_from_velo * Vec3d(bev.x, bev.y, box.bottom);
  const Vec2d along = flat_heading(rect_from_velo).inverse() * Vec2d(std::cos(bev.yaw), std::sin(bev.yaw));
  return {box.height, bev.width, bev.length, p.x(), p.y(), p.z(), std::atan2(along.y(), along.x())};
}

double observation_angle(const RectBox& box) {
  return wrap_angle(box.ry - std::atan2(box.x, box.z));
}

std::string to_row(const RectBox& box) {
  return fmt::format("{:.6f} {:.6f} {:.6f} {:.6f} {:.6f} {:.6f} {:.6f}", box.height, box.width, box.length,
                     box.x, box.y, box.z, box.ry);
}

void KittiRow::demand(bool good, int column, const std::string& problem) const {
  if (!good)
    throw InputError(file.string(), place(number, column),
                     fmt::format("{} {}", shown(words[as_size(column)]), problem), advice.fix_value);
}

Box3 KittiRow::box(const Calibration& calibration) const {
  for (int i = 8; i < 11; ++i)
    demand(value[as_size(i)] > 0 && value[as_size(i)] <= 50, i, "m is not the size of a road user");
  for (int i = 11; i < 14; ++i) demand(std::abs(value[as_size(i)]) <= 1000, i, "m is further than 1 km away");
  return velo_box({value[8], value[9], value[10], value[11], value[12], value[13], value[14]}, calibration);
}

void for_each_row(const std::filesystem::path& file, const RowAdvice& advice,
                  const std::function<void(const KittiRow&)>& visit) {
  const std::string text = read_text(file, kMaxLabelBytes);
  int number = 0;
  for (std::string_view rest = text; !rest.empty();) {
    ++number;
    const auto end = std::min(rest.find('\n'), rest.size());
    const auto words = split(rest.substr(0, end), " \t\r");
    rest.remove_prefix(std::min(end + 1, rest.size()));
    if (words.empty()) continue;
    if (words.size() != advice.before + 15 && words.size() != advice.before + 16)
      throw InputError(file.string(), fmt::format("row {}", number),
                       fmt::format("{} columns where {} belong", words.size(), advice.columns),
                       advice.fix_columns);
    std::vector<double> before;
    for (std::size_t i = 0; i < advice.before; ++i)
      before.push_back(to_number(words[i], file, fmt::format("row {}, column {}", number, i + 1)));
    KittiRow row{file, advice, number, before, std::span(words).subspan(advice.before)};
    row.value[15] = 1;
    for (std::size_t i = 1; i < row.words.size(); ++i)
      row.value[i] = to_number(row.words[i], file, place(number, static_cast<int>(i)));
    visit(row);
  }
}

std::optional<PictureBox> projected(const Box3& box, const Calibration& calibration) {
  const PictureBox seen = extent(box, calibration);
  const double right = calibration.camera.width - 1, bottom = calibration.camera.height - 1;
  if (!(seen.left < right && seen.top < bottom && seen.right > 0 && seen.bottom > 0)) return std::nullopt;
  return PictureBox{std::max(seen.left, 0.0), std::max(seen.top, 0.0), std::min(seen.right, right),
                    std::min(seen.bottom, bottom)};
}

double cut_off_share(const Box3& box, const Calibration& calibration) {
  const auto seen = projected(box, calibration);
  return seen ? std::clamp(1 - area(*seen) / area(extent(box, calibration)), 0.0, 1.0) : 1;
}

void write_results(const std::filesystem::path& file, std::span<const KittiDetection> detections,
                   const Calibration& calibration) {
  std::string text;
  for (const KittiDetection& detection : detections) {
    const PictureBox in_picture =
        detection.picture
            ? *detection.picture
            : (detection.box ? projected(*detection.box, calibration) : std::nullopt).value_or(PictureBox{});
    const std::optional<RectBox> box =
        detection.box ? std::optional(rect_box(*detection.box, calibration)) : std::nullopt;
    text += fmt::format("{} -1 -1 {:.6f} {:.2f} {:.2f} {:.2f} {:.2f} {} {:.12g}\n", detection.type,
                        box ? observation_angle(*box) : -10.0, in_picture.left, in_picture.top,
                        in_picture.right, in_picture.bottom, box ? to_row(*box) : kNoBox, detection.score);
  }
  write_file(file, text);
}

std::vector<KittiDetection> read_results(const std::filesystem::path& file, const Calibration& calibration) {
  constexpr RowAdvice kAdvice{"16", "write the rows that KITTI's development kit asks for",
                              "correct the row or delete it"};
  std::vector<KittiDetection> detections;
  for_each_row(file, kAdvice, [&](const KittiRow& row) {
    const auto& value = row.value;
    KittiDetection detection;
    detection.type = kitti_type(row.words[0]);
    if (detection.type == "DontCare") return;
    detection.score = value[15];
    if (value[6] > value[4] && value[7] > value[5])
      detection.picture = {value[4], value[5], value[6], value[7]};
    if (!row.leaves_box_out()) detection.box = row.box(calibration);
    row.demand(detection.box || detection.picture, 8, "is not a size, and the 2-D box is empty");
    detections.push_back(detection);
  });
  return detections;
}

}  // namespace mirage
