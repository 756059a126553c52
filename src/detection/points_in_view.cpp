#include "detection/points_in_view.h"

namespace mirage {

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
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 4; ++c) values[4 * r + c] = matrix(r, c);
  return values;
}

}  // namespace mirage
