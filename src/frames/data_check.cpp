#include "frames/data_check.h"

#include <fmt/format.h>

#include <algorithm>
#include <mutex>
#include <set>

#include "base/error.h"
#include "base/logging.h"
#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "scene/data/data_rig.h"
#include "scene/data/read_frames.h"
#include "scene/occlusion.h"

namespace mirage {
namespace {

constexpr double kEnoughOnRays = 0.95;
/// Of a frame: fewer say nothing of the unit (16 beams give 6 000 in 80 degrees).
constexpr std::size_t kFewestReturns = 2000;
constexpr double kOddReflectances = 0.001;
constexpr double kBeamsWithout = 0.25;  // share of those that should have returns
constexpr std::size_t kFewestCars = 5;
constexpr double kCarsWithReturns = 0.5;

/// Where a sweep surely reaches a car that is not behind something.
bool should_hold_returns(const Label& label) {
  constexpr double kFarthest = 50;  // m
  return label.type == "Car" && has_box(label) && label.occluded <= 1 && label.truncated < 0.5 &&
         std::hypot(label.box.bev.x, label.box.bev.y) < kFarthest;
}

/// Whether level ground surely gives a beam returns: it is met within 30 m, and not below the car.
bool meets_ground(const LidarModel& lidar, const LidarBeam& beam) {
  constexpr double kNearest = 3, kFarthest = 30;  // m
  const double slope = -std::tan(beam.elevation), drop = lidar.height + beam.height;
  return slope * kNearest < drop && slope * kFarthest > drop;
}

/// `returns`: of each beam, so far.
void look_at_frame(const DataSet& set, const std::string& id, const LidarModel& lidar, DataLook& look,
                   std::vector<std::size_t>& returns) {
  const Sweep sweep = set.sweep(id);
  const auto [width, height] = set.picture_size(id);
  const Annotations known = set.annotations(id, width, height);
  const Sweep seen = points_in_view(sweep, known.calibration);
  // Of whole sweeps: at a picture's edges a firing has few returns, and is not found.
  look.on_rays += SweepIndex(sweep, lidar).assigned_share() * static_cast<double>(sweep.size());
  look.returns += sweep.size();
  for (const int beam : beams_of(sweep, lidar))
    if (beam >= 0) ++returns[as_size(beam)];
  for (const LidarPoint& point : sweep) {
    look.odd_reflectance += !(point.reflectance >= 0 && point.reflectance <= 1);
    look.highest = std::max(look.highest, point.reflectance);
  }
  for (const Label& label : known.labels) {
    if (!should_hold_returns(label)) continue;
    ++look.cars;
    constexpr double kMargin = 0.2;  // m
    look.cars_with_returns += std::any_of(seen.begin(), seen.end(), [&](const LidarPoint& point) {
      return contains(label.box, point.position().cast<double>(), kMargin);
    });
  }
  ++look.frames;
}

std::string percent_of(double share) {
  return fmt::format("{:.1f} %", 100 * share);
}

}  // namespace

DataLook look_at_data(const std::filesystem::path& data, const std::string& rig, std::size_t frames) {
  DataLook look;
  const auto set = open_data_set(data);
  std::vector<std::string> ids;
  try {
    ids = set->frames();
  } catch (const InputError&) {
    return look;
  }
  const LidarModel lidar = lidar_of(data, rig);
  const std::size_t count = std::min(frames, ids.size());
  std::vector<std::size_t> returns(lidar.beams.size());
  for (std::size_t i = 0; i < count; ++i) {
    try {
      look_at_frame(*set, ids[count > 1 ? i * (ids.size() - 1) / (count - 1) : 0], lidar, look, returns);
    } catch (const InputError&) {
    }
  }
  if (look.returns == 0) return look;
  look.on_rays /= static_cast<double>(look.returns);
  constexpr std::size_t kFew = 50;  // strays: one in so many of the fullest beam's
  const std::size_t most = *std::max_element(returns.begin(), returns.end());
  const auto without = [&](std::size_t b) { return kFew * returns[b] < most; };
  // Beyond the last beams with returns there may be nothing to meet.
  double lowest = 1, highest = -1;
  for (std::size_t b = 0; b < returns.size(); ++b)
    if (!without(b)) {
      lowest = std::min(lowest, lidar.beams[b].elevation);
      highest = std::max(highest, lidar.beams[b].elevation);
    }
  for (std::size_t b = 0; b < returns.size(); ++b) {
    const LidarBeam& beam = lidar.beams[b];
    if (!meets_ground(lidar, beam) || beam.elevation < lowest || beam.elevation > highest) continue;
    ++look.beams;
    look.beams_without += without(b);
  }
  return look;
}

void check_data(const std::filesystem::path& data, const std::string& rig, UnitUse use) {
  static std::mutex mutex;
  static std::set<std::string> checked;
  const std::scoped_lock lock(mutex);
  const std::string key = std::filesystem::absolute(data).lexically_normal().string() + '\0' + rig;
  if (checked.contains(key)) return;
  const DataLook look = look_at_data(data, rig);
  const std::string set = data.string();
  if (look.frames > 0 && look.returns >= kFewestReturns * look.frames) {
    const bool assumed = rig_is_assumed(data, rig);
    const std::string unit = fmt::format("the LiDAR of the rig {}{}", !rig.empty() ? rig : data_rig(data),
                                         assumed ? ", which is assumed of this layout" : "");
    const std::string fix =
        fmt::format("find the unit (mirage rig --data {} --out rig.toml) and give it (--rig rig.toml)", set);
    if (look.on_rays < kEnoughOnRays) {
      const std::string problem = fmt::format(
          "{} of the returns lie on a ray of {}: another unit recorded these sweeps, or in other axes",
          percent_of(look.on_rays), unit);
      if (assumed && use == UnitUse::casts_rays) throw InputError(set, "sweeps", problem, fix);
      spdlog::warn("{}: {}; {}", set, problem, fix);
    } else if (static_cast<double>(look.beams_without) >= kBeamsWithout * static_cast<double>(look.beams) &&
               look.beams_without > 0) {
      // Not refused: where no ground is, a whole unit has none either.
      spdlog::warn(
          "{}: {} of the {} beams that meet level ground within 30 m have no returns, of {}: another unit "
          "recorded these sweeps, or beams were left out; {}",
          set, look.beams_without, look.beams, unit, fix);
    }
  }
  if (static_cast<double>(look.odd_reflectance) > kOddReflectances * static_cast<double>(look.returns))
    spdlog::warn(
        "{}: {} of the returns have a reflectance outside [0, 1] (up to {:g}); divide by the "
        "largest that the unit can report, often 255",
        set, percent_of(static_cast<double>(look.odd_reflectance) / static_cast<double>(look.returns)),
        look.highest);
  if (look.cars >= kFewestCars &&
      static_cast<double>(look.cars_with_returns) < kCarsWithReturns * static_cast<double>(look.cars))
    spdlog::warn(
        "{}: {} of {} labelled cars near by and in view hold a return; check that labels, sweeps "
        "and calibration are of the same moment and axes",
        set, look.cars_with_returns, look.cars);
  checked.insert(key);
}

}  // namespace mirage
