#include "sensors/lidar_model.h"

#include <cmath>
#include <numbers>

#include "base/config.h"
#include "base/error.h"

namespace mirage {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

}  // namespace

int LidarModel::azimuth_count() const {
  return static_cast<int>(std::floor((azimuth_max - azimuth_min) / azimuth_step + 1e-9)) + 1;
}

double LidarModel::firing_azimuth(int column) const {
  const double azimuth = azimuth_min + column * azimuth_step;
  return encoder_step > 0 ? std::round(azimuth / encoder_step) * encoder_step : azimuth;
}

LidarRay LidarModel::ray_at(int beam, double firing_azimuth_) const {
  const LidarBeam& b = beams[static_cast<std::size_t>(beam)];
  const double a = firing_azimuth_ + b.azimuth_offset, ca = std::cos(a), sa = std::sin(a);
  const double ce = std::cos(b.elevation), se = std::sin(b.elevation);
  return {velo_from_lidar * Vec3d(-b.lateral * sa, b.lateral * ca, b.height),
          velo_from_lidar.linear() * Vec3d(ce * ca, ce * sa, se)};
}

LidarModel read_lidar_model(const std::filesystem::path& rig) {
  ConfigTable file = ConfigTable::read(rig);
  ConfigTable table = file.table("lidar");
  LidarModel model;
  model.name = table.text("name");
  for (const auto& row : table.rows("beams", 4, -180, 180))
    model.beams.push_back({row[0] * kDegree, row[1], row[2], row[3] * kDegree});
  model.azimuth_step = table.number("azimuth_step", 0.01, 10) * kDegree;
  model.encoder_step = table.number("encoder_step", 0, 1) * kDegree;
  const auto azimuth = table.numbers("azimuth", 2, -180, 180), range = table.numbers("range", 2, 0, 1000);
  model.azimuth_min = azimuth[0] * kDegree, model.azimuth_max = azimuth[1] * kDegree;
  model.range_min = range[0], model.range_max = range[1];
  model.rate = table.number("rate", 0.1, 100);
  const auto mount = table.numbers("velo_from_lidar", 6, -180, 180);
  model.velo_from_lidar.translation() = Vec3d(mount[0], mount[1], mount[2]);
  model.velo_from_lidar.linear() = (Eigen::AngleAxisd(mount[5] * kDegree, Vec3d::UnitZ()) *
                                    Eigen::AngleAxisd(mount[4] * kDegree, Vec3d::UnitY()) *
                                    Eigen::AngleAxisd(mount[3] * kDegree, Vec3d::UnitX()))
                                       .toRotationMatrix();
  model.height = table.number("height", 0, 10);
  table.check_all_known();
  const auto demand = [&](bool good, const char* key, const char* problem, const char* fix) {
    if (!good) throw InputError(rig.string(), std::string("lidar.") + key, problem, fix);
  };
  demand(model.azimuth_max > model.azimuth_min, "azimuth", "the field is empty", "write [smallest, largest]");
  demand(model.range_max > model.range_min, "range", "the limits are out of order",
         "write [smallest, largest]");
  demand(model.encoder_step <= model.azimuth_step, "encoder_step", "larger than azimuth_step",
         "write the encoder's resolution in degrees, or 0");
  for (std::size_t i = 0; i < model.beams.size(); ++i) {
    const LidarBeam& beam = model.beams[i];
    demand(std::abs(beam.elevation) < 89 * kDegree, "beams", "an elevation is not between -89 and 89 degrees",
           "write [elevation, height, lateral, azimuth offset]");
    // Looked up by bisection: at no distance may a lower beam pass above a higher one.
    demand(
        i == 0 || (beam.elevation < model.beams[i - 1].elevation && beam.height <= model.beams[i - 1].height),
        "beams", "not sorted from the top beam down", "sort the rows by elevation, highest first");
  }
  return model;
}

}  // namespace mirage
