// In the plane across a pencil a ray is a point and a face a triangle. Rays are sorted into cells of that
// plane, row by row, so that the rays that may hit a face are contiguous. A face is tested on part of each
// row that it reaches, eight rays at a time; each ray keeps its nearest hit, without a branch per ray.
#include "sensors/ray_pencil.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <tuple>
#include <utility>
#include <vector>

#include "base/error.h"
#include "base/sizes.h"
#include "sensors/simd_targets.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sensors/ray_pencil.cpp"
// clang-format off
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wpedantic"
#pragma GCC diagnostic ignored "-Wshadow"
#include <hwy/foreach_target.h>  // this file again for each set: it must come first
#include <hwy/highway.h>
#pragma GCC diagnostic pop
// clang-format on

#ifndef MIRAGE_SENSORS_RAY_PENCIL_CPP_
#define MIRAGE_SENSORS_RAY_PENCIL_CPP_
namespace mirage::pencil {

inline constexpr std::size_t kEight = 8;
/// A face nearer the eye than this, in units of the mesh's size, is not hit.
inline constexpr float kNear = 1e-3f;
/// Faces are enlarged by this, in units of their own size, to close float32's gaps between neighbours.
inline constexpr float kEdge = 2e-6f;
inline constexpr float kFar = 1e30f;
/// Twice the area of a face seen edge-on.
inline constexpr float kEdgeOn = 1e-12f;
/// Rays in a cell, and a cell's height over its width: narrow cells cost nothing in a row.
inline constexpr float kRaysPerCell = 1.5f, kTall = 3;
inline constexpr int kMaxRows = 64;

/// Eight floats that stand for eight faces.
struct alignas(32) Eight {
  float values[kEight];
};
/// Corners of eight faces, in space: x, y, z of each of three.
using Corners = std::array<std::array<Eight, 3>, 3>;

/// A face across the pencil: its corner 0 (x, y, depth), and the slopes of b1, b2 and the depth in x and y.
using Seen = std::array<float, 9>;
/// Bounding boxes of faces; low above high: empty.
struct Boxes {
  Eight x_low, x_high, y_low, y_high;
};

/// The pencil's view: coordinates along `axes` relative to `point`.
struct View {
  std::array<std::array<float, 3>, 3> axes{};
  std::array<float, 3> point{};
  bool perspective = false;
};

struct Faces {
  std::size_t count = 0;
  std::vector<Corners> corners;  ///< of each eight faces; padded with the last
  std::vector<Seen> seen;        ///< of each face, in the present view; padded
  std::vector<Boxes> boxes;      ///< of each eight faces
  float x_low = kFar, x_high = -kFar, y_low = kFar, y_high = -kFar;  ///< of all faces
  /// In perspective, of each face: 1 / depth of the corners.
  std::vector<std::array<float, 3>> nearness;
  View view;
  float scale = 1;  ///< to coordinates within 1
};

/// Rays, each a point of the plane and a start depth, and their nearest hits so far. Sorted by cells, and
/// padded with rays that hit nothing.
struct Rays {
  std::vector<float> x, y, start, depth, b1, b2;
  std::vector<std::int32_t> face;
  std::vector<int> first;  ///< of each cell, and past the last
  std::vector<int> next;   ///< of each cell: index for its next ray

  /// In the caller's order.
  struct Place {
    float x, y, start;
    int cell;  ///< < 0: hits nothing; once sorted, its index in the sorted rays
  };
  std::vector<Place> places;
};

}  // namespace mirage::pencil
#endif

HWY_BEFORE_NAMESPACE();
namespace mirage::pencil::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<float, kEight>;
using I = hn::RebindToSigned<D>;
using V = hn::Vec<D>;
using M = hn::Mask<D>;
constexpr std::size_t kLanes = HWY_LANES(float) < kEight ? HWY_LANES(float) : kEight;

HWY_INLINE V Load(const Eight& from, std::size_t lane) {
  return hn::Load(D(), from.values + lane);
}
HWY_INLINE V Set(float x) {
  return hn::Set(D(), x);
}

