#include "sensors/coverage/visible.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace mirage::coverage {
namespace {

/// Appends the part of the polygon where sign · distance ≥ 0.
Polygon part(Pool& pool, const Polygon& polygon, double sign, double slack, const Side& cut) {
  Polygon result{static_cast<int>(pool.corners.size()), 0};
  const auto place = [&](int i) {
    const double d = sign * pool.distances[as_size(i)];
    return d > slack ? 1 : d < -slack ? -1 : 0;
  };
  for (int i = 0; i < polygon.count; ++i) {
    const int next = i + 1 < polygon.count ? i + 1 : 0, here = place(i), there = place(next);
    const Corner corner = pool.corner(polygon, i);
    if (here >= 0) pool.corners.push_back({corner.p, here == 0 && there < 0 ? cut : corner.side});
    if (here * there >= 0) continue;
    const double a = pool.distances[as_size(i)], b = pool.distances[as_size(next)];
    // From the end with the lower distance, so that both parts get the same point.
    const Vec2d to = pool.corner(polygon, next).p;
    const Vec2d p =
        a < b ? Vec2d(corner.p + a / (a - b) * (to - corner.p)) : Vec2d(to + b / (b - a) * (corner.p - to));
    pool.corners.push_back({p, here > 0 ? cut : corner.side});
  }
  result.count = static_cast<int>(pool.corners.size()) - result.first;
  return result;
}

constexpr double kRounding = 64 * std::numeric_limits<double>::epsilon();

/// False for a face that covers nothing.
bool set_up(const std::array<Vec3d, 3>& corners, int width, int height, const PixelRect& window,
            ScreenFace& face) {
  const double half = std::max(width, height) / 2.0;
  for (int k = 0; k < 3; ++k) {
    const Vec3d& v = corners[as_size(k)];
    if (!v.allFinite() || !(v.z() > 0)) return false;
    face.s[k] = Vec2d(v.x() * half + width / 2.0 - window.u0, height / 2.0 - v.y() * half - window.v0);
    face.z[k] = v.z();
    face.corner[k] = k;
  }
  double twice_area = cross(face.s[1] - face.s[0], face.s[2] - face.s[0]);
  if (twice_area < 0) {
    std::swap(face.s[1], face.s[2]);
    std::swap(face.z[1], face.z[2]);
    std::swap(face.corner[1], face.corner[2]);
    twice_area = -twice_area;
  }
  double length[3], longest = 0, reach = 1;
  for (int k = 0; k < 3; ++k) {
    length[k] = (face.s[(k + 1) % 3] - face.s[k]).norm();
    longest = std::max(longest, length[k]);
    reach = std::max(reach, face.s[k].cwiseAbs().maxCoeff());
  }
  face.slack = kRounding * reach;
  // Also refuses NaN, from coordinates that overflow.
  if (!(twice_area > std::max(kNoArea * half, face.slack) * longest)) return false;
  if (!std::isfinite(twice_area)) return false;
  face.slope.setZero();
  for (int k = 0; k < 3; ++k) {
    const Vec2d e = (face.s[(k + 1) % 3] - face.s[k]) / length[k];
    face.normal[k] = Vec2d(-e.y(), e.x());
    face.inv_altitude[k] = length[k] / twice_area;
    face.inv_z[k] = 1 / face.z[k];
  }
  // Over two edges from one corner, so that a face of constant depth has slope 0.
  for (int k = 1; k < 3; ++k)
    face.slope += (face.inv_z[k] - face.inv_z[0]) * face.inv_altitude[(k + 1) % 3] * face.normal[(k + 1) % 3];
  face.nearest = *std::max_element(face.inv_z, face.inv_z + 3);
  face.farthest = *std::min_element(face.inv_z, face.inv_z + 3);
  face.low = face.s[0].cwiseMin(face.s[1]).cwiseMin(face.s[2]);
  face.high = face.s[0].cwiseMax(face.s[1]).cwiseMax(face.s[2]);
  return std::isfinite(face.nearest) && face.slope.allFinite();
}

/// Whether an edge of `a` has all of `b` on its outer side.
bool separates(const ScreenFace& a, const ScreenFace& b, double slack) {
  for (int k = 0; k < 3; ++k) {
    bool outside = true;
    for (int j = 0; j < 3 && outside; ++j) outside = a.normal[k].dot(b.s[j] - a.s[k]) <= slack;
    if (outside) return true;
  }
  return false;
}

/// The overlap of two triangles.
struct Overlap {
  Vec2d p[12];
  int count = 0;
};

void overlap(const ScreenFace& a, const ScreenFace& b, Overlap& result) {
  Overlap before;
  result.count = 3;
  std::copy(a.s, a.s + 3, result.p);
  for (int k = 0; k < 3 && result.count > 0; ++k) {
    before = result;
    result.count = 0;
    const auto distance = [&](int i) { return b.normal[k].dot(before.p[i] - b.s[k]); };
    for (int i = 0; i < before.count; ++i) {
      const int next = (i + 1) % before.count;
      const double here = distance(i), there = distance(next);
      if (here >= 0) result.p[result.count++] = before.p[i];
      if ((here >= 0) != (there >= 0))
        result.p[result.count++] = before.p[i] + here / (here - there) * (before.p[next] - before.p[i]);
    }
  }
}

int shared_corners(const ScreenFace& a, const ScreenFace& b) {
  int count = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      if (a.s[i] == b.s[j] && a.z[i] == b.z[j]) {
        ++count;
        break;
      }
  return count;
}

enum class Order { apart, first, second, crossing };

/// Order of two faces in their overlap; if they cross, b is in front where `line` is positive.
Order order_of(const ScreenFace& a, const ScreenFace& b, Line& line) {
  const double slack = std::max(a.slack, b.slack);
  if (separates(a, b, slack) || separates(b, a, slack)) return Order::apart;
  const Order tie = a.face < b.face ? Order::first : Order::second;
  if (a.farthest > b.nearest) return Order::first;
  if (b.farthest > a.nearest) return Order::second;
  Overlap common;
  overlap(a, b, common);
  double low = 0, high = 0;  // of 1/z_b − 1/z_a
  for (int i = 0; i < common.count; ++i) {
    const double d = b.inv_depth(common.p[i]) - a.inv_depth(common.p[i]);
    low = std::min(low, d);
    high = std::max(high, d);
  }
  const double tolerance =
      slack * (a.slope.norm() + b.slope.norm()) + kRounding * std::max(a.nearest, b.nearest);
  // Neighbours meet at their edge and nowhere else.
  const bool neighbours = shared_corners(a, b) >= 2;
  if (high <= tolerance && low >= -tolerance) return tie;
  if (high <= tolerance || (neighbours && -low > high)) return Order::first;
  if (low >= -tolerance || neighbours) return Order::second;
  const Vec2d slope = b.slope - a.slope;
  const double steep = slope.norm();
  if (!(steep > 0)) return tie;
  line.normal = slope / steep;
  // Through the point of the line nearest to the overlap's first corner.
  const Vec2d& from = common.p[0];
  line.through = from - (b.inv_depth(from) - a.inv_depth(from)) / steep * line.normal;
  line.slack = std::max(slack, tolerance / steep);
  return Order::crossing;
}

/// One face hides part of another.
struct Occlusion {
  int hidden = 0, by = 0;
  int line = -1;    ///< if they cross: hides only where this one of Occlusions::lines is positive
  double size = 0;  ///< of the overlap's bounding box: the largest first
};

struct Occlusions {
  std::vector<Occlusion> list;  ///< in order of discovery
  std::vector<Line> lines;
  std::vector<int> first;         ///< first entry of each hidden face in `sorted`, and the end
  std::vector<Occlusion> sorted;  ///< by the hidden face, the largest overlap first
  std::vector<int> cursor;        ///< scratch
};

/// Compares the two faces, i before j in the mesh, whose boxes have an overlap of `size`.
void find_occlusion(const std::vector<ScreenFace>& faces, int i, int j, double size, Occlusions& result) {
  Line line;
  const Order seen = order_of(faces[as_size(i)], faces[as_size(j)], line);
  if (seen == Order::apart) return;
  const auto add = [&](int hidden, int by) {
    result.list.push_back({hidden, by, -1, size});
    if (seen != Order::crossing) return;
    result.list.back().line = static_cast<int>(result.lines.size());
    result.lines.push_back(line);
    line.normal = -line.normal;
  };
  if (seen != Order::first) add(i, j);
  if (seen != Order::second) add(j, i);
}

/// A face's bounding box, small enough that a sweep over many stays in the cache.
struct Box {
  double low_x, high_x, low_y, high_y;
  int face;
};

/// Fills `hidings`.
void find_occlusions(const std::vector<ScreenFace>& faces, Occlusions& hidings) {
  static thread_local std::vector<Box> boxes, open;  // open: those that reach the sweep's position
  boxes.clear();
  open.clear();
  hidings.list.clear();
  hidings.lines.clear();
  for (std::size_t i = 0; i < faces.size(); ++i) {
    const ScreenFace& f = faces[i];
    boxes.push_back({f.low.x(), f.high.x(), f.low.y(), f.high.y(), static_cast<int>(i)});
  }
  std::sort(boxes.begin(), boxes.end(), [](const Box& a, const Box& b) {
    return a.low_x != b.low_x ? a.low_x < b.low_x : a.face < b.face;
  });
  for (const Box& a : boxes) {
    std::size_t kept = 0;
    for (std::size_t k = 0; k < open.size(); ++k) {
      const Box& b = open[k];
      if (b.high_x <= a.low_x) continue;
      if (kept != k) open[kept] = b;
      ++kept;
      const double height = std::min(a.high_y, b.high_y) - std::max(a.low_y, b.low_y);
      if (!(height > 0)) continue;
      find_occlusion(faces, std::min(a.face, b.face), std::max(a.face, b.face),
                     height * (std::min(a.high_x, b.high_x) - a.low_x), hidings);
    }
    open.resize(kept);
    open.push_back(a);
  }
  // By hidden face in two steps: few entries each, but thousands in all.
  hidings.first.assign(faces.size() + 1, 0);
  for (const Occlusion& h : hidings.list) ++hidings.first[as_size(h.hidden) + 1];
  for (std::size_t f = 0; f < faces.size(); ++f) hidings.first[f + 1] += hidings.first[f];
  hidings.sorted.resize(hidings.list.size());
  hidings.cursor = hidings.first;
  for (const Occlusion& h : hidings.list) hidings.sorted[as_size(hidings.cursor[as_size(h.hidden)]++)] = h;
  for (std::size_t f = 0; f < faces.size(); ++f)
    std::sort(hidings.sorted.begin() + hidings.first[f], hidings.sorted.begin() + hidings.first[f + 1],
              [](const Occlusion& a, const Occlusion& b) {
                return a.size != b.size ? a.size > b.size : a.by < b.by;
              });
}

/// Subtracts the part that one face hides from polygons of another.
class Subtraction {
 public:
  explicit Subtraction(const std::vector<ScreenFace>& faces) : faces_(faces) {}

