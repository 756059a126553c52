// The edges of a mesh, and the faces that meet there.
#pragma once

#include <array>
#include <vector>

#include "geometry/mesh.h"

namespace mirage {

/// An edge of one face or more.
struct MeshEdge {
  std::array<int, 2> vertices;  ///< the smaller first
  std::vector<int> faces;       ///< rising
};

/// By rising vertices, each once. A side of a face whose two ends are one vertex is none.
std::vector<MeshEdge> edges_of(const Mesh& mesh);

}  // namespace mirage
