// Faces stand in blocks of eight that lie near each other, and blocks in groups of 64. A ray looks at the
// boxes of all groups, at all blocks' of those that hold it, and at the faces of the blocks that do, eight at
// a time: a few branches that cannot be foreseen, where a tree of boxes has one for each of its nodes.
#include "sensors/ray_pencil.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <vector>

#include "base/error.h"

#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
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

inline constexpr std::size_t kBlock = 8;                // faces
inline constexpr std::size_t kGroup = kBlock * kBlock;  // blocks: as many as a word has bits
/// What lies nearer the eye than this, in the mesh's sizes, is not met.
inline constexpr float kNear = 1e-3f;
/// Faces are this much larger than they are, in their own sizes: what float32 leaves open between two.
inline constexpr float kEdge = 2e-6f;
inline constexpr float kFar = 1e30f;
/// Twice the area of what is seen edge on.
inline constexpr float kEdgeOn = 1e-12f;
/// Eight floats that stand for eight faces, blocks or groups.
struct alignas(32) Eight {
  float values[kBlock];
};
constexpr Eight all(float x) {
  return {{x, x, x, x, x, x, x, x}};
}
/// Corners of eight faces, in space or across the pencil: x, y, z of each of three.
using Corners = std::array<std::array<Eight, 3>, 3>;

/// Eight faces across the pencil. From corner 0, b1 and b2 rise by `slopes` for each x and y, and so does the
/// depth.
struct Faces {
  Eight x, y, depth;
  std::array<std::array<Eight, 2>, 2> slopes;
  std::array<Eight, 2> depth_slopes;
};
/// Where eight faces, blocks or groups may be met.
struct Boxes {
  Eight x_low = all(kFar), x_high = all(-kFar), y_low = all(kFar), y_high = all(-kFar), deepest = all(-kFar);
};

/// How the pencil sees: coordinates along `axes` of what is seen from `point`.
struct View {
  std::array<std::array<float, 3>, 3> axes{};
  std::array<float, 3> point{};
  bool perspective = false;
};

struct Tree {
  std::size_t blocks = 0, eights = 0, groups = 0;  ///< eights: of blocks
  std::vector<int> order;          ///< which face each place of the blocks holds; padded with the last
  std::vector<Corners> corners;    ///< of each block
  std::vector<Faces> seen;         ///< of each block, as the present view has it
  std::vector<Boxes> block_boxes;  ///< of each eight blocks; eight times as many as there are groups
  std::vector<Boxes> group_boxes;  ///< of each eight groups
  std::vector<Eight> nearness;     ///< in perspective, three a block: 1 / distance of the corners
  View view;
  float scale = 1;  ///< to coordinates within 1
};

/// A pencil's point: where a ray runs, and from which depth.
struct Place {
  float x, y, depth;
};

}  // namespace mirage::pencil
#endif

HWY_BEFORE_NAMESPACE();
namespace mirage::pencil::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::CappedTag<float, kBlock>;
using V = hn::Vec<D>;
using M = hn::Mask<D>;
constexpr std::size_t kLanes = HWY_LANES(float) < kBlock ? HWY_LANES(float) : kBlock;

HWY_INLINE V Load(const Eight& from, std::size_t lane) {
  return hn::Load(D(), from.values + lane);
}
HWY_INLINE void Store(V v, Eight& to, std::size_t lane) {
  hn::Store(v, D(), to.values + lane);
}
HWY_INLINE V Set(float x) {
  return hn::Set(D(), x);
}

HWY_INLINE float Least(const Eight& of) {
  V least = Load(of, 0);
  for (std::size_t lane = kLanes; lane < kBlock; lane += kLanes) least = hn::Min(least, Load(of, lane));
  return hn::GetLane(hn::MinOfLanes(D(), least));
}
HWY_INLINE float Greatest(const Eight& of) {
  V greatest = Load(of, 0);
  for (std::size_t lane = kLanes; lane < kBlock; lane += kLanes) greatest = hn::Max(greatest, Load(of, lane));
  return hn::GetLane(hn::MaxOfLanes(D(), greatest));
}
/// The box of eight boxes as one of eight others.
HWY_INLINE void Enclose(const Boxes& these, Boxes& in, std::size_t place) {
  in.x_low.values[place] = Least(these.x_low);
  in.x_high.values[place] = Greatest(these.x_high);
  in.y_low.values[place] = Least(these.y_low);
  in.y_high.values[place] = Greatest(these.y_high);
  in.deepest.values[place] = Greatest(these.deepest);
}

/// A corner as the view has it: x, y and the depth, which grows away from where rays start; false where it
/// lies too near.
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

