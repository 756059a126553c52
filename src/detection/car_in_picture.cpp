#include "detection/car_in_picture.h"

#include "base/intervals.h"

namespace mirage {
namespace {

constexpr std::size_t kGroundReturns = 15, kBodyReturns = 20;
constexpr double kRoad = 0.3;                    // m over the bottom: lower returns may be the road's
constexpr double kLowest = 1.2, kHighest = 2.2;  // m: other heights are not a car's
constexpr double kOverhead = 4;                  // m over the bottom: higher returns hang over the car

/// m under the median of a car's surroundings: lower returns came through a mirror (KITTI has some at -25 m).
constexpr double kMirrored = 5;

/// z of the returns over the box grown by `margin`.
std::vector<double> heights(const BevBox& box, std::span<const LidarPoint> sweep, double margin) {
  const double c = std::cos(box.yaw), s = std::sin(box.yaw);
  std::vector<double> z_values;
  for (const LidarPoint& p : sweep) {
    const double dx = p.x - box.x, dy = p.y - box.y;
    if (std::abs(c * dx + s * dy) <= box.length / 2 + margin &&
        std::abs(c * dy - s * dx) <= box.width / 2 + margin)
      z_values.push_back(p.z);
  }
  return z_values;
}

}  // namespace

Box3 upright(const ObjectBoxes& found, std::span<const LidarPoint> sweep) {
  if (found.box.height > 0) return found.box;
  const BevBox& box = found.box.bev;
  Box3 result{box, 0, kNominalHeight};
  std::vector<double> around;
  for (const double margin : {0.5, 1.5, 3.0, 6.0})
    if (around = heights(box, sweep, margin); around.size() >= kGroundReturns) break;
  if (around.empty())
    for (const LidarPoint& p : sweep) around.push_back(p.z);
  if (around.empty()) return result;
  const double median = quantile(around, 0.5);
  std::erase_if(around, [&](double z) { return z < median - kMirrored; });
  result.bottom = quantile(around, 0.05);
  std::vector<double> body = heights(box, sweep, 0);
  std::erase_if(body, [&](double z) { return z < result.bottom + kRoad || z > result.bottom + kOverhead; });
  if (body.size() < kBodyReturns) return result;
  const double height = quantile(body, 0.98) - result.bottom;
  if (height >= kLowest && height <= kHighest) result.height = height;
  return result;
}

std::vector<LidarPoint> points_in_view(const Sweep& sweep, const Calibration& calibration) {
  constexpr double nearest = 0.5;  // m in front of the camera
  const PinholeCamera& camera = calibration.camera;
  std::vector<LidarPoint> seen;
  for (const LidarPoint& point : sweep) {
    const Vec3d p_camera = calibration.camera_from_velo * point.position().cast<double>();
    if (!(p_camera.z() > nearest)) continue;
    const Vec2d pixel = camera.project(p_camera);
    if (pixel.x() >= -0.5 && pixel.x() < camera.width - 0.5 && pixel.y() >= -0.5 &&
        pixel.y() < camera.height - 0.5)
      seen.push_back(point);
  }
  return seen;
}

std::array<double, 12> pixel_from_velo(const Calibration& calibration) {
  const PinholeCamera& camera = calibration.camera;
  Eigen::Matrix3d intrinsics;
  intrinsics << camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1;
  const Eigen::Matrix<double, 3, 4> matrix = intrinsics * calibration.camera_from_velo.matrix().topRows<3>();
  std::array<double, 12> values{};
  Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(values.data()) = matrix;
  return values;
}

}  // namespace mirage
