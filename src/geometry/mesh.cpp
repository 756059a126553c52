#include "geometry/mesh.h"

#include <fmt/format.h>

#include <cmath>
#include <map>

#include "base/error.h"

namespace mirage {

std::vector<AtlasTriangle> atlas_triangles(int resolution) {
  const int n = resolution;
  const auto at = [&](int x, int y) { return Vec2d(static_cast<double>(x) / n, static_cast<double>(y) / n); };
  std::vector<AtlasTriangle> triangles;
  triangles.reserve(as_size(n) * as_size(n));
  for (int y = 0; y < n; ++y)
    for (int x = 0; x + y < n; ++x) {
      triangles.push_back({{at(x, y), at(x + 1, y), at(x, y + 1)}, y * n + x});
      if (x + y < n - 1)
        triangles.push_back({{at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)}, (n - 1 - y) * n + (n - 1 - x)});
    }
  return triangles;
}

void check_mesh(const TexturedMesh& textured, const std::string& where) {
  const auto& [mesh, atlas] = textured;
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i)
    if (!mesh.vertices[i].allFinite())
      throw InputError(where, fmt::format("vertex {}", i), "not finite", "repair the mesh before using it");
  for (std::size_t f = 0; f < mesh.faces.size(); ++f)
    for (int index : mesh.faces[f])
      if (index < 0 || as_size(index) >= mesh.vertices.size())
        throw InputError(where, fmt::format("face {}", f),
                         fmt::format("vertex index {} of {}", index, mesh.vertices.size()),
                         "repair the mesh before using it");
  if (!atlas.texels.empty() && atlas.texels.size() != mesh.faces.size() * atlas.per_face())
    throw InputError(where, "texels",
                     fmt::format("{} for {} faces of {}×{}", atlas.texels.size(), mesh.faces.size(),
                                 atlas.resolution, atlas.resolution),
                     "give C×C texels a face");
  for (std::size_t i = 0; i < atlas.texels.size(); ++i)
    if (!atlas.texels[i].allFinite())
      throw InputError(where, fmt::format("texel {}", i), "not finite", "repair the texture");
}

std::vector<Vec3d> face_normals(const Mesh& mesh) {
  std::vector<Vec3d> normals;
  normals.reserve(mesh.faces.size());
  for (const Face& f : mesh.faces) {
    const auto [a, b, c] = mesh.corners(f);
    normals.push_back((b - a).cross(c - a));
  }
  return normals;
}

double signed_volume(const Mesh& mesh) {
  double six = 0;
  for (const Face& f : mesh.faces) {
    const auto [a, b, c] = mesh.corners(f);
    six += a.dot(b.cross(c));
  }
  return six / 6;
}

bool is_watertight(const Mesh& mesh) {
  std::map<std::pair<int, int>, int> edges;
  for (const Face& f : mesh.faces)
    for (std::size_t k = 0; k < 3; ++k) ++edges[{f[k], f[(k + 1) % 3]}];
  for (const auto& [edge, count] : edges) {
    const auto opposite = edges.find({edge.second, edge.first});
    if (count != 1 || opposite == edges.end() || opposite->second != 1) return false;
  }
  return !edges.empty();
}

std::vector<std::size_t> used_vertices(const Mesh& mesh) {
  std::vector<bool> used(mesh.vertices.size(), false);
  for (const Face& f : mesh.faces)
    for (const int corner : f) used[as_size(corner)] = true;
  std::vector<std::size_t> indices;
  indices.reserve(used.size());
  for (std::size_t i = 0; i < used.size(); ++i)
    if (used[i]) indices.push_back(i);
  return indices;
}

Eigen::AlignedBox3d bounds(const Mesh& mesh) {
  Eigen::AlignedBox3d box;
  for (const Face& f : mesh.faces)
    for (const int corner : f) box.extend(mesh.vertices[as_size(corner)]);
  if (mesh.faces.empty()) box.extend(Vec3d::Zero());
  return box;
}