  Pool pool;
  std::vector<Polygon> left;

  /// `part`: only where this line is positive; null: everywhere.
  void take(const Occlusion& hiding, const Line* part) {
    const ScreenFace& by = faces_[as_size(hiding.by)];
    const ScreenFace& of = faces_[as_size(hiding.hidden)];
    count_ = 0;
    if (part) {
      sides_[count_] = {On::crossing, 0, hiding.hidden, hiding.by};
      lines_[count_++] = *part;
    }
    for (int k = 0; k < 3; ++k) {
      sides_[count_] = {On::edge, static_cast<std::int8_t>(k), hiding.by, -1};
      lines_[count_++] = {by.normal[k], by.s[k], std::max(by.slack, of.slack)};
    }
    next_.clear();
    for (const Polygon& polygon : left) take_off(polygon);
    left.swap(next_);
  }

 private:
  void take_off(const Polygon& polygon) {
    for (int k = 0; k < count_; ++k) {
      bool outside = true;
      for (int i = 0; i < polygon.count && outside; ++i)
        outside = lines_[k].at(pool.corner(polygon, i).p) <= lines_[k].slack;
      if (outside) {
        next_.push_back(polygon);
        return;
      }
    }
    Polygon rest = polygon, front, back;
    for (int k = 0; k < count_ && !rest.empty(); ++k) {
      split(pool, rest, lines_[k], sides_[k], front, back);
      if (!back.empty() && !is_thin(back, lines_[k].slack)) next_.push_back(back);
      rest = front;
    }
  }
  bool is_thin(const Polygon& polygon, double slack) const {
    Vec2d low = pool.corner(polygon, 0).p, high = low;
    for (int i = 1; i < polygon.count; ++i) {
      low = low.cwiseMin(pool.corner(polygon, i).p);
      high = high.cwiseMax(pool.corner(polygon, i).p);
    }
    return !(pool.area(polygon) > slack * (high - low).sum());
  }

