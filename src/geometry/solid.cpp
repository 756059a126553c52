#include "geometry/solid.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace mirage {

GridCell cell_at(const GridLayout& layout, const Vec3d& p) {
  GridCell cell;
  int low[3];
  double t[3];
  bool moved[3];
  Vec3d away = Vec3d::Zero();
  for (int a = 0; a < 3; ++a) {
    const double place = (p[a] - layout.origin[a]) / layout.spacing[a];
    const double kept = std::clamp(place, 0.0, static_cast<double>(layout.count[as_size(a)] - 1));
    low[a] = std::min(static_cast<int>(kept), layout.count[as_size(a)] - 2);
    t[a] = kept - low[a];
    moved[a] = kept != place;
    away[a] = (place - kept) * layout.spacing[a];
  }
  cell.outside = away.norm();
  for (int corner = 0; corner < 8; ++corner) {
    double w[3], slope[3];
    for (int a = 0; a < 3; ++a) {
      const bool high = corner >> a & 1;
      w[a] = high ? t[a] : 1 - t[a];
      slope[a] = moved[a] ? 0 : (high ? 1 : -1) / layout.spacing[a];
    }
    cell.nodes[as_size(corner)] =
        layout.index(low[0] + (corner & 1), low[1] + (corner >> 1 & 1), low[2] + (corner >> 2 & 1));
    cell.weights[as_size(corner)] = w[0] * w[1] * w[2];
    cell.gradients[as_size(corner)] = {slope[0] * w[1] * w[2], w[0] * slope[1] * w[2],
                                       w[0] * w[1] * slope[2]};
  }
  return cell;
}

double DistanceGrid::at(const Vec3d& p) const {
  const GridCell cell = cell_at(layout, p);
  double value = cell.outside;
  for (std::size_t corner = 0; corner < 8; ++corner)
    value += cell.weights[corner] * values[cell.nodes[corner]];
  return value;
}

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