/// All faces as the view has them.
void Project(Tree& tree) {
  for (std::size_t block = 0; block < tree.blocks; ++block) {
    const Corners& corners = tree.corners[block];
    Faces& faces = tree.seen[block];
    Boxes boxes;
    for (std::size_t lane = 0; lane < kBlock; lane += kLanes) {
      V a[3], b[3], c[3];
      M valid = Look(tree.view, corners[0], lane, a);
      valid = hn::And(valid, Look(tree.view, corners[1], lane, b));
      valid = hn::And(valid, Look(tree.view, corners[2], lane, c));
      if (tree.view.perspective) {
        Store(hn::Neg(a[2]), tree.nearness[3 * block], lane);
        Store(hn::Neg(b[2]), tree.nearness[3 * block + 1], lane);
        Store(hn::Neg(c[2]), tree.nearness[3 * block + 2], lane);
      }
      V ab[3], ac[3];
      for (int i = 0; i < 3; ++i) ab[i] = hn::Sub(b[i], a[i]), ac[i] = hn::Sub(c[i], a[i]);
      const V area = hn::Sub(hn::Mul(ab[0], ac[1]), hn::Mul(ab[1], ac[0]));
      valid = hn::And(valid, hn::Gt(hn::Abs(area), Set(kEdgeOn)));
      const V per = hn::Div(Set(1), hn::IfThenElse(valid, area, Set(1)));
      const V b1x = hn::Mul(ac[1], per), b1y = hn::Neg(hn::Mul(ac[0], per)),
              b2x = hn::Neg(hn::Mul(ab[1], per)), b2y = hn::Mul(ab[0], per);
      Store(b1x, faces.slopes[0][0], lane), Store(b1y, faces.slopes[0][1], lane);
      Store(b2x, faces.slopes[1][0], lane), Store(b2y, faces.slopes[1][1], lane);
      Store(hn::MulAdd(b1x, ab[2], hn::Mul(b2x, ac[2])), faces.depth_slopes[0], lane);
      Store(hn::MulAdd(b1y, ab[2], hn::Mul(b2y, ac[2])), faces.depth_slopes[1], lane);
      Store(a[0], faces.x, lane), Store(a[1], faces.y, lane);
      // A face that is not met lies before every start.
      Store(hn::IfThenElse(valid, a[2], Set(-std::numeric_limits<float>::infinity())), faces.depth, lane);
      const auto least = [&](int i) HWY_ATTR { return hn::Min(a[i], hn::Min(b[i], c[i])); };
      const auto most = [&](int i) HWY_ATTR { return hn::Max(a[i], hn::Max(b[i], c[i])); };
      const V edge = Set(4 * kEdge);  // no face is larger than 2
      const auto or_else = [&](V v, float none) HWY_ATTR { return hn::IfThenElse(valid, v, Set(none)); };
      Store(or_else(hn::Sub(least(0), edge), kFar), boxes.x_low, lane);
      Store(or_else(hn::Add(most(0), edge), -kFar), boxes.x_high, lane);
      Store(or_else(hn::Sub(least(1), edge), kFar), boxes.y_low, lane);
      Store(or_else(hn::Add(most(1), edge), -kFar), boxes.y_high, lane);
      Store(or_else(most(2), -kFar), boxes.deepest, lane);
    }
    Enclose(boxes, tree.block_boxes[block / kBlock], block % kBlock);
  }
  for (std::size_t group = 0; group < tree.groups; ++group) {
    Boxes of_eights;
    for (std::size_t i = 0; i < kBlock; ++i) Enclose(tree.block_boxes[group * kBlock + i], of_eights, i);
    Enclose(of_eights, tree.group_boxes[group / kBlock], group % kBlock);
  }
}

/// A bit for each lane.
HWY_INLINE unsigned Bits(M mask) {
  std::uint8_t bytes[8] = {};
  hn::StoreMaskBits(D(), mask, bytes);
  return bytes[0];
}
/// Which of eight boxes may hold what a ray meets.
HWY_INLINE unsigned Holding(const Boxes& boxes, V x, V y, V depth) {
  unsigned bits = 0;
  for (std::size_t lane = 0; lane < kBlock; lane += kLanes) {
    const M across = hn::And(hn::Ge(x, Load(boxes.x_low, lane)), hn::Le(x, Load(boxes.x_high, lane))),
            up = hn::And(hn::Ge(y, Load(boxes.y_low, lane)), hn::Le(y, Load(boxes.y_high, lane)));
    bits |= Bits(hn::And(hn::And(across, up), hn::Le(depth, Load(boxes.deepest, lane)))) << lane;
  }
  return bits;
}

