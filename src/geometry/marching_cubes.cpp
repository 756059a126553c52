#include "geometry/marching_cubes.h"

#include <algorithm>
#include <limits>

namespace mirage {
namespace {

constexpr double kMargin = 1e-3;  // of an edge

// Corner c of a cube stands at (c & 1, c >> 1 & 1, c >> 2 & 1). Edge 4a + n runs along axis a.
struct Edge {
  int from, axis;
};

std::array<Edge, 12> cube_edges() {
  std::array<Edge, 12> edges{};
  for (int a = 0; a < 3; ++a)
    for (int c = 0, n = 0; c < 8; ++c)
      if (!(c >> a & 1)) edges[4 * a + n++] = {c, a};
  return edges;
}

int edge_between(const std::array<Edge, 12>& edges, int c, int d) {
  for (int e = 0; e < 12; ++e)
    if (edges[e].from == std::min(c, d) && (edges[e].from | 1 << edges[e].axis) == std::max(c, d)) return e;
  return -1;
}

// Corners of the face across `axis` at `side`, counter-clockwise seen from outside the cube.
std::array<int, 4> face_corners(int axis, int side) {
  const int u = 1 << (axis + 1) % 3, v = 1 << (axis + 2) % 3, base = side << axis;
  if (side) return {base, base | u, base | u | v, base | v};
  return {base, base | v, base | u | v, base | u};
}

// Polygons of a case as loops of edges, and their triangles. A loop that has no triangulation free of
// diagonals within a face gets a vertex in its middle.
struct Case {
  std::vector<std::array<int, 3>> triangles;  // edges of the cube
  std::vector<std::vector<int>> fans;         // loops to be joined to their middle
};

class CaseTable {
 public:
  CaseTable() : edges_(cube_edges()) {
    for (int code = 0; code < 256; ++code) cases_[code] = derive(code);
  }
  const Case& operator[](int code) const { return cases_[code]; }
  const std::array<Edge, 12>& edges() const { return edges_; }

 private:
  // Whether two edges of the cube lie in one of its faces.
  bool share_face(int e, int f) const {
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side) {
        const auto in = [&](int edge) {
          return edges_[edge].axis != axis && (edges_[edge].from >> axis & 1) == side;
        };
        if (in(e) && in(f)) return true;
      }
    return false;
  }

  // Triangles of loop[low … high], whose side low–high is settled already.
  bool triangulate(const std::vector<int>& loop, int low, int high,
                   std::vector<std::array<int, 3>>& out) const {
    if (high - low < 2) return true;
    for (int mid = low + 1; mid < high; ++mid) {
      if (mid - low > 1 && share_face(loop[low], loop[mid])) continue;
      if (high - mid > 1 && share_face(loop[mid], loop[high])) continue;
      const std::size_t before = out.size();
      out.push_back({loop[low], loop[mid], loop[high]});
      if (triangulate(loop, low, mid, out) && triangulate(loop, mid, high, out)) return true;
      out.resize(before);
    }
    return false;
  }

  Case derive(int code) const {
    // next[e]: the surface's outline on a cube face runs from where the face's border enters the body to
    // where it leaves it again.
    std::array<int, 12> next;
    next.fill(-1);
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side) {
        const auto q = face_corners(axis, side);
        const auto inside = [&](int i) { return (code >> q[i & 3] & 1) != 0; };
        for (int i = 0; i < 4; ++i) {
          if (!inside(i) || inside(i + 3)) continue;
          int j = i;
          while (inside(j + 1)) ++j;
          next[edge_between(edges_, q[(i + 3) & 3], q[i])] = edge_between(edges_, q[j & 3], q[(j + 1) & 3]);
        }
      }
    Case result;
    std::array<bool, 12> used{};
    for (int start = 0; start < 12; ++start) {
      if (next[start] < 0 || used[start]) continue;
      std::vector<int> loop;
      for (int e = start; !used[e]; e = next[e]) {
        used[e] = true;
        loop.push_back(e);
      }
      if (!triangulate(loop, 0, static_cast<int>(loop.size()) - 1, result.triangles))
        result.fans.push_back(loop);
    }
    return result;
  }

  std::array<Edge, 12> edges_;
  std::array<Case, 256> cases_;
};

}  // namespace

Mesh marching_cubes(const DistanceGrid& grid) {
  static const CaseTable table;
  const GridLayout& at = grid.layout;
  // Not as a structured binding: clang 14 lets no lambda use one.
  const int nx = at.count[0], ny = at.count[1], nz = at.count[2];
  const auto value = [&](int i, int j, int k) -> double {
    const bool border = i == 0 || j == 0 || k == 0 || i == nx - 1 || j == ny - 1 || k == nz - 1;
    const double v = grid.values[at.index(i, j, k)];
    return border ? std::max(v, std::numeric_limits<double>::min()) : v;
  };
  Mesh mesh;
  std::vector<int> vertex_of(3 * at.size(), -1);  // the vertex on the edge that leaves a node along an axis
  for (int k = 0; k + 1 < nz; ++k)
    for (int j = 0; j + 1 < ny; ++j)
      for (int i = 0; i + 1 < nx; ++i) {
        double corner[8];
        int code = 0;
        for (int c = 0; c < 8; ++c) {
          corner[c] = value(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2 & 1));
          code |= (corner[c] < 0) << c;
        }
        if (code == 0 || code == 255) continue;
        const auto vertex = [&](int e) {
          const auto [from, axis] = table.edges()[e];
          const int x = i + (from & 1), y = j + (from >> 1 & 1), z = k + (from >> 2 & 1);
          int& place = vertex_of[3 * at.index(x, y, z) + axis];
          if (place < 0) {
            const double a = corner[from], b = corner[from | 1 << axis];
            Vec3d p = at.node(x, y, z);
            p[axis] += at.spacing[axis] * std::clamp(a / (a - b), kMargin, 1 - kMargin);
            place = static_cast<int>(mesh.vertices.size());
            mesh.vertices.push_back(p);
          }
          return place;
        };
        for (const auto& [a, b, c] : table[code].triangles)
          mesh.faces.push_back({vertex(a), vertex(b), vertex(c)});
        for (const std::vector<int>& loop : table[code].fans) {
          std::vector<int> ring;
          Vec3d middle = Vec3d::Zero();
          for (int e : loop) {
            ring.push_back(vertex(e));
            middle += mesh.vertices[ring.back()] / static_cast<double>(loop.size());
          }
          const int centre = static_cast<int>(mesh.vertices.size());
          mesh.vertices.push_back(middle);
          for (std::size_t r = 0; r < ring.size(); ++r)
            mesh.faces.push_back({ring[r], ring[(r + 1) % ring.size()], centre});
        }
      }
  return mesh;
}

}  // namespace mirage
