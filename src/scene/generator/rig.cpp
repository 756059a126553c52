// Rig files: [camera] here, [lidar] in sensors/lidar_model.
#include <cmath>

#include "base/config.h"
#include "base/error.h"
#include "scene/generator.h"

namespace mirage {

Rig read_rig(const std::filesystem::path& file) {
  ConfigTable root = ConfigTable::read(file);
  ConfigTable table = root.table("camera");
  root.skip("lidar");
  Rig rig;
  rig.name = file.stem().string();
  PinholeCamera& camera = rig.calibration.camera;
  camera.width = static_cast<int>(std::lround(table.number("width", 1, 16384)));
  camera.height = static_cast<int>(std::lround(table.number("height", 1, 16384)));
  camera.fx = table.number("fx", 1, 1e6);
  camera.fy = table.number("fy", 1, 1e6);
  camera.cx = table.number("cx", -1e5, 1e5);
  camera.cy = table.number("cy", -1e5, 1e5);
  const std::vector<double> pose = table.numbers("camera_from_velo", 12, -1000, 1000);
  table.check_all_known();
  root.check_all_known();
  Eigen::Matrix3d r;
  Vec3d t;
  for (int i = 0; i < 12; ++i) (i % 4 < 3 ? r(i / 4, i % 4) : t(i / 4)) = pose[i];
  if ((r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-4 || r.determinant() < 0)
    throw InputError(file.string(), "camera.camera_from_velo", "its left 3 x 3 part is not a rotation",
                     "write [R | t] row by row with R orthonormal and right-handed");
  rig.calibration.camera_from_velo.linear() = r;
  rig.calibration.camera_from_velo.translation() = t;
  rig.lidar = read_lidar_model(file);
  return rig;
}

}  // namespace mirage