/// A corner in the view: x, y and depth, which grows along the rays; false if it is too near.
HWY_INLINE M Look(const View& view, const std::array<Eight, 3>& corner, std::size_t lane, V* seen) {
  const V x = hn::Sub(Load(corner[0], lane), Set(view.point[0])),
          y = hn::Sub(Load(corner[1], lane), Set(view.point[1])),
          z = hn::Sub(Load(corner[2], lane), Set(view.point[2]));
  for (std::size_t a = 0; a < 3; ++a)
    seen[a] = hn::MulAdd(x, Set(view.axes[a][0]),
                         hn::MulAdd(y, Set(view.axes[a][1]), hn::Mul(z, Set(view.axes[a][2]))));
  if (!view.perspective) return hn::Eq(x, x);
  const M before = hn::Gt(seen[2], Set(kNear));
  const V near = hn::Div(Set(1), hn::IfThenElse(before, seen[2], Set(1)));
  seen[0] = hn::Mul(seen[0], near), seen[1] = hn::Mul(seen[1], near), seen[2] = hn::Neg(near);
  return before;
}

/// Projects all faces into the view.
void Project(Faces& faces) {
  const D d;
  V x_low = Set(kFar), x_high = Set(-kFar), y_low = Set(kFar), y_high = Set(-kFar);
  for (std::size_t eight = 0; eight < faces.corners.size(); ++eight)
    for (std::size_t lane = 0; lane < kEight; lane += kLanes) {
      const Corners& corners = faces.corners[eight];
      V a[3], b[3], c[3];
      M valid = Look(faces.view, corners[0], lane, a);
      valid = hn::And(valid, Look(faces.view, corners[1], lane, b));
      valid = hn::And(valid, Look(faces.view, corners[2], lane, c));
      V ab[3], ac[3];
      for (int i = 0; i < 3; ++i) ab[i] = hn::Sub(b[i], a[i]), ac[i] = hn::Sub(c[i], a[i]);
      const V area = hn::Sub(hn::Mul(ab[0], ac[1]), hn::Mul(ab[1], ac[0]));
      valid = hn::And(valid, hn::Gt(hn::Abs(area), Set(kEdgeOn)));
      const V per = hn::Div(Set(1), hn::IfThenElse(valid, area, Set(1)));
      const V b1x = hn::Mul(ac[1], per), b1y = hn::Neg(hn::Mul(ac[0], per)),
              b2x = hn::Neg(hn::Mul(ab[1], per)), b2y = hn::Mul(ab[0], per);
      const auto least = [&](int i) HWY_ATTR { return hn::Min(a[i], hn::Min(b[i], c[i])); };
      const auto most = [&](int i) HWY_ATTR { return hn::Max(a[i], hn::Max(b[i], c[i])); };
      const V edge = Set(4 * kEdge);  // no face is larger than 2
      const auto or_else = [&](V v, float none) HWY_ATTR { return hn::IfThenElse(valid, v, Set(none)); };
      const V depth_x = hn::MulAdd(b1x, ab[2], hn::Mul(b2x, ac[2])),
              depth_y = hn::MulAdd(b1y, ab[2], hn::Mul(b2y, ac[2]));
      const V values[] = {a[0], a[1], a[2], b1x, b1y, b2x, b2y, depth_x, depth_y};
      const V left = or_else(hn::Sub(least(0), edge), kFar), right = or_else(hn::Add(most(0), edge), -kFar),
              low = or_else(hn::Sub(least(1), edge), kFar), high = or_else(hn::Add(most(1), edge), -kFar);
      Boxes& boxes = faces.boxes[eight];
      hn::Store(left, d, boxes.x_low.values + lane), hn::Store(right, d, boxes.x_high.values + lane);
      hn::Store(low, d, boxes.y_low.values + lane), hn::Store(high, d, boxes.y_high.values + lane);
      x_low = hn::Min(x_low, left), x_high = hn::Max(x_high, right);
      y_low = hn::Min(y_low, low), y_high = hn::Max(y_high, high);
      alignas(32) float of_lanes[kLanes];
      for (std::size_t i = 0; i < std::size(values); ++i) {
        hn::Store(values[i], d, of_lanes);
        for (std::size_t k = 0; k < kLanes; ++k) faces.seen[eight * kEight + lane + k][i] = of_lanes[k];
      }
      if (!faces.view.perspective) continue;
      for (const auto& [corner, i] : {std::pair(a, 0), std::pair(b, 1), std::pair(c, 2)}) {
        hn::Store(hn::Neg(corner[2]), d, of_lanes);
        for (std::size_t k = 0; k < kLanes; ++k)
          faces.nearness[eight * kEight + lane + k][as_size(i)] = of_lanes[k];
      }
    }
  faces.x_low = hn::GetLane(hn::MinOfLanes(d, x_low)), faces.x_high = hn::GetLane(hn::MaxOfLanes(d, x_high));
  faces.y_low = hn::GetLane(hn::MinOfLanes(d, y_low)), faces.y_high = hn::GetLane(hn::MaxOfLanes(d, y_high));
}

