// Rig files: [camera] here, [lidar] in sensors/lidar_model.
#include <fmt/format.h>

#include <Eigen/LU>
#include <string>

#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/toml_write.h"
#include "generator/generator.h"

namespace mirage {
Rig read_rig(const std::filesystem::path& file) {
  ConfigTable root = ConfigTable::read(file);
  ConfigTable table = root.table("camera");
  root.skip("lidar");
  Rig rig;
  if (root.has("look")) rig.look = parse_look(root.text("look"), file.string(), "look");
  root.check_all_known();
  rig.name = file.stem().string();
  PinholeCamera& camera = rig.calibration.camera;
  camera.width = static_cast<int>(table.number("width", 1, 16384));
  camera.height = static_cast<int>(table.number("height", 1, 16384));
  if (static_cast<std::uint64_t>(camera.width) * static_cast<std::uint64_t>(camera.height) > kMostPixels)
    throw InputError(file.string(), "camera.width, camera.height",
                     fmt::format("{}×{} are more than {} pixels", camera.width, camera.height, kMostPixels),
                     "give a smaller picture");
  camera.fx = table.number("fx", 1, 1e5);
  camera.fy = table.number("fy", 1, 1e5);
  camera.cx = table.number("cx", 0, camera.width - 1);
  camera.cy = table.number("cy", 0, camera.height - 1);
  const auto pose = table.numbers("camera_from_velo", 12, -100, 100);
  for (int i = 0; i < 12; ++i) rig.calibration.camera_from_velo.matrix()(i / 4, i % 4) = pose[i];
  table.check_all_known();
  const Eigen::Matrix3d r = rig.calibration.camera_from_velo.linear();
  if ((r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-3 || r.determinant() < 0)
    throw InputError(file.string(), "camera.camera_from_velo", "its 3x3 part is not a rotation",
                     "give an orthonormal, right-handed matrix [R | t], row by row");
  rig.lidar = read_lidar_model(file);
  rig.text = read_text(file, kLargestToml);
  nlohmann::json whole = read_toml(file);
  if (const nlohmann::json unit = lidar_table(file); whole["lidar"] != unit) {
    whole["lidar"] = unit;
    rig.text = toml_text(whole);
  }
  return rig;
}

Rig with_look(Rig rig, Look look) {
  if (rig.look == look) return rig;
  rig.look = look;
  nlohmann::json whole = parse_toml(rig.text, rig.name);
  whole["look"] = name_of(look);
  rig.text = toml_text(whole);
  return rig;
}

Rig with_lidar(Rig rig, const std::string& unit) {
  const std::filesystem::path file = lidar_file(unit);
  const double height = rig.lidar.height;
  rig.lidar = read_lidar_model(file);
  rig.lidar.height = height;
  rig.name = fmt::format("{}+{}", rig.name, file.stem().string());
  nlohmann::json whole = parse_toml(rig.text, rig.name);
  whole["lidar"] = lidar_table(file);
  whole["lidar"]["height"] = height;
  rig.text = toml_text(whole);
  return rig;
}

}  // namespace mirage