namespace {

using Triangle = std::array<Vec3d, 3>;

Triangle corners(const Mesh& mesh, int face) {
  return mesh.corners(mesh.faces[as_size(face)]);
}

/// t where the line a + t · d meets the triangle's inside (Möller and Trumbore, 1997); NaN if it misses.
double meets(const Triangle& triangle, const Vec3d& a, const Vec3d& d) {
  const Vec3d e1 = triangle[1] - triangle[0], e2 = triangle[2] - triangle[0], p = d.cross(e2);
  const double determinant = e1.dot(p), nothing = std::numeric_limits<double>::quiet_NaN();
  if (std::abs(determinant) <= 1e-14 * e1.norm() * e2.norm() * d.norm()) return nothing;
  const Vec3d s = a - triangle[0], q = s.cross(e1);
  const double u = s.dot(p) / determinant, v = d.dot(q) / determinant;
  if (u < 0 || v < 0 || u + v > 1) return nothing;
  return e2.dot(q) / determinant;
}

bool passes(const Triangle& triangle, const Vec3d& a, const Vec3d& b) {
  const double t = meets(triangle, a, b - a);
  constexpr double kTouch = 1e-9;
  return t > kTouch && t < 1 - kTouch;
}

/// For each corner of `first` the index of the same vertex in `second`, or −1.
std::array<int, 3> common(const Face& first, const Face& second) {
  std::array<int, 3> same = {-1, -1, -1};
  for (std::size_t i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k)
      if (first[i] == second[as_size(k)]) same[i] = k;
  return same;
}

/// The corner (0 to 2) of f off the edge that it shares with k; −1 if they share no edge.
int apex_over_neighbour(const Face& f, const Face& k) {
  const std::array<int, 3> same = common(f, k);
  if (std::ranges::count(same, -1) != 1) return -1;
  return static_cast<int>(std::ranges::find(same, -1) - same.begin());
}

/// Whether two faces with a common edge lie flat on each other, outward sides facing.
bool folded(const Triangle& first, const Triangle& second) {
  const Vec3d n1 = (first[1] - first[0]).cross(first[2] - first[0]),
              n2 = (second[1] - second[0]).cross(second[2] - second[0]);
  return n1.dot(n2) < -(1 - 1e-9) * n1.norm() * n2.norm();
}

bool cut(const Mesh& mesh, int first, int second) {
  const Triangle a = corners(mesh, first), b = corners(mesh, second);
  const std::array<int, 3> same = common(mesh.faces[as_size(first)], mesh.faces[as_size(second)]);
  if (std::ranges::count(same, -1) <= 1) return folded(a, b);
  const auto in_a = [&](std::size_t k) { return std::ranges::find(same, static_cast<int>(k)) != same.end(); };
  for (std::size_t i = 0; i < 3; ++i) {
    const std::size_t next = (i + 1) % 3;
    if (same[i] < 0 && same[next] < 0 && passes(b, a[i], a[next])) return true;
    if (!in_a(i) && !in_a(next) && passes(a, b[i], b[next])) return true;
  }
  return false;
}

constexpr int kLeaf = 8;
// A cluster counts as one dipole from this many of its radii on.
constexpr double kFar = 2.3;

// Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 1983.
double solid_angle(const std::array<Vec3d, 3>& face, const Vec3d& p) {
  const Vec3d a = face[0] - p, b = face[1] - p, c = face[2] - p;
  const double la = a.norm(), lb = b.norm(), lc = c.norm();
  const double over = a.dot(b.cross(c));
  const double under = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
  if (over == 0 && under <= 0) return 0;  // p lies in the face: half inside, half outside
  return 2 * std::atan2(over, under);
}

constexpr double kMargin = 1e-3;  // of an edge

// Corner c of a cube stands at (c & 1, c >> 1 & 1, c >> 2 & 1). Edge 4a + n runs along axis a.
struct Edge {
  int from, axis;
};

std::array<Edge, 12> cube_edges() {
  std::array<Edge, 12> edges{};
  for (int a = 0; a < 3; ++a)
    for (int c = 0, n = 0; c < 8; ++c)
      if (!(c >> a & 1)) edges[as_size(4 * a + n++)] = {c, a};
  return edges;
}

int edge_between(const std::array<Edge, 12>& edges, int c, int d) {
  for (int e = 0; e < 12; ++e)
    if (edges[as_size(e)].from == std::min(c, d) &&
        (edges[as_size(e)].from | 1 << edges[as_size(e)].axis) == std::max(c, d))
      return e;
  return -1;
}

// Corners of the face across `axis` at `side`, counter-clockwise seen from outside the cube.
std::array<int, 4> face_corners(int axis, int side) {
  const int u = 1 << (axis + 1) % 3, v = 1 << (axis + 2) % 3, base = side << axis;
  if (side) return {base, base | u, base | u | v, base | v};
  return {base, base | v, base | u | v, base | u};
}

// Polygons of a case as loops of edges, and their triangles. A loop whose every triangulation has a diagonal
// within a face gets a vertex in its middle.
struct Case {
  std::vector<std::array<int, 3>> triangles;  // edges of the cube
  std::vector<std::vector<int>> fans;         // loops to be joined to their middle
};

class CaseTable {
 public:
  CaseTable() : edges_(cube_edges()) {
    for (int code = 0; code < 256; ++code) cases_[as_size(code)] = derive(code);
  }
  const Case& operator[](int code) const { return cases_[as_size(code)]; }
  const std::array<Edge, 12>& edges() const { return edges_; }