/// Arrays of the sorted rays.
struct Sorted {
  const float *HWY_RESTRICT x, *HWY_RESTRICT y, *HWY_RESTRICT start;
  float *HWY_RESTRICT depth, *HWY_RESTRICT b1, *HWY_RESTRICT b2;
  std::int32_t* HWY_RESTRICT face;
};
/// A face, broadcast to eight rays.
struct Broadcast {
  V of[std::tuple_size_v<Seen>];
  explicit HWY_INLINE Broadcast(const Seen& face) {
    for (std::size_t i = 0; i < face.size(); ++i) of[i] = Set(face[i]);
  }
};
/// Tests a face on the rays in [ray, end), rounded up to a whole vector.
HWY_INLINE void Try(const Broadcast& face, int index, const Sorted& rays, std::size_t ray, std::size_t end) {
  const D d;
  const I ints;
  const auto& [x, y, depth_0, b1x, b1y, b2x, b2y, depth_x, depth_y] = face.of;
  for (; ray < end; ray += kLanes) {
    const V dx = hn::Sub(hn::LoadU(d, rays.x + ray), x), dy = hn::Sub(hn::LoadU(d, rays.y + ray), y),
            b1 = hn::MulAdd(dx, b1x, hn::Mul(dy, b1y)), b2 = hn::MulAdd(dx, b2x, hn::Mul(dy, b2y)),
            at = hn::MulAdd(dx, depth_x, hn::MulAdd(dy, depth_y, depth_0));
    const V depth = hn::LoadU(d, rays.depth + ray);
    const M inside = hn::And(hn::Ge(hn::Min(b1, b2), Set(-kEdge)), hn::Le(hn::Add(b1, b2), Set(1 + kEdge))),
            before = hn::And(hn::Gt(at, hn::LoadU(d, rays.start + ray)), hn::Lt(at, depth)),
            nearer = hn::And(inside, before);
    hn::StoreU(hn::IfThenElse(nearer, at, depth), d, rays.depth + ray);
    hn::StoreU(hn::IfThenElse(nearer, b1, hn::LoadU(d, rays.b1 + ray)), d, rays.b1 + ray);
    hn::StoreU(hn::IfThenElse(nearer, b2, hn::LoadU(d, rays.b2 + ray)), d, rays.b2 + ray);
    hn::StoreU(
        hn::IfThenElse(hn::RebindMask(ints, nearer), hn::Set(ints, index), hn::LoadU(ints, rays.face + ray)),
        ints, rays.face + ray);
  }
}

/// Cells of the part of the plane that contains faces: rows of columns.
struct Cells {
  float x0, x1, y0, y1;
  int rows = 1, columns = 1;
  float per_x = 0, per_y = 0;

  Cells(const Faces& faces, std::size_t rays)
      : x0(faces.x_low), x1(faces.x_high), y0(faces.y_low), y1(faces.y_high) {
    if (!(x0 <= x1)) return;
    const float width = x1 - x0, height = y1 - y0, cells = static_cast<float>(rays) / kRaysPerCell;
    rows = std::clamp(static_cast<int>(std::sqrt(cells * height / (width * kTall))), 1, kMaxRows);
    columns = std::clamp(static_cast<int>(cells / static_cast<float>(rows)), 1, 4 * kMaxRows);
    per_x = static_cast<float>(columns) / width, per_y = static_cast<float>(rows) / height;
  }
  bool hold(float x, float y) const { return x >= x0 && x <= x1 && y >= y0 && y <= y1; }
  // Both are monotonic, alone and eight at a time: a point between two others has a cell between theirs.
  int column(float x) const { return std::min(static_cast<int>((x - x0) * per_x), columns - 1); }
  int row(float y) const { return std::min(static_cast<int>((y - y0) * per_y), rows - 1); }
};
/// Cells of eight positions along one axis; undefined for invalid positions.
HWY_INLINE void CellsOf(const Eight& places, float from, float per, int count, std::int32_t* cells) {
  const D d;
  const I ints;
  for (std::size_t lane = 0; lane < kEight; lane += kLanes) {
    const V place = hn::Min(hn::Mul(hn::Sub(hn::Load(d, places.values + lane), Set(from)), Set(per)),
                            Set(static_cast<float>(count)));
    hn::Store(hn::Min(hn::ConvertTo(ints, place), hn::Set(ints, count - 1)), ints, cells + lane);
  }
}

