#include "scene/occlusion.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace mirage {
namespace {

constexpr double kAssignTolerance = 0.1 * M_PI / 180;  // rad

/// Index of the nearest beam (elevations fall).
int nearest_beam(const std::vector<double>& elevations, double elevation) {
  const auto below = std::lower_bound(elevations.begin(), elevations.end(), elevation, std::greater<>());
  const auto place = below - elevations.begin();
  if (place == 0) return 0;
  if (below == elevations.end()) return static_cast<int>(place) - 1;
  return static_cast<int>(elevations[place - 1] - elevation < elevation - elevations[place] ? place - 1 : place);
}

/// Half the distance to the beam's nearest neighbour on the side of `elevation`.
double half_spacing(const std::vector<double>& elevations, int beam, double elevation) {
  const int n = static_cast<int>(elevations.size());
  if (n == 1) return M_PI;
  const int other = elevation > elevations[static_cast<std::size_t>(beam)] ? beam - 1 : beam + 1;
  const int neighbour = other < 0 ? 1 : other >= n ? n - 2 : other;
  return std::abs(elevations[static_cast<std::size_t>(neighbour)] - elevations[static_cast<std::size_t>(beam)]) / 2;
}

}  // namespace

BeamAngles beam_angles(const LidarModel& lidar, const Vec3d& p_velo) {
  const Vec3d p = lidar.velo_from_lidar.inverse() * p_velo;
  return {std::atan2(p.y(), p.x()), std::atan2(p.z(), std::hypot(p.x(), p.y())), p.norm()};
}

SweepIndex::SweepIndex(const Sweep& sweep, const LidarModel& lidar) : columns_(lidar.azimuth_count()) {
  const int beams = static_cast<int>(lidar.elevations.size());
  cells_.assign(static_cast<std::size_t>(beams) * columns_, 0.f);
  std::vector<float> angle_error(cells_.size(), std::numeric_limits<float>::infinity());
  std::vector<unsigned char> close(cells_.size(), 0);
  long in_field = 0;
  entries_.reserve(sweep.size());
  for (std::size_t i = 0; i < sweep.size(); ++i) {
    const BeamAngles angles = beam_angles(lidar, sweep[i].position().cast<double>());
    entries_.push_back({angles.azimuth, angles.elevation, angles.range, static_cast<int>(i)});
    const long column = std::lround((angles.azimuth - lidar.azimuth_min) / lidar.azimuth_step);
    if (column < 0 || column >= columns_) continue;
    ++in_field;
    const int beam = nearest_beam(lidar.elevations, angles.elevation);
    const double off_beam = std::abs(angles.elevation - lidar.elevations[static_cast<std::size_t>(beam)]);
    if (off_beam > half_spacing(lidar.elevations, beam, angles.elevation)) continue;
    const double off_column =
        std::abs(angles.azimuth - lidar.azimuth_min - static_cast<double>(column) * lidar.azimuth_step);
    const std::size_t cell = static_cast<std::size_t>(beam) * columns_ + static_cast<std::size_t>(column);
    const double error = std::hypot(off_beam, off_column);
    if (error <= kAssignTolerance && close[cell] < 2) ++close[cell];
    if (error < angle_error[cell]) {
      angle_error[cell] = static_cast<float>(error);
      cells_[cell] = static_cast<float>(angles.range);
    }
  }
  std::stable_sort(entries_.begin(), entries_.end(),
                   [](const Entry& a, const Entry& b) { return a.azimuth < b.azimuth; });
  const auto unique = std::count(close.begin(), close.end(), 1);
  assigned_share_ = in_field > 0 ? static_cast<double>(unique) / static_cast<double>(in_field) : 0;
}

std::vector<int> SweepIndex::window(double azimuth_min, double azimuth_max, double elevation_min,
                                    double elevation_max) const {
  std::vector<int> found;
  auto entry = std::lower_bound(entries_.begin(), entries_.end(), azimuth_min,
                                [](const Entry& e, double azimuth) { return e.azimuth < azimuth; });
  for (; entry != entries_.end() && entry->azimuth <= azimuth_max; ++entry)
    if (entry->elevation >= elevation_min && entry->elevation <= elevation_max) found.push_back(entry->point);
  std::sort(found.begin(), found.end());
  return found;
}

double SweepIndex::measured_range(int beam, int column) const {
  return cells_[static_cast<std::size_t>(beam) * columns_ + static_cast<std::size_t>(column)];
}

double SweepIndex::assigned_share() const { return assigned_share_; }

}  // namespace mirage
