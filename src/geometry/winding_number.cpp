#include "geometry/winding_number.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace mirage {
namespace {

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

}  // namespace

WindingNumber::WindingNumber(const Mesh& mesh) {
  faces_.reserve(mesh.faces.size());
  for (const Face& f : mesh.faces)
    faces_.push_back({mesh.vertices[f[0]], mesh.vertices[f[1]], mesh.vertices[f[2]]});
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
    const auto& [a, b, c] = faces_[f];
    const Vec3d area = 0.5 * (b - a).cross(c - a), middle = (a + b + c) / 3;
    node.area += area;
    node.centre += area.norm() * middle;
    total += area.norm();
    centres.extend(middle);
  }
  node.centre = total > 0 ? Vec3d(node.centre / total) : Vec3d(centres.center());
  for (int f = first; f < first + count; ++f)
    for (const Vec3d& v : faces_[f]) node.radius = std::max(node.radius, (v - node.centre).norm());
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
  nodes_[index] = node;
  return index;
}

double WindingNumber::at(const Vec3d& p, bool exact) const {
  if (nodes_.empty()) return 0;
  double sum = 0;
  int stack[64], size = 0;
  stack[size++] = 0;
  while (size > 0) {
    const Node& node = nodes_[stack[--size]];
    const Vec3d r = node.centre - p;
    const double distance = r.norm();
    if (!exact && distance > kFar * node.radius) {
      sum += node.area.dot(r) / (distance * distance * distance);
    } else if (node.left < 0) {
      for (int f = node.first; f < node.first + node.count; ++f) sum += solid_angle(faces_[f], p);
    } else {
      stack[size++] = node.left;
      stack[size++] = node.right;
    }
  }
  return sum / (4 * std::numbers::pi);
}

}  // namespace mirage