/// The nearest face of each lane so far.
struct Nearest {
  V depth, b1, b2, block;
};
/// The nearer of these and a block's faces.
HWY_INLINE void Meet(const Faces& faces, std::size_t block, V x, V y, V depth, Nearest* nearest) {
  for (std::size_t lane = 0; lane < kBlock; lane += kLanes, ++nearest) {
    const V dx = hn::Sub(x, Load(faces.x, lane)), dy = hn::Sub(y, Load(faces.y, lane));
    const V b1 = hn::MulAdd(dx, Load(faces.slopes[0][0], lane), hn::Mul(dy, Load(faces.slopes[0][1], lane))),
            b2 = hn::MulAdd(dx, Load(faces.slopes[1][0], lane), hn::Mul(dy, Load(faces.slopes[1][1], lane))),
            at = hn::MulAdd(dx, Load(faces.depth_slopes[0], lane),
                            hn::MulAdd(dy, Load(faces.depth_slopes[1], lane), Load(faces.depth, lane)));
    const M inside = hn::And(hn::Ge(hn::Min(b1, b2), Set(-kEdge)), hn::Le(hn::Add(b1, b2), Set(1 + kEdge))),
            before = hn::And(hn::Gt(at, depth), hn::Lt(at, nearest->depth)), nearer = hn::And(inside, before);
    nearest->depth = hn::IfThenElse(nearer, at, nearest->depth);
    nearest->b1 = hn::IfThenElse(nearer, b1, nearest->b1);
    nearest->b2 = hn::IfThenElse(nearer, b2, nearest->b2);
    nearest->block = hn::IfThenElse(nearer, Set(static_cast<float>(block)), nearest->block);
  }
}

/// What a ray meets.
RayPencil::Met Meet(const Tree& tree, const Place& place) {
  const V x = Set(place.x), y = Set(place.y), depth = Set(place.depth);
  Nearest nearest[kBlock / kLanes];
  for (Nearest& none : nearest) none = {Set(kFar), Set(0), Set(0), Set(0)};
  for (std::size_t eight = 0; eight < tree.group_boxes.size(); ++eight)
    for (unsigned groups = Holding(tree.group_boxes[eight], x, y, depth); groups != 0; groups &= groups - 1) {
      const std::size_t group = eight * kBlock + static_cast<std::size_t>(std::countr_zero(groups)),
                        last = std::min((group + 1) * kBlock, tree.eights);
      std::uint64_t blocks = 0;
      for (std::size_t i = last; i-- > group * kBlock;)
        blocks = blocks << kBlock | Holding(tree.block_boxes[i], x, y, depth);
      for (; blocks != 0; blocks &= blocks - 1) {
        const std::size_t block = group * kGroup + static_cast<std::size_t>(std::countr_zero(blocks));
        Meet(tree.seen[block], block, x, y, depth, nearest);
      }
    }
  const D d;
  V least = nearest[0].depth;
  for (std::size_t i = 1; i < kBlock / kLanes; ++i) least = hn::Min(least, nearest[i].depth);
  least = hn::MinOfLanes(d, least);
  if (hn::GetLane(least) >= kFar) return {};
  const Nearest* of = nearest;
  while (hn::AllFalse(d, hn::Eq(of->depth, least))) ++of;
  Eight first, second, block;
  Store(of->b1, first, 0), Store(of->b2, second, 0), Store(of->block, block, 0);
  const auto in_vector = static_cast<std::size_t>(hn::FindFirstTrue(d, hn::Eq(of->depth, least)));
  const std::size_t lane = static_cast<std::size_t>(of - nearest) * kLanes + in_vector,
                    found = static_cast<std::size_t>(block.values[in_vector]) * kBlock + lane;
  RayPencil::Met met{tree.order[found], std::max(0.0f, first.values[in_vector]),
                     std::max(0.0f, second.values[in_vector])};
  if (tree.view.perspective) {  // the share of a corner in space is that across the pencil times its nearness
    const Eight* nearness = &tree.nearness[found / kBlock * 3];
    const float w1 = met.b1 * nearness[1].values[lane], w2 = met.b2 * nearness[2].values[lane],
                w = std::max(0.0f, 1 - met.b1 - met.b2) * nearness[0].values[lane] + w1 + w2;
    met.b1 = w1 / w, met.b2 = w2 / w;
  }
  return met;
}

