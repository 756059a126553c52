#include "exchange/polygons.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

#include "base/error.h"
#include "base/interrupt.h"
#include "geometry/polygon.h"

namespace mirage {

void check_corners(double count, std::size_t face, const std::string& where) {
  if (!(count >= 1 && count <= kMostCorners && count == std::floor(count)))
    throw InputError(where, fmt::format("face {}", face),
                     fmt::format("has {:g} corners, not 1 to {}", count, kMostCorners),
                     "cut its polygons into triangles");
}

void check_corner(double vertex, std::size_t count, std::size_t face, const std::string& where) {
  if (!(vertex >= 0 && vertex < static_cast<double>(count) && vertex == std::floor(vertex)))
    throw InputError(where, fmt::format("face {}", face),
                     fmt::format("names vertex {:g} of {}", vertex, count), "export the mesh again");
}

Mesh triangulated(const Polygons& polygons, const std::string& where) {
  Mesh mesh{polygons.vertices, {}};
  std::size_t work = 0;
  std::vector<Vec3d> corners;
  for (std::size_t f = 0; f < polygons.face_count(); ++f) {
    const std::span<const int> polygon = polygons.face(f);
    if (polygon.size() == 3) {
      mesh.faces.push_back({polygon[0], polygon[1], polygon[2]});
      continue;
    }
    throw_if_interrupted("nothing was written");
    if (polygon.size() > 4 && (work += polygon.size() * polygon.size()) > kMostCutting)
      throw InputError(where, "faces", "are too many of too many corners", "cut its polygons into triangles");
    corners.clear();
    for (const int corner : polygon) corners.push_back(polygons.vertices[static_cast<std::size_t>(corner)]);
    for (const auto& [a, b, c] : cut_polygon(corners))
      mesh.faces.push_back({polygon[static_cast<std::size_t>(a)], polygon[static_cast<std::size_t>(b)],
                            polygon[static_cast<std::size_t>(c)]});
  }
  return mesh;
}

Mesh joined(const Mesh& mesh) {
  const auto place = [&](std::size_t v) {
    const Vec3d& p = mesh.vertices[v];
    return std::tuple(p.x(), p.y(), p.z());
  };
  std::vector<std::size_t> order(mesh.vertices.size()), first(mesh.vertices.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return place(a) < place(b); });
  for (std::size_t i = 0; i < order.size(); ++i)
    first[order[i]] = i > 0 && place(order[i - 1]) == place(order[i]) ? first[order[i - 1]] : order[i];
  Mesh result;
  std::vector<int> number(mesh.vertices.size(), -1);
  for (const Face& face : mesh.faces) {
    std::array<std::size_t, 3> corners;
    for (std::size_t k = 0; k < 3; ++k) corners[k] = first[static_cast<std::size_t>(face[k])];
    if (corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0]) continue;
    Face& kept = result.faces.emplace_back();
    for (std::size_t k = 0; k < 3; ++k) {
      int& own = number[corners[k]];
      if (own < 0) {
        own = static_cast<int>(result.vertices.size());
        result.vertices.push_back(mesh.vertices[corners[k]]);
      }
      kept[k] = own;
    }
  }
  return result;
}

}  // namespace mirage