  const std::vector<ScreenFace>& faces_;
  std::vector<Polygon> next_;
  Line lines_[4];
  Side sides_[4];
  int count_ = 0;
};

/// The rectangle that faces are clipped to, in the window's pixels.
struct Bounds {
  Vec2d low, high;
  bool holds(const ScreenFace& face) const {
    return (face.low.array() >= low.array()).all() && (face.high.array() <= high.array()).all();
  }
  bool misses(const ScreenFace& face) const {
    return (face.low.array() >= high.array()).any() || (face.high.array() <= low.array()).any();
  }
};

Polygon triangle(Pool& pool, const ScreenFace& face, int index) {
  const Polygon polygon{static_cast<int>(pool.corners.size()), 3};
  for (int k = 0; k < 3; ++k)
    pool.corners.push_back({face.s[k], {On::edge, static_cast<std::int8_t>(k), index, -1}});
  return polygon;
}

Polygon within(Pool& pool, Polygon polygon, const Bounds& bounds, double slack) {
  const Line lines[4] = {{Vec2d(1, 0), bounds.low, slack},
                         {Vec2d(0, 1), bounds.low, slack},
                         {Vec2d(-1, 0), bounds.high, slack},
                         {Vec2d(0, -1), bounds.high, slack}};
  Polygon back;
  for (const Line& line : lines)
    if (!polygon.empty()) split(pool, Polygon(polygon), line, {}, polygon, back);
  return polygon;
}

}  // namespace

