#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "scene/adversary_view.h"
#include "sensors/ray_caster.h"

namespace mirage {
namespace {

struct AngularWindow {
  double azimuth_min = std::numeric_limits<double>::infinity(), azimuth_max = -azimuth_min;
  double elevation_min = azimuth_min, elevation_max = -azimuth_min;
};

/// Azimuths and elevations of a convex hull's rays lie within those of its vertices, but for elevation, which is not
/// monotone along an edge: half a beam spacing of margin covers that.
AngularWindow window_of(const Mesh& mesh, const LidarModel& lidar) {
  constexpr double margin = 0.01;  // rad
  AngularWindow window;
  for (const Vec3d& v : mesh.vertices) {
    const BeamAngles angles = beam_angles(lidar, v);
    window.azimuth_min = std::min(window.azimuth_min, angles.azimuth - margin);
    window.azimuth_max = std::max(window.azimuth_max, angles.azimuth + margin);
    window.elevation_min = std::min(window.elevation_min, angles.elevation - margin);
    window.elevation_max = std::max(window.elevation_max, angles.elevation + margin);
  }
  if (window.azimuth_max - window.azimuth_min > std::numbers::pi) {  // straddles the rear: look everywhere
    window.azimuth_min = -std::numbers::pi;
    window.azimuth_max = std::numbers::pi;
  }
  return window;
}

std::array<Vec3d, 3> face_of(const Mesh& mesh, int face) {
  const Face& f = mesh.faces[static_cast<std::size_t>(face)];
  return {mesh.vertices[f[0]], mesh.vertices[f[1]], mesh.vertices[f[2]]};
}

}  // namespace

LidarTape draw_in_lidar(const PreparedFrame& prepared, const TexturedMesh& placed,
                        const SimulationSettings& settings, Simulated& result) {
  const LidarModel& lidar = prepared.lidar;
  const Sweep& measured = prepared.frame.sweep;
  const Vec3d origin = lidar.velo_from_lidar.translation();
  const Eigen::Matrix3d velo_from_lidar = lidar.velo_from_lidar.linear();
  LidarTape tape;
  if (placed.mesh.faces.empty()) {
    result.sweep = measured;
    tape.first = measured.size();
    return tape;
  }
  const RayCaster caster(std::span(&placed.mesh, 1));
  const auto trace = [&](const Vec3d& direction, LidarTape::Return& found) {
    const Hit hit = caster.intersect({origin.cast<float>(), direction.cast<float>()});
    if (!hit.hit()) return false;
    found.direction = direction;
    found.face = hit.face;
    found.hit = intersect_face<double>(origin, direction, face_of(placed.mesh, hit.face),
                                       settings.lidar_reflectivity);
    return found.hit.valid && found.hit.range >= lidar.range_min && found.hit.range <= lidar.range_max;
  };

  const AngularWindow window = window_of(placed.mesh, lidar);
  std::vector<char> removed(measured.size(), 0);
  LidarTape::Return found;
  // Rays with a measured return: the nearer of the two stays.
  for (int i : prepared.index.window(window.azimuth_min, window.azimuth_max, window.elevation_min,
                                     window.elevation_max)) {
    const Vec3d offset = measured[static_cast<std::size_t>(i)].position().cast<double>() - origin;
    const double range = offset.norm();
    if (!(range > 0) || !trace(offset / range, found)) continue;
    if (found.hit.range < range) {
      removed[static_cast<std::size_t>(i)] = 1;
      ++result.removed_points;
      tape.returns.push_back(found);
    } else {
      ++result.occluded_points;
    }
  }
  // Rays of the model without one (sky, or a return that was lost): nothing is in front.
  const int columns = lidar.azimuth_count();
  const auto column_of = [&](double azimuth) { return (azimuth - lidar.azimuth_min) / lidar.azimuth_step; };
  const int first = std::clamp(static_cast<int>(std::floor(column_of(window.azimuth_min))), 0, columns);
  const int last = std::clamp(static_cast<int>(std::ceil(column_of(window.azimuth_max))), -1, columns - 1);
  for (int beam = 0; beam < static_cast<int>(lidar.elevations.size()); ++beam) {
    const double elevation = lidar.elevations[static_cast<std::size_t>(beam)];
    if (elevation < window.elevation_min || elevation > window.elevation_max) continue;
    for (int column = first; column <= last; ++column)
      if (prepared.index.measured_range(beam, column) == 0 &&
          trace(velo_from_lidar * lidar.direction(beam, column), found))
        tape.returns.push_back(found);
  }

  result.sweep.clear();
  result.sweep.reserve(measured.size() + tape.returns.size());
  for (std::size_t i = 0; i < measured.size(); ++i)
    if (!removed[i]) result.sweep.push_back(measured[i]);
  tape.first = result.sweep.size();
  for (const auto& added : tape.returns) {
    const Vec3d p = origin + added.hit.range * added.direction;
    result.sweep.push_back({static_cast<float>(p.x()), static_cast<float>(p.y()), static_cast<float>(p.z()),
                            static_cast<float>(added.hit.reflectance)});
  }
  result.adversary_points = static_cast<int>(tape.returns.size());
  return tape;
}

void draw_in_lidar_vjp(const LidarTape& tape, const TexturedMesh& placed, const SimulationSettings& settings,
                       const std::vector<std::array<float, 4>>& d_points, std::vector<Vec3d>& d_vertices) {
  for (std::size_t i = 0; i < tape.returns.size(); ++i) {
    const auto& added = tape.returns[i];
    const auto& d = d_points[tape.first + i];
    const auto d_face = intersect_face_vjp<double>(
        added.direction, face_of(placed.mesh, added.face), added.hit, settings.lidar_reflectivity,
        settings.grazing_cosine, Vec3d(d[0], d[1], d[2]), d[3]);
    const Face& face = placed.mesh.faces[static_cast<std::size_t>(added.face)];
    for (int k = 0; k < 3; ++k) d_vertices[face[k]] += d_face[k];
  }
}

}  // namespace mirage