 private:
  // Whether two edges of the cube lie in one of its faces.
  bool share_face(int e, int f) const {
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side) {
        const auto in = [&](int edge) {
          return edges_[as_size(edge)].axis != axis && (edges_[as_size(edge)].from >> axis & 1) == side;
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
      if (mid - low > 1 && share_face(loop[as_size(low)], loop[as_size(mid)])) continue;
      if (high - mid > 1 && share_face(loop[as_size(mid)], loop[as_size(high)])) continue;
      const std::size_t before = out.size();
      out.push_back({loop[as_size(low)], loop[as_size(mid)], loop[as_size(high)]});
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
          next[as_size(edge_between(edges_, q[(i + 3) & 3], q[as_size(i)]))] =
              edge_between(edges_, q[j & 3], q[(j + 1) & 3]);
        }
      }
    Case result;
    std::array<bool, 12> used{};
    for (int start = 0; start < 12; ++start) {
      if (next[as_size(start)] < 0 || used[as_size(start)]) continue;
      std::vector<int> loop;
      for (int e = start; !used[as_size(e)]; e = next[as_size(e)]) {
        used[as_size(e)] = true;
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

std::vector<std::array<int, 2>> intersecting_faces(const Mesh& mesh) {
  const int faces = static_cast<int>(mesh.faces.size());
  std::vector<Eigen::AlignedBox3d> boxes(mesh.faces.size());
  for (int f = 0; f < faces; ++f)
    for (const Vec3d& v : corners(mesh, f)) boxes[as_size(f)].extend(v);
  std::vector<std::array<int, 2>> pairs;
  for (int i = 0; i < faces; ++i)
    for (int k = i + 1; k < faces; ++k)
      if (boxes[as_size(i)].intersects(boxes[as_size(k)]) && cut(mesh, i, k)) pairs.push_back({i, k});
  return pairs;
}

std::vector<Wall> walls(const Mesh& mesh) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const int faces = static_cast<int>(mesh.faces.size());
  std::vector<Wall> result(mesh.faces.size(), Wall{kInfinity, -1});
  for (int f = 0; f < faces; ++f) {
    const Triangle t = corners(mesh, f);
    const Vec3d normal = (t[1] - t[0]).cross(t[2] - t[0]);
    if (!(normal.norm() > 0)) continue;
    const Vec3d inwards = -normal.normalized(), middle = (t[0] + t[1] + t[2]) / 3;
    Wall& wall = result[as_size(f)];
    const std::array<Vec3d, 4> samples = {middle, (middle + t[0]) / 2, (middle + t[1]) / 2,
                                          (middle + t[2]) / 2};
    for (int k = 0; k < faces; ++k) {
      if (k == f) continue;
      const int apex = apex_over_neighbour(mesh.faces[as_size(f)], mesh.faces[as_size(k)]);
      for (int s = 0; s < 4; ++s) {
        if (apex >= 0 && s > 0 && s - 1 != apex) continue;  // beside the edge
        const double distance = meets(corners(mesh, k), samples[as_size(s)], inwards);
        if (distance >= 0 && distance < wall.thickness) wall = {distance, k};
      }
    }
  }
  return result;
}

WindingNumber::WindingNumber(const Mesh& mesh) {
  faces_.reserve(mesh.faces.size());
  for (const Face& f : mesh.faces) faces_.push_back(mesh.corners(f));
  if (!faces_.empty()) build(0, static_cast<int>(faces_.size()));
}

int WindingNumber::build(int first, int count) {
  const int index = static_cast<int>(nodes_.size());
  nodes_.emplace_back();
  Node node;
  node.first = first;
  node.count = count;
  Eigen::AlignedBox3d centres;
  double total = 0;
  for (int f = first; f < first + count; ++f) {
    const auto& [a, b, c] = faces_[as_size(f)];
    const Vec3d area = 0.5 * (b - a).cross(c - a), middle = (a + b + c) / 3;
    node.area += area;
    node.centre += area.norm() * middle;
    total += area.norm();
    centres.extend(middle);
  }
  node.centre = total > 0 ? Vec3d(node.centre / total) : Vec3d(centres.center());
  for (int f = first; f < first + count; ++f)
    for (const Vec3d& v : faces_[as_size(f)]) node.radius = std::max(node.radius, (v - node.centre).norm());
  if (count > kLeaf) {
    int axis = 0;
    centres.sizes().maxCoeff(&axis);
    const int half = count / 2;
    const auto place = [&](const std::array<Vec3d, 3>& f) { return f[0][axis] + f[1][axis] + f[2][axis]; };
    std::nth_element(faces_.begin() + first, faces_.begin() + first + half, faces_.begin() + first + count,
                     [&](const auto& a, const auto& b) { return place(a) < place(b); });
    node.left = build(first, half);
    node.right = build(first + half, count - half);
  }
  nodes_[as_size(index)] = node;
  return index;
}

double WindingNumber::at(const Vec3d& p, bool exact) const {
  if (nodes_.empty()) return 0;
  double sum = 0;
  int stack[64], size = 0;
  stack[size++] = 0;
  while (size > 0) {
    const Node& node = nodes_[as_size(stack[--size])];
    const Vec3d r = node.centre - p;
    const double distance = r.norm();
    if (!exact && distance > kFar * node.radius) {
      sum += node.area.dot(r) / (distance * distance * distance);
    } else if (node.left < 0) {
      for (int f = node.first; f < node.first + node.count; ++f) sum += solid_angle(faces_[as_size(f)], p);
    } else {
      stack[size++] = node.left;
      stack[size++] = node.right;
    }
  }
  return sum / (4 * std::numbers::pi);
}

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
          const auto [from, axis] = table.edges()[as_size(e)];
          const int x = i + (from & 1), y = j + (from >> 1 & 1), z = k + (from >> 2 & 1);
          int& place = vertex_of[3 * at.index(x, y, z) + as_size(axis)];
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
            middle += mesh.vertices[as_size(ring.back())] / static_cast<double>(loop.size());
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
