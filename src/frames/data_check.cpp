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
/// Returns a frame: fewer tell nothing about the unit (16 beams give 6 000 in 80 degrees).
constexpr std::size_t kMinReturns = 2000;
constexpr double kOddReflectances = 0.001;
constexpr double kBeamsWithout = 0.25;  // share of those that should have returns
constexpr std::size_t kMinCars = 5;
constexpr double kCarsWithReturns = 0.5;

/// Whether a sweep must have returns on this label: an unhidden car in range.
bool should_hold_returns(const Label& label) {
  constexpr double kMaxDistance = 50;  // m
  return label.type == "Car" && has_box(label) && label.occluded <= 1 && label.truncated < 0.5 &&
         horizontal_distance(label.box.bev) < kMaxDistance;
}

/// Whether a beam must have returns from level ground: it meets it within 30 m, and not below the car.
bool meets_ground(const LidarModel& lidar, const LidarBeam& beam) {
  constexpr double kMinDistance = 3, kMaxDistance = 30;  // m
  const double slope = -std::tan(beam.elevation), drop = lidar.height + beam.height;
  return slope * kMinDistance < drop && slope * kMaxDistance > drop;
}

/// `returns`: count for each beam, so far.
void add_frame(const DataSet& set, const std::string& id, const LidarModel& lidar, DataStatistics& statistics,
               std::vector<std::size_t>& returns) {
  const Sweep sweep = set.sweep(id);
  const auto [width, height] = set.picture_size(id);
  const Annotations labelled = set.annotations(id, width, height);
  const Sweep seen = points_in_view(sweep, labelled.calibration);
  // Of the whole sweep: at a picture's edges a firing has too few returns to be found.
  statistics.on_rays += SweepIndex(sweep, lidar).assigned_share() * static_cast<double>(sweep.size());
  statistics.returns += sweep.size();
  for (const int beam : beams_of(sweep, lidar))
    if (beam >= 0) ++returns[as_size(beam)];
  for (const LidarPoint& point : sweep) {
    statistics.odd_reflectance += !(point.reflectance >= 0 && point.reflectance <= 1);
    statistics.highest = std::max(statistics.highest, point.reflectance);
  }
  for (const Label& label : labelled.labels) {
    if (!should_hold_returns(label)) continue;
    ++statistics.cars;
    constexpr double kMargin = 0.2;  // m
    statistics.cars_with_returns += std::any_of(seen.begin(), seen.end(), [&](const LidarPoint& point) {
      return contains(label.box, point.position().cast<double>(), kMargin);
    });
  }
  ++statistics.frames;
}

}  // namespace

DataStatistics data_statistics(const std::filesystem::path& data, const std::string& rig,
                               std::size_t frames) {
  DataStatistics statistics;
  const auto set = open_data_set(data);
  std::vector<std::string> ids;
  try {
    ids = set->frames();
  } catch (const InputError&) {
    return statistics;
  }
  const LidarModel lidar = lidar_of(data, rig);
  const std::size_t count = std::min(frames, ids.size());
  std::vector<std::size_t> returns(lidar.beams.size());
  for (std::size_t i = 0; i < count; ++i) {
    try {
      add_frame(*set, ids[count > 1 ? i * (ids.size() - 1) / (count - 1) : 0], lidar, statistics, returns);
    } catch (const InputError&) {
    }
  }
  if (statistics.returns == 0) return statistics;
  statistics.on_rays /= static_cast<double>(statistics.returns);
  constexpr std::size_t kFew = 50;  // up to 1/kFew of the fullest beam's returns are strays
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
    ++statistics.beams;
    statistics.beams_without += without(b);
  }
  return statistics;
}

void check_data(const std::filesystem::path& data, const std::string& rig, UnitUse use) {
  static std::mutex mutex;
  static std::set<std::string> checked;
  const std::scoped_lock lock(mutex);
  const std::string key = std::filesystem::absolute(data).lexically_normal().string() + '\0' + rig;
  if (checked.contains(key)) return;
  const DataStatistics statistics = data_statistics(data, rig);
  const std::string set = data.string();
  if (statistics.frames > 0 && statistics.returns >= kMinReturns * statistics.frames) {
    const bool assumed = rig_is_assumed(data, rig);
    const std::string unit = fmt::format("the LiDAR of the rig {}{}", !rig.empty() ? rig : data_rig(data),
                                         assumed ? ", which is assumed of this layout" : "");
    const std::string fix =
        fmt::format("find the unit (mirage rig --data {} --out rig.toml) and give it (--rig rig.toml)", set);
    if (statistics.on_rays < kEnoughOnRays) {
      const std::string problem = fmt::format(
          "only {:.1f} % of the returns lie on a ray of {}: these sweeps are from another unit, or in other "
          "axes",
          100 * statistics.on_rays, unit);
      if (assumed && use == UnitUse::casts_rays) throw InputError(set, "sweeps", problem, fix);
      spdlog::warn("{}: {}; {}", set, problem, fix);
    } else if (static_cast<double>(statistics.beams_without) >=
                   kBeamsWithout * static_cast<double>(statistics.beams) &&
               statistics.beams_without > 0) {
      // Only a warning: without ground an intact unit has no such returns either.
      spdlog::warn(
          "{}: {} of the {} beams that meet level ground within 30 m have no returns, for {}: these sweeps "
          "are from another unit, or lack some beams; {}",
          set, statistics.beams_without, statistics.beams, unit, fix);
    }
  }
  if (static_cast<double>(statistics.odd_reflectance) >
      kOddReflectances * static_cast<double>(statistics.returns))
    spdlog::warn(
        "{}: {:.1f} % of the returns have a reflectance outside [0, 1] (up to {:g}); divide by the "
        "largest that the unit can report, often 255",
        set,
        100 * (static_cast<double>(statistics.odd_reflectance) / static_cast<double>(statistics.returns)),
        statistics.highest);
  if (statistics.cars >= kMinCars && static_cast<double>(statistics.cars_with_returns) <
                                         kCarsWithReturns * static_cast<double>(statistics.cars))
    spdlog::warn(
        "{}: {} of {} labelled cars near by and in view hold a return; check that labels, sweeps "
        "and calibration are of the same moment and axes",
        set, statistics.cars_with_returns, statistics.cars);
  checked.insert(key);
}

}  // namespace mirage
