#include "sensors/lidar_model.h"

#include <fmt/format.h>

#include <cstdint>
#include <numbers>

#include "base/config.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/sizes.h"
#include "sensors/lidar_effects.h"

namespace mirage {
namespace {

/// Limit on beams × firings of a unit; a VLS-128 at its finest (0.1°) has 460 800.
constexpr std::int64_t kMaxRays = 1 << 23;

/// The file of the unit that `file` names in its `field`: only a shipped one, because rig files come with
/// untrusted data sets; and only one that names no further unit.
std::filesystem::path own_table_of(const std::filesystem::path& named_in, const char* field,
                                   const std::string& name) {
  if (name.empty() || name.ends_with(".toml") || name.find_first_of(std::string("/\0", 2)) != name.npos)
    throw InputError(named_in.string(), field, "is not a unit's name",
                     "name a unit of scenes/lidars; a file of your own is given by --lidar");
  if (const auto units = shipped_names("scenes/lidars", ".toml");
      std::find(units.begin(), units.end(), name) == units.end())
    throw InputError(named_in.string(), field, name + " is not a shipped unit", use_one_of(name, units));
  const std::filesystem::path unit = lidar_file(name);
  const nlohmann::json file = read_toml(unit);
  const nlohmann::json table = file.value("lidar", nlohmann::json());
  if (table.is_string() || table.contains("unit"))
    throw InputError(unit.string(), "lidar", "names another unit", "write the unit's [lidar] table");
  return unit;
}

}  // namespace

int LidarModel::azimuth_count() const {
  const int steps = static_cast<int>(std::floor((azimuth_max - azimuth_min) / azimuth_step + 1e-9));
  // After a whole turn the last column is the first again.
  return steps * azimuth_step > 2 * std::numbers::pi - azimuth_step / 2 ? steps : steps + 1;
}

double LidarModel::firing_azimuth(int column) const {
  const double azimuth = azimuth_min + column * azimuth_step;
  return encoder_step > 0 ? std::round(azimuth / encoder_step) * encoder_step : azimuth;
}

double LidarModel::firing_time(int beam, double firing_azimuth_) const {
  const double turn = std::remainder(firing_azimuth_, 2 * std::numbers::pi) / (2 * std::numbers::pi);
  return (rate > 0 ? rotation * turn / rate : 0) + beams[as_size(beam)].time;
}

LidarRay LidarModel::ray_at(int beam, double firing_azimuth_) const {
  const LidarBeam& b = beams[as_size(beam)];
  const double a = firing_azimuth_ + b.azimuth_offset, ca = std::cos(a), sa = std::sin(a);
  const double ce = std::cos(b.elevation), se = std::sin(b.elevation);
  return {velo_from_lidar * Vec3d(-b.lateral * sa, b.lateral * ca, b.height),
          velo_from_lidar.linear() * Vec3d(ce * ca, ce * sa, se)};
}

RayTable ray_table(const LidarModel& lidar) {
  const int columns = lidar.azimuth_count();
  RayTable table(lidar.beams.size(), as_size(columns));
  for (std::size_t b = 0; b < lidar.beams.size(); ++b)
    for (int column = 0; column < columns; ++column) {
      const LidarRay ray = lidar.ray(static_cast<int>(b), column);
      table.set(b, as_size(column), ray.origin.cast<float>(), ray.direction.cast<float>());
    }
  return table;
}

nlohmann::json lidar_table(const std::filesystem::path& path) {
  const nlohmann::json file = read_toml(path);
  if (!file.contains("lidar"))
    throw InputError(path.string(), "lidar", "missing key", "add the table, or name a unit of scenes/lidars");
  const nlohmann::json& own = file.at("lidar");
  if (own.is_string()) return lidar_table(own_table_of(path, "lidar", own));
  if (!own.is_object()) throw InputError(path.string(), "lidar", "is not a table", "write it as [lidar]");
  if (!own.contains("unit")) return own;
  if (!own.at("unit").is_string())
    throw InputError(path.string(), "lidar.unit", "is not text", "name a unit of scenes/lidars");
  nlohmann::json table = lidar_table(own_table_of(path, "lidar.unit", own.at("unit")));
  for (const auto& [key, value] : own.items())
    if (key != "unit") table[key] = value;
  return table;
}

std::filesystem::path lidar_file(const std::string& name) {
  return name.ends_with(".toml") ? std::filesystem::path(name)
                                 : shipped_choice("scenes/lidars", ".toml", name, "lidar", "a file (.toml)");
}

LidarModel read_lidar_model(const std::filesystem::path& path) {
  const nlohmann::json file = read_toml(path);
  if (file.contains("lidar") && file.at("lidar").is_string())
    return read_lidar_model(own_table_of(path, "lidar", file.at("lidar")));
  ConfigTable table = ConfigTable::of(path, "lidar", lidar_table(path));
  const auto demand = [&](bool good, const char* key, const char* problem, const char* fix) {
    if (!good) throw InputError(path.string(), std::string("lidar.") + key, problem, fix);
  };
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
  if (table.has("rotation")) {
    const std::string rotation = table.text("rotation");
    demand(rotation == "clockwise" || rotation == "counter-clockwise", "rotation", "not a sense of rotation",
           "write \"clockwise\" or \"counter-clockwise\"");
    model.rotation = rotation == "clockwise" ? -1 : 1;
  }
  if (table.has("firing_time")) {
    const auto times = table.numbers("firing_time", model.beams.size(), 0, 1e5);
    for (std::size_t b = 0; b < times.size(); ++b) {
      model.beams[b].time = times[b] * 1e-6;
      model.beams[b].azimuth_offset += model.rotation * 2 * std::numbers::pi * model.rate * times[b] * 1e-6;
    }
  }
  if (table.has("divergence")) {
    const auto full = table.numbers("divergence", 2, 0, 100);
    model.divergence = Vec2d(full[0], full[1]) * 1e-3;
  }
  if (table.has("recorded_effects")) {
    model.recorded_effects = table.text("recorded_effects");
    try {
      parse_lidar_effects(model.recorded_effects, model.divergence);
    } catch (const FieldError& error) {
      throw InputError(path.string(), "lidar.recorded_effects", error.value + ": " + error.problem,
                       error.fix);
    }
  }
  const auto mount = table.numbers("velo_from_lidar", 6, -180, 180);
  model.velo_from_lidar.translation() = Vec3d(mount[0], mount[1], mount[2]);
  model.velo_from_lidar.linear() = (Eigen::AngleAxisd(mount[5] * kDegree, Vec3d::UnitZ()) *
                                    Eigen::AngleAxisd(mount[4] * kDegree, Vec3d::UnitY()) *
                                    Eigen::AngleAxisd(mount[3] * kDegree, Vec3d::UnitX()))
                                       .toRotationMatrix();
  model.height = table.number("height", 0, 10);
  table.check_all_known();
  demand(model.azimuth_max > model.azimuth_min, "azimuth", "the field is empty", "write [smallest, largest]");
  const std::int64_t rays = static_cast<std::int64_t>(model.beams.size()) * model.azimuth_count();
  demand(rays <= kMaxRays, "beams, azimuth_step",
         fmt::format("{} beams of {} firings are more than {} rays", model.beams.size(),
                     model.azimuth_count(), kMaxRays)
             .c_str(),
         "give fewer beams or a larger step");
  demand(model.range_max > model.range_min, "range", "the limits are out of order",
         "write [smallest, largest]");
  demand(model.encoder_step <= model.azimuth_step, "encoder_step", "larger than azimuth_step",
         "write the encoder's resolution in degrees, or 0");
  for (std::size_t i = 0; i < model.beams.size(); ++i) {
    const LidarBeam& beam = model.beams[i];
    demand(std::abs(beam.elevation) < 89 * kDegree, "beams", "an elevation is not between -89 and 89 degrees",
           "write [elevation, height, lateral, azimuth offset]");
    if (i == 0) continue;
    // Beams are looked up by bisection over their heights: beyond the smallest range, no lower beam may pass
    // above a higher one.
    const LidarBeam& above = model.beams[i - 1];
    const double nearest = model.range_min * std::min(std::cos(above.elevation), std::cos(beam.elevation));
    const double rise = std::tan(above.elevation) - std::tan(beam.elevation);
    demand(rise > 0 && above.height - beam.height + nearest * rise >= 0, "beams",
           "not sorted from the top beam down", "sort the rows by elevation, highest first");
  }
  return model;
}

}  // namespace mirage