/// Sets the rays' positions and start depths in the plane; counts the rays of each cell.
void Place(const Faces& faces, const Cells& cells, std::span<const Vec3f> points, Rays& rays) {
  const View& view = faces.view;
  rays.places.resize(points.size());
  rays.first.assign(as_size(cells.rows) * as_size(cells.columns) + 1, 0);
  for (std::size_t i = 0; i < points.size(); ++i) {
    float seen[3];
    for (std::size_t a = 0; a < 3; ++a) {
      seen[a] = 0;
      for (std::size_t c = 0; c < 3; ++c)
        seen[a] += view.axes[a][c] * (faces.scale * points[i][static_cast<Eigen::Index>(c)] - view.point[c]);
    }
    bool is_before = true;
    if (view.perspective) {
      is_before = seen[2] > 0;
      const float near = 1 / seen[2];
      seen[0] *= near, seen[1] *= near, seen[2] = -kFar;
    }
    Rays::Place& place = rays.places[i];
    place = {seen[0], seen[1], seen[2], -1};
    if (!is_before || !cells.hold(seen[0], seen[1])) continue;
    place.cell = cells.row(seen[1]) * cells.columns + cells.column(seen[0]);
    ++rays.first[as_size(place.cell) + 1];
  }
}

/// Sorts the rays that may hit a face by cells.
void Sort(Rays& rays) {
  for (std::size_t cell = 1; cell < rays.first.size(); ++cell) rays.first[cell] += rays.first[cell - 1];
  const auto count = as_size(rays.first.back()), padded = count + kEight;
  for (auto* of : {&rays.x, &rays.y, &rays.start, &rays.b1, &rays.b2}) of->resize(padded);
  rays.depth.assign(padded, kFar);
  rays.face.assign(padded, -1);
  std::fill_n(rays.x.begin() + static_cast<std::ptrdiff_t>(count), kEight,
              std::numeric_limits<float>::quiet_NaN());
  rays.next.assign(rays.first.begin(), rays.first.end() - 1);
  for (Rays::Place& place : rays.places) {
    if (place.cell < 0) continue;
    place.cell = rays.next[as_size(place.cell)]++;
    const auto to = as_size(place.cell);
    rays.x[to] = place.x, rays.y[to] = place.y, rays.start[to] = place.start;
  }
}

