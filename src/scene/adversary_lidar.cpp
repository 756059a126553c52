#include "scene/adversary_view.h"
#include "sensors/ray_caster.h"

namespace mirage {
namespace {

std::array<Vec3d, 3> face_of(const Mesh& mesh, int face) {
  const Face& f = mesh.faces[static_cast<std::size_t>(face)];
  return {mesh.vertices[f[0]], mesh.vertices[f[1]], mesh.vertices[f[2]]};
}

}  // namespace

LidarTape draw_in_lidar(const PreparedFrame& prepared, const TexturedMesh& placed,
                        const SimulationSettings& settings, Simulated& result) {
  const LidarModel& lidar = prepared.lidar;
  const Sweep& measured = prepared.frame.sweep;
  LidarTape tape;
  if (placed.mesh.faces.empty()) {
    result.sweep = measured;
    tape.first = measured.size();
    return tape;
  }
  const RayCaster caster(std::span(&placed.mesh, 1));
  const Eigen::AlignedBox3d box = bounds(placed.mesh);
  std::vector<char> removed(measured.size(), 0);
  for (const SweepRay& sent : prepared.index.rays_through(box.center(), box.diagonal().norm() / 2)) {
    const LidarRay& ray = sent.ray;
    const Hit hit = caster.intersect({ray.origin.cast<float>(), ray.direction.cast<float>()});
    if (!hit.hit()) continue;
    const auto met = intersect_face<double>(ray.origin, ray.direction, face_of(placed.mesh, hit.face),
                                            settings.lidar_reflectivity);
    if (!met.valid || met.range < lidar.range_min || met.range > lidar.range_max) continue;
    // The nearer of the two returns stays; a ray without a measured one has nothing in front.
    if (sent.point >= 0 && sent.range <= met.range) {
      ++result.occluded_points;
      continue;
    }
    if (sent.point >= 0) {
      removed[static_cast<std::size_t>(sent.point)] = 1;
      ++result.removed_points;
    }
    tape.returns.push_back({ray, hit.face, met});
  }

  result.sweep.clear();
  result.sweep.reserve(measured.size() + tape.returns.size());
  for (std::size_t i = 0; i < measured.size(); ++i)
    if (!removed[i]) result.sweep.push_back(measured[i]);
  tape.first = result.sweep.size();
  for (const auto& added : tape.returns) {
    const Vec3d p = added.ray.origin + added.hit.range * added.ray.direction;
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
    const auto d_face = intersect_face_vjp<double>(added.ray.direction, face_of(placed.mesh, added.face),
                                                   added.hit, settings.lidar_reflectivity,
                                                   settings.grazing_cosine, Vec3d(d[0], d[1], d[2]), d[3]);
    const Face& face = placed.mesh.faces[static_cast<std::size_t>(added.face)];
    for (int k = 0; k < 3; ++k) d_vertices[face[k]] += d_face[k];
  }
}

}  // namespace mirage
