#include "scene/data/kitti_results.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/files.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/label_types.h"

namespace mirage {
namespace {

constexpr double kNearCamera = 0.1;  // m before the camera: nearer parts of a box aren't seen

/// The smallest box that holds what of the upright box lies before the camera, within the picture or not.
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
  // What is seen is convex: its corners are the box's before the camera and where its edges pass the near
  // plane.
  for (int k = 0; k < 4; ++k)
    for (const auto& [from, to] :
         {std::pair(k, (k + 1) % 4), std::pair(k + 4, (k + 1) % 4 + 4), std::pair(k, k + 4)}) {
      const Vec3d a = calibration.camera_from_velo * at[from], b = calibration.camera_from_velo * at[to];
      for (const Vec3d& end : {a, b})
        if (end.z() >= kNearCamera) join(end);
      if ((a.z() < kNearCamera) != (b.z() < kNearCamera))
        join(a + (kNearCamera - a.z()) / (b.z() - a.z()) * (b - a));
    }
  return seen;
}

}  // namespace

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
    row.demand(detection.box || detection.picture, 8, "is no size, and the 2-D box is empty");
    detections.push_back(detection);
  });
  return detections;
}

}  // namespace mirage