void MeetAll(const Faces& faces, std::span<const Vec3f> points, std::span<RayPencil::Met> met, Rays& rays) {
  const Cells cells(faces, points.size());
  Place(faces, cells, points, rays);
  Sort(rays);
  const Sorted sorted{rays.x.data(),  rays.y.data(),  rays.start.data(), rays.depth.data(),
                      rays.b1.data(), rays.b2.data(), rays.face.data()};
  alignas(32) std::int32_t left[kEight], right[kEight], low[kEight], high[kEight];
  for (std::size_t eight = 0; eight < faces.boxes.size(); ++eight) {
    const Boxes& boxes = faces.boxes[eight];
    CellsOf(boxes.x_low, cells.x0, cells.per_x, cells.columns, left);
    CellsOf(boxes.x_high, cells.x0, cells.per_x, cells.columns, right);
    CellsOf(boxes.y_low, cells.y0, cells.per_y, cells.rows, low);
    CellsOf(boxes.y_high, cells.y0, cells.per_y, cells.rows, high);
    const std::size_t first_face = eight * kEight, count = std::min(kEight, faces.count - first_face);
    for (std::size_t k = 0; k < count; ++k) {
      if (!(boxes.x_low.values[k] <= boxes.x_high.values[k])) continue;
      const Broadcast face(faces.seen[first_face + k]);
      for (int row = low[k]; row <= high[k]; ++row) {
        const int* first = rays.first.data() + row * cells.columns;
        Try(face, static_cast<int>(first_face + k), sorted, as_size(first[left[k]]),
            as_size(first[right[k] + 1]));
      }
    }
  }
  for (std::size_t i = 0; i < met.size(); ++i) {
    met[i] = {};
    if (rays.places[i].cell < 0) continue;
    const auto ray = as_size(rays.places[i].cell);
    if (rays.face[ray] < 0) continue;
    met[i] = {rays.face[ray], std::max(0.0f, rays.b1[ray]), std::max(0.0f, rays.b2[ray])};
    if (!faces.view.perspective) continue;
    // The share of a corner in space is that across the pencil times its nearness.
    const auto& near = faces.nearness[as_size(met[i].face)];
    const float w1 = met[i].b1 * near[1], w2 = met[i].b2 * near[2],
                w = std::max(0.0f, 1 - met[i].b1 - met[i].b2) * near[0] + w1 + w2;
    met[i].b1 = w1 / w, met[i].b2 = w2 / w;
  }
}

}  // namespace mirage::pencil::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace mirage {
namespace pencil {

HWY_EXPORT(Project);
HWY_EXPORT(MeetAll);

namespace {

// Called from this namespace, as Highway requires with a single instruction set.
void project(Faces& faces) {
  HWY_DYNAMIC_DISPATCH(Project)(faces);
}
void meet_all(const Faces& faces, std::span<const Vec3f> points, std::span<RayPencil::Met> met, Rays& rays) {
  HWY_DYNAMIC_DISPATCH(MeetAll)(faces, points, met, rays);
}

}  // namespace
}  // namespace pencil

struct RayPencil::State : pencil::Faces {
  pencil::Rays rays;

  void set_eye(const Vec3f& axis) {
    const Vec3f z = axis.normalized(), x = z.unitOrthogonal(), y = z.cross(x);
    const Vec3f axes[3] = {x, y, z};
    for (std::size_t a = 0; a < 3; ++a)
      for (std::size_t c = 0; c < 3; ++c) view.axes[a][c] = axes[a][static_cast<Eigen::Index>(c)];
    pencil::project(*this);
  }
};

RayPencil::RayPencil(const Mesh& mesh, const Vec3d& origin) : state_(std::make_unique<State>()) {
  using namespace pencil;
  State& s = *state_;
  check_mesh({mesh, {}}, "mesh whose light is found");
  if (mesh.faces.empty()) return;
  double size = 0;
  for (const std::size_t i : used_vertices(mesh))
    size = std::max(size, (mesh.vertices[i] - origin).cwiseAbs().maxCoeff());
  s.scale = size > 0 ? static_cast<float>(1 / size) : 1;
  s.count = mesh.faces.size();
  s.corners.resize((s.count + kEight - 1) / kEight);
  s.seen.resize(s.corners.size() * kEight);
  s.boxes.resize(s.corners.size());
  s.nearness.resize(s.seen.size());
  for (std::size_t place = 0; place < s.seen.size(); ++place)
    for (std::size_t i = 0; i < 3; ++i) {
      const Face& face = mesh.faces[std::min(place, s.count - 1)];
      const Vec3f corner = s.scale * (mesh.vertices[as_size(face[i])] - origin).cast<float>();
      for (std::size_t c = 0; c < 3; ++c)
        s.corners[place / kEight][i][c].values[place % kEight] = corner[static_cast<Eigen::Index>(c)];
    }
}

RayPencil::~RayPencil() = default;

void RayPencil::along(const Vec3f& direction) {
  state_->view.point = {};
  state_->view.perspective = false;
  state_->set_eye(direction);
}

void RayPencil::from(const Vec3f& point, const Vec3f& axis) {
  for (std::size_t c = 0; c < 3; ++c)
    state_->view.point[c] = state_->scale * point[static_cast<Eigen::Index>(c)];
  state_->view.perspective = true;
  state_->set_eye(axis);
}

void RayPencil::intersect(std::span<const Vec3f> points, std::span<Met> met) const {
  if (points.size() != met.size())
    throw Failure("ray pencil", "as many hits as rays are needed", "give each ray a place for its hit");
  if (points.empty()) return;
  pencil::meet_all(*state_, points, met, state_->rays);
}

}  // namespace mirage
#endif
