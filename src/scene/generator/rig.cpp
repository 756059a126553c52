// Rig files: [camera] here, [lidar] in sensors/lidar_model.
#include <toml++/toml.h>

#include <cmath>
#include <set>
#include <string>

#include "base/error.h"
#include "base/files.h"
#include "scene/generator.h"

namespace mirage {
namespace {

const std::set<std::string, std::less<>> kCameraKeys = {"width", "height",          "fx", "fy", "cx",
                                                        "cy",    "camera_from_velo"};

double number(const toml::table& table, const std::string& file, const std::string& key) {
  const auto value = table[key].value<double>();
  if (!value || !std::isfinite(*value))
    throw InputError(file, "camera." + key, "not a number", "give a finite number");
  return *value;
}

}  // namespace

Rig read_rig(const std::filesystem::path& file) {
  const std::string name = file.string();
  toml::table root;
  try {
    root = toml::parse(read_file(file));
  } catch (const toml::parse_error& error) {
    throw InputError(name, "line " + std::to_string(error.source().begin.line),
                     std::string(error.description()), "correct the TOML syntax");
  }
  const toml::table* camera = root["camera"].as_table();
  if (!camera)
    throw InputError(name, "camera", "table missing", "add [camera] with width, height, fx, fy, cx, cy");
  for (const auto& [key, value] : *camera)
    if (!kCameraKeys.contains(key.str()))
      throw InputError(name, "camera." + std::string(key.str()), "unknown key",
                       "remove it or correct its name");
  Rig rig;
  rig.name = file.stem().string();
  PinholeCamera& c = rig.calibration.camera;
  c.width = static_cast<int>(number(*camera, name, "width"));
  c.height = static_cast<int>(number(*camera, name, "height"));
  c.fx = number(*camera, name, "fx");
  c.fy = number(*camera, name, "fy");
  c.cx = number(*camera, name, "cx");
  c.cy = number(*camera, name, "cy");
  if (c.width < 1 || c.height < 1 || c.width > 16384 || c.height > 16384)
    throw InputError(name, "camera.width, camera.height", "not an image's size",
                     "give pixels between 1 and 16384");
  if (c.fx <= 0 || c.fy <= 0)
    throw InputError(name, "camera.fx, camera.fy", "not positive", "give the focal length in pixels");
  const toml::array* pose = (*camera)["camera_from_velo"].as_array();
  if (!pose || pose->size() != 12)
    throw InputError(name, "camera.camera_from_velo", "not 12 numbers",
                     "give a 3 × 4 matrix [R | t], row by row");
  for (int i = 0; i < 12; ++i) {
    const auto value = (*pose)[i].value<double>();
    if (!value || !std::isfinite(*value))
      throw InputError(name, "camera.camera_from_velo", "entry " + std::to_string(i) + " is not a number",
                       "give finite numbers");
    rig.calibration.camera_from_velo.matrix()(i / 4, i % 4) = *value;
  }
  const Eigen::Matrix3d r = rig.calibration.camera_from_velo.linear();
  if ((r * r.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-3 || r.determinant() < 0)
    throw InputError(name, "camera.camera_from_velo", "its 3 × 3 part is not a rotation",
                     "give an orthonormal, right-handed matrix");
  rig.lidar = read_lidar_model(file);
  return rig;
}

}  // namespace mirage