Mesh icosphere(int subdivisions) {
  const double g = (1 + std::sqrt(5.0)) / 2;
  Mesh mesh;
  for (const auto& v : {Vec3d(-1, g, 0), Vec3d(1, g, 0), Vec3d(-1, -g, 0), Vec3d(1, -g, 0), Vec3d(0, -1, g),
                        Vec3d(0, 1, g), Vec3d(0, -1, -g), Vec3d(0, 1, -g), Vec3d(g, 0, -1), Vec3d(g, 0, 1),
                        Vec3d(-g, 0, -1), Vec3d(-g, 0, 1)})
    mesh.vertices.push_back(v.normalized());
  mesh.faces = {{0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
                {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
                {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}};
  for (int level = 0; level < subdivisions; ++level) {
    std::map<std::pair<int, int>, int> middles;
    const auto middle = [&](int a, int b) {
      const auto key = std::minmax(a, b);
      const auto [place, added] = middles.try_emplace(key, static_cast<int>(mesh.vertices.size()));
      if (added) {
        const Vec3d point = (mesh.vertices[as_size(a)] + mesh.vertices[as_size(b)]).normalized();
        mesh.vertices.push_back(point);
      }
      return place->second;
    };
    std::vector<Face> finer;
    for (const Face& f : mesh.faces) {
      const int a = middle(f[0], f[1]), b = middle(f[1], f[2]), c = middle(f[2], f[0]);
      finer.insert(finer.end(), {{f[0], a, c}, {f[1], b, a}, {f[2], c, b}, {a, b, c}});
    }
    mesh.faces = std::move(finer);
  }
  return mesh;
}

TexturedMesh grey_ellipsoid(const Vec3d& half_lengths, double share) {
  TexturedMesh ellipsoid;
  ellipsoid.mesh = icosphere(2);
  for (Vec3d& v : ellipsoid.mesh.vertices) v = v.cwiseProduct(half_lengths) * share;
  ellipsoid.atlas.texels.assign(ellipsoid.mesh.faces.size() * ellipsoid.atlas.per_face(),
                                Vec3d::Constant(0.5));
  return ellipsoid;
}

Mesh box_mesh(const Vec3d& size) {
  Mesh mesh;
  for (int i = 0; i < 8; ++i)
    mesh.vertices.push_back(
        Vec3d((i & 1 ? .5 : -.5) * size.x(), (i & 2 ? .5 : -.5) * size.y(), (i & 4 ? .5 : -.5) * size.z()));
  mesh.faces = {{0, 2, 3}, {0, 3, 1}, {4, 5, 7}, {4, 7, 6}, {0, 1, 5}, {0, 5, 4},
                {2, 6, 7}, {2, 7, 3}, {0, 4, 6}, {0, 6, 2}, {1, 3, 7}, {1, 7, 5}};
  return mesh;
}

void append(Mesh& mesh, const Mesh& part, const Transform& mesh_from_part) {
  const int first = static_cast<int>(mesh.vertices.size());
  for (const Vec3d& v : part.vertices) mesh.vertices.push_back(mesh_from_part * v);
  for (const Face& f : part.faces) mesh.faces.push_back({f[0] + first, f[1] + first, f[2] + first});
}

Laplacian::Laplacian(const Mesh& mesh) : neighbours_(mesh.vertices.size()) {
  for (const Face& f : mesh.faces)
    for (std::size_t k = 0; k < 3; ++k) {
      neighbours_[as_size(f[as_size(k)])].push_back(f[(k + 1) % 3]);
      neighbours_[as_size(f[(k + 1) % 3])].push_back(f[k]);
    }
  for (auto& list : neighbours_) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
  }
}

double Laplacian::energy(const std::vector<Vec3d>& vertices, double weight,
                         std::vector<Vec3d>& gradient) const {
  double energy = 0;
  for (std::size_t i = 0; i < neighbours_.size(); ++i) {
    const auto& around = neighbours_[i];
    if (around.empty()) continue;
    Vec3d mean = Vec3d::Zero();
    for (int j : around) mean += vertices[as_size(j)];
    mean /= static_cast<double>(around.size());
    const Vec3d delta = vertices[i] - mean;
    energy += delta.squaredNorm();
    gradient[i] += 2 * weight * delta;
    for (int j : around) gradient[as_size(j)] -= 2 * weight / static_cast<double>(around.size()) * delta;
  }
  return energy;
}

namespace {

/// Twice the area vector.
Vec3d area_vector(std::span<const Vec3d> corners) {
  Vec3d sum = Vec3d::Zero();
  for (std::size_t i = 0; i < corners.size(); ++i)
    sum += (corners[i] - corners[0]).cross(corners[(i + 1) % corners.size()] - corners[0]);
  return sum;
}

double turn(const Vec2d& a, const Vec2d& b, const Vec2d& c) {
  return cross(b - a, c - a);
}

/// A ring of corners in the plane, counter-clockwise, from which ears are cut.
class Ring {
 public:
  explicit Ring(std::vector<Vec2d> places) : places_(std::move(places)) {
    const int n = static_cast<int>(places_.size());
    for (int i = 0; i < n; ++i) {
      before_.push_back((i + n - 1) % n);
      after_.push_back((i + 1) % n);
    }
  }
  int before(int i) const { return before_[as_size(i)]; }
  int after(int i) const { return after_[as_size(i)]; }
  void take(int i) {
    after_[as_size(before(i))] = after(i);
    before_[as_size(after(i))] = before(i);
  }
  /// Whether the corner turns left and no other lies within the triangle with its neighbours.
  bool is_ear(int i) const {
    const int previous = before(i), next = after(i);
    const Vec2d &a = at(previous), &b = at(i), &c = at(next);
    if (!(turn(a, b, c) > 0)) return false;
    for (int k = after(next); k != previous; k = after(k)) {
      const Vec2d& p = at(k);
      // Skips left turns: if any corner lies within, so does one that does not turn left.
      if (turn(at(before(k)), p, at(after(k))) > 0 || p == a || p == b || p == c) continue;
      if (turn(a, b, p) >= 0 && turn(b, c, p) >= 0 && turn(c, a, p) >= 0) return false;
    }
    return true;
  }

 private:
  const Vec2d& at(int i) const { return places_[as_size(i)]; }

  std::vector<Vec2d> places_;
  std::vector<int> before_, after_;
};

}  // namespace

std::vector<std::array<int, 3>> triangulate_polygon(std::span<const Vec3d> corners) {
  const int n = static_cast<int>(corners.size());
  if (n < 3) return {};
  if (n == 3) return {{0, 1, 2}};
  // Projected along the axis with the largest area, from the side where it runs counter-clockwise.
  const Vec3d area = area_vector(corners);
  Eigen::Index along = 0;
  area.cwiseAbs().maxCoeff(&along);
  Eigen::Index right = (along + 1) % 3, up = (along + 2) % 3;
  if (area[along] < 0) std::swap(right, up);
  std::vector<Vec2d> places;
  for (const Vec3d& corner : corners) places.emplace_back(corner[right], corner[up]);
  Ring ring(std::move(places));
  std::vector<std::array<int, 3>> triangles;
  int at = 0, passed = 0;
  for (int left = n; left > 3;) {
    // Once every corner was tried there is no ear: cut any.
    if (passed < left && !ring.is_ear(at)) {
      at = ring.after(at);
      ++passed;
      continue;
    }
    const int next = ring.after(at);
    triangles.push_back({ring.before(at), at, next});
    ring.take(at);
    --left;
    passed = 0;
    at = ring.after(next);  // skips one: the next would make a fan of slivers
  }
  triangles.push_back({ring.before(at), at, ring.after(at)});
  return triangles;
}

}  // namespace mirage
