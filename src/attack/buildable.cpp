#include "attack/buildable.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/error.h"
#include "geometry/solid.h"

namespace mirage {
namespace {

/// m, what smooths an optimiser's step: a Gaussian's standard deviation as a share of the box's half height.
constexpr double kReach = 0.3;
/// Share of the box's half height before its sides over which steps towards them fade out.
constexpr double kMargin = 0.2;
/// Of the optimiser's rate: means of neighbours are shorter than their parts.
constexpr double kRate = 1.5;
/// m beyond the thinnest wall: walls below are moved apart before they are too thin.
constexpr double kReserve = 0.005;

/// The field's mean around each vertex, weighted by a Gaussian of the distance in space.
std::vector<Vec3d> smoothed(const std::vector<Vec3d>& vertices, const std::vector<Vec3d>& field,
                            double reach) {
  std::vector<Vec3d> result(field.size(), Vec3d::Zero());
  for (std::size_t i = 0; i < field.size(); ++i) {
    double sum = 0;
    for (std::size_t k = 0; k < field.size(); ++k) {
      const double weight = std::exp(-(vertices[i] - vertices[k]).squaredNorm() / (2 * reach * reach));
      sum += weight;
      result[i] += weight * field[k];
    }
    result[i] /= sum;
  }
  return result;
}

void print(TexturedMesh& adversary, const BuildableSettings& settings) {
  for (Vec3d& t : adversary.atlas.texels) t = settings.gamut.nearest(t);
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

/// Base vertices are those that `before` has on the floor: they stay there, to the bit, and others above.
void hold_base(std::vector<Vec3d>& vertices, const Mesh& before) {
  const std::vector<Vec3d>& old = before.vertices;
  const double floor = bounds(before).min().z(),
               above = std::nextafter(floor, std::numeric_limits<double>::infinity());
  for (std::size_t i = 0; i < vertices.size(); ++i)
    vertices[i].z() = old[i].z() <= floor ? floor : std::max(vertices[i].z(), above);
}

/// m², of the faces whose corners are all at the lowest height.
double base_area(const Mesh& mesh) {
  const double floor = bounds(mesh).min().z();
  const std::vector<Vec3d> normals = face_normals(mesh);
  double area = 0;
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const Face& face = mesh.faces[f];
    if (std::ranges::all_of(face,
                            [&](int v) { return mesh.vertices[static_cast<std::size_t>(v)].z() <= floor; }))
      area += normals[f].norm() / 2;
  }
  return area;
}

/// Moves the two sides of thin walls apart, along their vertices' normals and within the box.
void thicken(Mesh& mesh, const Mesh& before, double least, const AdversaryLimits& limits) {
  constexpr int kRounds = 4;
  for (int round = 0; round < kRounds; ++round) {
    std::vector<double> lack(mesh.vertices.size(), 0);
    const std::vector<Wall> face_walls = walls(mesh);
    bool thin = false;
    for (std::size_t f = 0; f < face_walls.size(); ++f) {
      if (face_walls[f].thickness >= least) continue;
      thin = true;
      for (const std::size_t side : {f, static_cast<std::size_t>(face_walls[f].opposite)})
        for (const int v : mesh.faces[side]) {
          double& most = lack[static_cast<std::size_t>(v)];
          most = std::max(most, least - face_walls[f].thickness);
        }
    }
    if (!thin) return;
    std::vector<Vec3d> normals(mesh.vertices.size(), Vec3d::Zero());
    const std::vector<Vec3d> of_faces = face_normals(mesh);
    for (std::size_t f = 0; f < of_faces.size(); ++f)
      for (const int v : mesh.faces[f]) normals[static_cast<std::size_t>(v)] += of_faces[f];
    for (std::size_t i = 0; i < lack.size(); ++i)
      if (lack[i] > 0 && normals[i].norm() > 0)
        mesh.vertices[i] = (mesh.vertices[i] + 0.5 * lack[i] * normals[i].normalized())
                               .cwiseMax(-limits.half)
                               .cwiseMin(limits.half);
    hold_base(mesh.vertices, before);
  }
}

/// Takes the vertices that break a rule back to `old`, first half the way and then all of it, until none is
/// left: faces all of whose vertices are back are as good as they were.
void take_back(Mesh& mesh, const std::vector<Vec3d>& old, double min_thickness) {
  std::vector<int> returned(old.size(), 0);
  for (bool moved = true; moved;) {
    moved = false;
    for (const int i : offenders(mesh, min_thickness)) {
      const auto k = static_cast<std::size_t>(i);
      if (returned[k] >= 2) continue;
      mesh.vertices[k] = returned[k]++ == 0 ? Vec3d((mesh.vertices[k] + old[k]) / 2) : old[k];
      moved = true;
    }
  }
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
  const Eigen::AlignedBox3d box = bounds(adversary.mesh);
  const bool stands = base_area(adversary.mesh) > 0;
  const double floor = -limits.half.z(), cut = box.min().z() + (stands ? 0 : settings.base * box.sizes().z());
  for (Vec3d& v : adversary.mesh.vertices) v.z() = v.z() <= cut ? floor : v.z() - cut + floor;
  print(adversary, settings);
  if (!offenders(adversary.mesh, settings.min_thickness).empty())
    throw FieldError("min_thickness", fmt::format("{}", settings.min_thickness),
                     "the start is no solid of such walls", "use a smaller one, or --free");
}

void step_buildable(Adam& adam, std::vector<Vec3d>& vertices, const std::vector<Vec3d>& gradient,
                    const AdversaryLimits& limits) {
  const double reach = kReach * limits.half.z(), margin = kMargin * limits.half.z();
  std::vector<Vec3d> way(vertices.size(), Vec3d::Zero());
  const double rate = adam.learning_rate;
  adam.learning_rate *= kRate;
  adam.step(way, smoothed(vertices, gradient, reach));
  adam.learning_rate = rate;
  way = smoothed(vertices, way, reach);
  for (std::size_t i = 0; i < vertices.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      const double room = limits.half[c] - std::copysign(vertices[i][c], way[i][c] * vertices[i][c]);
      vertices[i][c] += way[i][c] * std::clamp(room / margin, 0.0, 1.0);
    }
}

void keep_buildable(TexturedMesh& adversary, const TexturedMesh& before, const BuildableSettings& settings,
                    const AdversaryLimits& limits) {
  Mesh& mesh = adversary.mesh;
  print(adversary, settings);
  hold_base(mesh.vertices, before.mesh);
  thicken(mesh, before.mesh, settings.min_thickness + kReserve, limits);
  take_back(mesh, before.mesh.vertices, settings.min_thickness);
}

TexturedMesh random_baseline(std::uint64_t seed, const AdversaryLimits& limits,
                             const BuildableSettings& settings) {
  TexturedMesh random = random_adversary(seed, limits);
  if (!settings.on) return random;
  TexturedMesh start = initial_adversary(limits);
  const std::vector<Vec3d> ellipsoid = start.mesh.vertices;
  make_buildable(start, settings, limits);
  for (std::size_t i = 0; i < ellipsoid.size(); ++i)
    random.mesh.vertices[i] += start.mesh.vertices[i] - ellipsoid[i];
  project(random, limits);
  keep_buildable(random, start, settings, limits);
  return random;
}

BuildableReport buildable_report(const TexturedMesh& adversary, const BuildableSettings& settings) {
  const Mesh& mesh = adversary.mesh;
  BuildableReport report;
  report.intersecting_pairs = intersecting_faces(mesh).size();
  report.watertight = is_watertight(mesh);
  report.min_thickness = 1e9;
  for (const Wall& wall : walls(mesh)) report.min_thickness = std::min(report.min_thickness, wall.thickness);
  report.base_area = base_area(mesh);
  const double floor = bounds(mesh).min().z();
  for (const std::size_t i : used_vertices(mesh)) report.base_vertices += mesh.vertices[i].z() <= floor;
  const std::vector<Vec3d>& texels = adversary.atlas.texels;
  const auto within =
      std::count_if(texels.begin(), texels.end(), [&](const Vec3d& t) { return settings.gamut.holds(t); });
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