Polygon Pool::copy(const Pool& from, const Polygon& polygon) {
  const Polygon result{static_cast<int>(corners.size()), polygon.count};
  const auto first = from.corners.begin() + polygon.first;
  corners.insert(corners.end(), first, first + polygon.count);
  return result;
}

double Pool::area(const Polygon& polygon) const {
  double twice = 0;
  if (polygon.empty()) return 0;
  const Vec2d origin = corner(polygon, 0).p;
  for (int i = 1; i + 1 < polygon.count; ++i) {
    const Vec2d a = corner(polygon, i).p - origin, b = corner(polygon, i + 1).p - origin;
    twice += a.x() * b.y() - a.y() * b.x();
  }
  return twice / 2;
}

void split(Pool& pool, Polygon polygon, const Line& line, const Side& cut, Polygon& front, Polygon& back) {
  pool.distances.resize(std::max(pool.distances.size(), as_size(polygon.count)));
  double low = 0, high = 0;
  for (int i = 0; i < polygon.count; ++i) {
    const double d = line.at(pool.corner(polygon, i).p);
    pool.distances[as_size(i)] = d;
    low = std::min(low, d);
    high = std::max(high, d);
  }
  front = back = {};
  if (high <= line.slack) {
    back = polygon;
  } else if (low >= -line.slack) {
    front = polygon;
  } else {
    front = part(pool, polygon, 1, line.slack, cut);
    back = part(pool, polygon, -1, line.slack, cut);
  }
}

void find_visible(const ScreenMesh<double>& mesh, int width, int height, const PixelRect& window,
                  Visible& visible) {
  visible.faces.clear();
  visible.pieces.clear();
  visible.pool.corners.clear();
  visible.area = 0;
  const Bounds bounds{Vec2d(-width - window.u0, -height - window.v0),
                      Vec2d(2.0 * width - window.u0, 2.0 * height - window.v0)};
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    ScreenFace face;
    face.face = static_cast<int>(f);
    if (set_up(mesh.faces[f], width, height, window, face) && !bounds.misses(face))
      visible.faces.push_back(face);
  }
  static thread_local Occlusions hidings;
  find_occlusions(visible.faces, hidings);
  Subtraction subtraction(visible.faces);
  for (std::size_t i = 0; i < visible.faces.size(); ++i) {
    const ScreenFace& face = visible.faces[i];
    const int index = static_cast<int>(i);
    subtraction.pool.corners.clear();
    Polygon start = triangle(subtraction.pool, face, index);
    const bool inside = bounds.holds(face);
    if (!inside) start = within(subtraction.pool, start, bounds, face.slack);
    subtraction.left.clear();
    if (!start.empty()) subtraction.left.push_back(start);
    for (int h = hidings.first[i]; h < hidings.first[i + 1] && !subtraction.left.empty(); ++h) {
      const Occlusion& hiding = hidings.sorted[as_size(h)];
      subtraction.take(hiding, hiding.line < 0 ? nullptr : &hidings.lines[as_size(hiding.line)]);
    }
    const bool whole = inside && subtraction.left.size() == 1 && subtraction.left[0].first == start.first;
    for (const Polygon& polygon : subtraction.left) {
      visible.pieces.push_back({index, visible.pool.copy(subtraction.pool, polygon), whole});
      visible.area += visible.pool.area(visible.pieces.back().polygon);
    }
  }
}

}  // namespace mirage::coverage
