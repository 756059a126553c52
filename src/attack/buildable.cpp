#include "attack/buildable.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "geometry/solid.h"

namespace mirage {
namespace {

double base_height(const BuildableSettings& settings, const AdversaryLimits& limits) {
  return -settings.base * limits.half.z();
}

void print(TexturedMesh& adversary, const BuildableSettings& settings) {
  for (Vec3d& t : adversary.atlas.texels) t = t.cwiseMax(settings.black).cwiseMin(settings.white);
}

/// Vertices of the faces that break a rule.
std::vector<int> offenders(const Mesh& mesh, double min_thickness) {
  std::vector<int> vertices;
  const auto add = [&](int face) {
    const Face& f = mesh.faces[static_cast<std::size_t>(face)];
    vertices.insert(vertices.end(), {f[0], f[1], f[2]});
  };
  for (const auto& pair : intersecting_faces(mesh)) {
    add(pair[0]);
    add(pair[1]);
  }
  const std::vector<Wall> face_walls = walls(mesh);
  for (std::size_t f = 0; f < face_walls.size(); ++f)
    if (face_walls[f].thickness < min_thickness) {
      add(static_cast<int>(f));
      add(face_walls[f].opposite);
    }
  std::sort(vertices.begin(), vertices.end());
  vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
  return vertices;
}

}  // namespace

void check_buildable(const BuildableSettings& settings, const AdversaryLimits& limits) {
  // The start is 0.75 of the box: what is thinner than its walls can hold.
  const double most = 0.5 * limits.half.minCoeff();
  if (!Range{0, most}.contains(settings.min_thickness))
    throw FieldError("min_thickness", fmt::format("{}", settings.min_thickness), "out of range",
                     fmt::format("use 0 to {:.3g} m", most));
}

void make_buildable(TexturedMesh& adversary, const BuildableSettings& settings,
                    const AdversaryLimits& limits) {
  const double base = base_height(settings, limits);
  for (Vec3d& v : adversary.mesh.vertices) v.z() = std::max(v.z(), base);
  print(adversary, settings);
  if (!offenders(adversary.mesh, settings.min_thickness).empty())
    throw FieldError("min_thickness", fmt::format("{}", settings.min_thickness),
                     "the start is thinner than that", "use a smaller one");
}

void keep_buildable(TexturedMesh& adversary, const TexturedMesh& before, const BuildableSettings& settings,
                    const AdversaryLimits& limits) {
  print(adversary, settings);
  const double base = base_height(settings, limits);
  auto& vertices = adversary.mesh.vertices;
  const auto& old = before.mesh.vertices;
  // The base's own height, exactly: vertices that started on it never leave it.
  for (std::size_t i = 0; i < vertices.size(); ++i)
    vertices[i].z() = old[i].z() <= base ? base : std::max(vertices[i].z(), std::nextafter(base, 1.0));
  std::vector<int> returned(vertices.size(), 0);
  for (;;) {
    bool moved = false;
    for (const int i : offenders(adversary.mesh, settings.min_thickness)) {
      const auto k = static_cast<std::size_t>(i);
      if (returned[k] >= 2) continue;
      vertices[k] = returned[k]++ == 0 ? Vec3d((vertices[k] + old[k]) / 2) : old[k];
      moved = true;
    }
    if (!moved) return;  // none left: faces all of whose vertices are back are as good as they were before
  }
}

TexturedMesh random_baseline(std::uint64_t seed, const AdversaryLimits& limits,
                             const BuildableSettings& settings) {
  TexturedMesh random = random_adversary(seed, limits);
  if (!settings.on) return random;
  TexturedMesh start = initial_adversary(limits);
  make_buildable(start, settings, limits);
  keep_buildable(random, start, settings, limits);
  return random;
}

BuildableReport buildable_report(const TexturedMesh& adversary, const BuildableSettings& settings) {
  const Mesh& mesh = adversary.mesh;
  BuildableReport report;
  report.intersecting_pairs = intersecting_faces(mesh).size();
  report.watertight = is_watertight(mesh);
  const double lowest = bounds(mesh).min().z();
  report.min_thickness = 1e9;
  for (const Wall& wall : walls(mesh)) report.min_thickness = std::min(report.min_thickness, wall.thickness);
  const auto on_base = [&](int v) { return mesh.vertices[static_cast<std::size_t>(v)].z() <= lowest; };
  const std::vector<Vec3d> normals = face_normals(mesh);
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const Face& face = mesh.faces[f];
    if (on_base(face[0]) && on_base(face[1]) && on_base(face[2])) report.base_area += normals[f].norm() / 2;
  }
  for (const std::size_t i : used_vertices(mesh)) report.base_vertices += on_base(static_cast<int>(i));
  const std::vector<Vec3d>& texels = adversary.atlas.texels;
  const auto within = std::count_if(texels.begin(), texels.end(), [&](const Vec3d& t) {
    return t.minCoeff() >= settings.black && t.maxCoeff() <= settings.white;
  });
  report.printable =
      static_cast<double>(within) / static_cast<double>(std::max<std::size_t>(1, texels.size()));
  return report;
}

nlohmann::json to_json(const BuildableReport& report) {
  return {{"intersecting_pairs", report.intersecting_pairs},
          {"min_thickness_m", report.min_thickness},
          {"base_vertices", report.base_vertices},
          {"base_area_m2", report.base_area},
          {"watertight", report.watertight},
          {"texels_in_print_range", report.printable}};
}

}  // namespace mirage
