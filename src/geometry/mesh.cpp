#include "geometry/mesh.h"

#include <fmt/format.h>

#include <map>
#include <utility>

#include "base/error.h"

namespace mirage {

void check_mesh(const TexturedMesh& textured, const std::string& where) {
  const auto& [mesh, atlas] = textured;
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i)
    if (!mesh.vertices[i].allFinite())
      throw InputError(where, fmt::format("vertex {}", i), "not finite", "repair the mesh before using it");
  for (std::size_t f = 0; f < mesh.faces.size(); ++f)
    for (int index : mesh.faces[f])
      if (index < 0 || static_cast<std::size_t>(index) >= mesh.vertices.size())
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
  for (const Face& f : mesh.faces)
    normals.push_back(
        (mesh.vertices[f[1]] - mesh.vertices[f[0]]).cross(mesh.vertices[f[2]] - mesh.vertices[f[0]]));
  return normals;
}

double signed_volume(const Mesh& mesh) {
  double six = 0;
  for (const Face& f : mesh.faces)
    six += mesh.vertices[f[0]].dot(mesh.vertices[f[1]].cross(mesh.vertices[f[2]]));
  return six / 6;
}

bool is_watertight(const Mesh& mesh) {
  std::map<std::pair<int, int>, int> edges;
  for (const Face& f : mesh.faces)
    for (int k = 0; k < 3; ++k) ++edges[{f[k], f[(k + 1) % 3]}];
  for (const auto& [edge, count] : edges) {
    const auto opposite = edges.find({edge.second, edge.first});
    if (count != 1 || opposite == edges.end() || opposite->second != 1) return false;
  }
  return !edges.empty();
}

std::vector<std::size_t> used_vertices(const Mesh& mesh) {
  std::vector<bool> used(mesh.vertices.size(), false);
  for (const Face& f : mesh.faces)
    for (const int corner : f) used[static_cast<std::size_t>(corner)] = true;
  std::vector<std::size_t> indices;
  indices.reserve(used.size());
  for (std::size_t i = 0; i < used.size(); ++i)
    if (used[i]) indices.push_back(i);
  return indices;
}

Eigen::AlignedBox3d bounds(const Mesh& mesh) {
  Eigen::AlignedBox3d box;
  for (const Face& f : mesh.faces)
    for (const int corner : f) box.extend(mesh.vertices[static_cast<std::size_t>(corner)]);
  if (mesh.faces.empty()) box.extend(Vec3d::Zero());
  return box;
}

}  // namespace mirage
