#include "geometry/edges.h"

#include <algorithm>

namespace mirage {

std::vector<MeshEdge> edges_of(const Mesh& mesh) {
  std::vector<std::array<int, 3>> sides;  // ends, face
  for (std::size_t f = 0; f < mesh.faces.size(); ++f)
    for (std::size_t k = 0; k < 3; ++k) {
      const auto [a, b] = std::minmax(mesh.faces[f][k], mesh.faces[f][(k + 1) % 3]);
      if (a != b) sides.push_back({a, b, static_cast<int>(f)});
    }
  std::sort(sides.begin(), sides.end());
  std::vector<MeshEdge> edges;
  for (const auto& [a, b, face] : sides) {
    const std::array<int, 2> ends = {a, b};
    if (edges.empty() || edges.back().vertices != ends) edges.push_back({ends, {}});
    edges.back().faces.push_back(face);
  }
  return edges;
}

}  // namespace mirage
