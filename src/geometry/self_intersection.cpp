#include "geometry/self_intersection.h"

#include <cmath>
#include <limits>

namespace mirage {
namespace {

using Triangle = std::array<Vec3d, 3>;

Triangle corners(const Mesh& mesh, int face) {
  const Face& f = mesh.faces[static_cast<std::size_t>(face)];
  return {mesh.vertices[static_cast<std::size_t>(f[0])], mesh.vertices[static_cast<std::size_t>(f[1])],
          mesh.vertices[static_cast<std::size_t>(f[2])]};
}

/// Where the line a + t · d meets the triangle's inside (Möller and Trumbore, 1997); NaN where it does not.
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
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k)
      if (first[i] == second[k]) same[static_cast<std::size_t>(i)] = k;
  return same;
}

/// Two faces with a common edge lie on each other when their outward sides look at each other.
bool folded(const Triangle& first, const Triangle& second) {
  const Vec3d n1 = (first[1] - first[0]).cross(first[2] - first[0]),
              n2 = (second[1] - second[0]).cross(second[2] - second[0]);
  return n1.dot(n2) < -(1 - 1e-9) * n1.norm() * n2.norm();
}

bool cut(const Mesh& mesh, int first, int second) {
  const Triangle a = corners(mesh, first), b = corners(mesh, second);
  const std::array<int, 3> same =
      common(mesh.faces[static_cast<std::size_t>(first)], mesh.faces[static_cast<std::size_t>(second)]);
  int shared = 0;
  std::array<bool, 3> in_b = {};
  for (const int k : same)
    if (k >= 0) {
      ++shared;
      in_b[static_cast<std::size_t>(k)] = true;
    }
  if (shared >= 2) return folded(a, b);
  for (std::size_t i = 0; i < 3; ++i) {
    const std::size_t next = (i + 1) % 3;
    if (same[i] < 0 && same[next] < 0 && passes(b, a[i], a[next])) return true;
    if (!in_b[i] && !in_b[next] && passes(a, b[i], b[next])) return true;
  }
  return false;
}

}  // namespace

std::vector<std::array<int, 2>> intersecting_faces(const Mesh& mesh) {
  const int faces = static_cast<int>(mesh.faces.size());
  std::vector<Eigen::AlignedBox3d> boxes(mesh.faces.size());
  for (int f = 0; f < faces; ++f)
    for (const Vec3d& v : corners(mesh, f)) boxes[static_cast<std::size_t>(f)].extend(v);
  std::vector<std::array<int, 2>> pairs;
  for (int i = 0; i < faces; ++i)
    for (int k = i + 1; k < faces; ++k)
      if (boxes[static_cast<std::size_t>(i)].intersects(boxes[static_cast<std::size_t>(k)]) &&
          cut(mesh, i, k))
        pairs.push_back({i, k});
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
    Wall& wall = result[static_cast<std::size_t>(f)];
    for (const Vec3d& from :
         {middle, Vec3d((middle + t[0]) / 2), Vec3d((middle + t[1]) / 2), Vec3d((middle + t[2]) / 2)})
      for (int k = 0; k < faces; ++k) {
        if (k == f) continue;
        const double distance = meets(corners(mesh, k), from, inwards);
        if (distance >= 0 && distance < wall.thickness) wall = {distance, k};
      }
  }
  return result;
}

}  // namespace mirage