void MeetAll(const Tree& tree, std::span<const Vec3f> points, std::span<RayPencil::Met> met) {
  const View& view = tree.view;
  for (std::size_t i = 0; i < points.size(); ++i) {
    float seen[3];
    for (std::size_t a = 0; a < 3; ++a) {
      seen[a] = 0;
      for (std::size_t c = 0; c < 3; ++c)
        seen[a] += view.axes[a][c] * (tree.scale * points[i][static_cast<Eigen::Index>(c)] - view.point[c]);
    }
    met[i] = {};
    if (view.perspective) {
      if (!(seen[2] > 0)) continue;
      seen[0] /= seen[2], seen[1] /= seen[2], seen[2] = -kFar;
    }
    met[i] = Meet(tree, {seen[0], seen[1], seen[2]});
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

/// Brings faces that are near each other into the same blocks and groups.
void gather(const std::vector<Vec3f>& centroids, int* first, int* last) {
  const auto count = static_cast<std::size_t>(last - first),
             unit = count > kGroup * kBlock ? kGroup * kBlock : kBlock;
  if (count <= kBlock) return;
  Eigen::AlignedBox3f box;
  for (const int* i = first; i != last; ++i) box.extend(centroids[static_cast<std::size_t>(*i)]);
  Eigen::Index axis = 0;
  box.sizes().maxCoeff(&axis);
  int* middle = first + std::max<std::size_t>(1, (count + unit - 1) / unit / 2) * unit;
  std::nth_element(first, middle, last, [&](int a, int b) {
    return centroids[static_cast<std::size_t>(a)][axis] < centroids[static_cast<std::size_t>(b)][axis];
  });
  gather(centroids, first, middle);
  gather(centroids, middle, last);
}

}  // namespace
}  // namespace pencil

struct RayPencil::State : pencil::Tree {
  void look(const Vec3f& axis) {
    const Vec3f z = axis.normalized(), x = z.unitOrthogonal(), y = z.cross(x);
    const Vec3f axes[3] = {x, y, z};
    for (std::size_t a = 0; a < 3; ++a)
      for (std::size_t c = 0; c < 3; ++c) view.axes[a][c] = axes[a][static_cast<Eigen::Index>(c)];
    HWY_DYNAMIC_DISPATCH(pencil::Project)(*this);
  }
};

RayPencil::RayPencil(const Mesh& mesh, const Vec3d& origin) : state_(std::make_unique<State>()) {
  using namespace pencil;
  State& s = *state_;
  check_mesh({mesh, {}}, "mesh whose light is found");
  if (mesh.faces.empty()) return;
  double size = 0;
  for (const Vec3d& vertex : mesh.vertices) size = std::max(size, (vertex - origin).cwiseAbs().maxCoeff());
  s.scale = size > 0 ? static_cast<float>(1 / size) : 1;
  std::vector<std::array<Vec3f, 3>> faces;
  std::vector<Vec3f> centroids;
  for (const Face& face : mesh.faces) {
    auto& corners = faces.emplace_back();
    for (std::size_t i = 0; i < 3; ++i)
      corners[i] = s.scale * (mesh.vertices[static_cast<std::size_t>(face[i])] - origin).cast<float>();
    centroids.push_back((corners[0] + corners[1] + corners[2]) / 3);
  }
  s.order.resize(mesh.faces.size());
  std::iota(s.order.begin(), s.order.end(), 0);
  gather(centroids, s.order.data(), s.order.data() + s.order.size());
  s.blocks = (s.order.size() + kBlock - 1) / kBlock;
  s.eights = (s.blocks + kBlock - 1) / kBlock;
  s.groups = (s.blocks + kGroup - 1) / kGroup;
  s.order.resize(s.blocks * kBlock, s.order.back());
  s.corners.resize(s.blocks);
  for (std::size_t place = 0; place < s.order.size(); ++place)
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t c = 0; c < 3; ++c)
        s.corners[place / kBlock][i][c].values[place % kBlock] =
            faces[static_cast<std::size_t>(s.order[place])][i][static_cast<Eigen::Index>(c)];
  s.seen.resize(s.blocks);
  s.nearness.resize(3 * s.blocks);
  s.block_boxes.resize(s.groups * kBlock);
  s.group_boxes.resize((s.groups + kBlock - 1) / kBlock);
}

RayPencil::~RayPencil() = default;
RayPencil::RayPencil(RayPencil&&) noexcept = default;
RayPencil& RayPencil::operator=(RayPencil&&) noexcept = default;

void RayPencil::along(const Vec3f& direction) {
  state_->view.point = {};
  state_->view.perspective = false;
  state_->look(direction);
}

void RayPencil::from(const Vec3f& point, const Vec3f& axis) {
  for (std::size_t c = 0; c < 3; ++c)
    state_->view.point[c] = state_->scale * point[static_cast<Eigen::Index>(c)];
  state_->view.perspective = true;
  state_->look(axis);
}

void RayPencil::intersect(std::span<const Vec3f> points, std::span<Met> met) const {
  if (points.size() != met.size())
    throw Failure("ray pencil", "as many hits as rays are needed", "give each ray a place for its hit");
  HWY_DYNAMIC_DISPATCH(pencil::MeetAll)(*state_, points, met);
}

}  // namespace mirage
#endif
