#include "geometry/shapes.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

namespace mirage {

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
        const Vec3d point = (mesh.vertices[a] + mesh.vertices[b]).normalized();
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

}  // namespace mirage
