#include "detection/body_evidence.h"

#include <algorithm>
#include <cmath>

#include "geometry/seen_rectangle.h"

namespace mirage {
namespace {

constexpr int kRows = 70, kColumns = 80;  // m: x from 0, y from −40
constexpr float kNone = 1e9f;

/// Cells of `size` m that a list of places touches, joined where they are neighbours but one.
class Cells {
 public:
  explicit Cells(double size)
      : size_(size),
        rows_(static_cast<int>(kRows / size)),
        columns_(static_cast<int>(kColumns / size)),
        cell_(static_cast<std::size_t>(rows_) * static_cast<std::size_t>(columns_), kEmpty) {}
  void touch(const Vec2d& p) {
    const auto [row, column] = place(p);
    for (int r = std::max(row - 1, 0); r <= std::min(row + 1, rows_ - 1); ++r)
      for (int c = std::max(column - 1, 0); c <= std::min(column + 1, columns_ - 1); ++c) at(r, c) = kTouched;
  }
  /// Numbers the connected parts from 0; returns how many there are.
  int number() {
    int count = 0;
    std::vector<std::pair<int, int>> open;
    for (int row = 0; row < rows_; ++row)
      for (int column = 0; column < columns_; ++column) {
        if (at(row, column) != kTouched) continue;
        at(row, column) = count;
        open.assign(1, {row, column});
        while (!open.empty()) {
          const auto [r0, c0] = open.back();
          open.pop_back();
          for (int r = std::max(r0 - 1, 0); r <= std::min(r0 + 1, rows_ - 1); ++r)
            for (int c = std::max(c0 - 1, 0); c <= std::min(c0 + 1, columns_ - 1); ++c)
              if (at(r, c) == kTouched) {
                at(r, c) = count;
                open.emplace_back(r, c);
              }
        }
        ++count;
      }
    return count;
  }
  int of(const Vec2d& p) const {
    const auto [row, column] = place(p);
    return cell_[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
                 static_cast<std::size_t>(column)];
  }

 private:
  static constexpr int kEmpty = -2, kTouched = -1;
  std::pair<int, int> place(const Vec2d& p) const {
    return {std::clamp(static_cast<int>(p.x() / size_), 0, rows_ - 1),
            std::clamp(static_cast<int>((p.y() + kColumns / 2.0) / size_), 0, columns_ - 1)};
  }
  int& at(int row, int column) {
    return cell_[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
                 static_cast<std::size_t>(column)];
  }

  double size_;
  int rows_, columns_;
  std::vector<int> cell_;
};

}  // namespace

RoadSurface::RoadSurface(std::span<const LidarPoint> points)
    : lowest_(static_cast<std::size_t>(kRows) * kColumns, kNone) {
  constexpr float kDeepest = -4;  // m; below it mirrored returns
  for (const LidarPoint& p : points) {
    const double y = p.y + kColumns / 2.0;
    if (!(p.x >= 0 && p.x < kRows && y >= 0 && y < kColumns && p.z > kDeepest)) continue;
    float& lowest = lowest_[static_cast<std::size_t>(p.x) * kColumns + static_cast<std::size_t>(y)];
    lowest = std::min(lowest, p.z);
  }
  // Least squares over what lies near the plane of before, more of it below than above.
  for (const double reach : {1.0, 0.5, 0.3, 0.3, 0.3}) {
    constexpr int kFewest = 20;
    Eigen::Matrix3d squares = Vec3d(1e-3, 10, 10).asDiagonal();  // level where little is seen
    Vec3d products = Vec3d::Zero();
    int used = 0;
    for (int row = 0; row < kRows; ++row)
      for (int column = 0; column < kColumns; ++column) {
        const double z = lowest_[static_cast<std::size_t>(row) * kColumns + static_cast<std::size_t>(column)];
        const Vec3d at(1, row + 0.5, column + 0.5 - kColumns / 2.0);
        const double over = z - at.dot(plane_);
        if (!(over < reach && over > -2 * reach)) continue;
        squares += at * at.transpose();
        products += at * z;
        ++used;
      }
    if (used < kFewest) break;
    plane_ = squares.ldlt().solve(products);
  }
}

double RoadSurface::height(double x, double y) const {
  constexpr double kStep = 0.4;  // m
  const int row = static_cast<int>(std::clamp(x, 0.0, kRows - 1.0)),
            column = static_cast<int>(std::clamp(y + kColumns / 2.0, 0.0, kColumns - 1.0));
  float lowest = kNone;
  for (int r = std::max(row - 1, 0); r <= std::min(row + 1, kRows - 1); ++r)
    for (int c = std::max(column - 1, 0); c <= std::min(column + 1, kColumns - 1); ++c)
      lowest =
          std::min(lowest, lowest_[static_cast<std::size_t>(r) * kColumns + static_cast<std::size_t>(c)]);
  const double road = plane(x, y);
  return std::abs(lowest - road) < kStep ? lowest : road;
}

BodyEvidence::BodyEvidence(std::span<const LidarPoint> points) : points_(points), road_(points) {}

RayCount BodyEvidence::rays(const BevBox& box) const {
  constexpr double kInner = 0.7, kBehind = 0.5;                                  // share; m
  constexpr double kLow = 0.25, kHigh = 1.4, kBodyLow = 0.35, kBodyHigh = 0.95;  // m: below windows
  const double c = std::cos(box.yaw), s = std::sin(box.yaw), road = road_.height(box.x, box.y);
  const auto local = [&](double x, double y) {
    return Vec2d(c * (x - box.x) + s * (y - box.y), c * (y - box.y) - s * (x - box.x));
  };
  const Vec2d half(box.length / 2, box.width / 2), unit = local(0, 0);
  RayCount count;
  for (const LidarPoint& p : points_) {
    const Vec2d end = local(p.x, p.y);
    const double over = p.z - road;
    if (std::abs(end.x()) < half.x() && std::abs(end.y()) < half.y() && over > kLow && over < kHigh)
      ++count.stopped;
    // The share of the ray that lies within the inner rectangle.
    const Vec2d way = end - unit;
    double enters = 0, leaves = 1 - kBehind / std::max(way.norm(), 1e-6);
    const double last = leaves;
    bool meets = true;
    for (int k = 0; k < 2 && meets; ++k) {
      const double inner = kInner * half[k];
      if (std::abs(way[k]) < 1e-12) {
        meets = std::abs(unit[k]) < inner;
        continue;
      }
      const double a = (-inner - unit[k]) / way[k], b = (inner - unit[k]) / way[k];
      enters = std::max(enters, std::min(a, b));
      leaves = std::min(leaves, std::max(a, b));
    }
    if (!meets || !(leaves > enters) || !(leaves < last)) continue;
    const double at = p.z * (enters + leaves) / 2 - road;
    count.passed += at > kBodyLow && at < kBodyHigh;
  }
  return count;
}

std::vector<BevBox> BodyEvidence::bodies() const {
  constexpr double kCell = 0.25, kLow = 0.3, kHigh = 1.4, kTall = 1.0, kFar = 45;  // m
  constexpr double kLargest = 6.5, kSmallest = 0.9;                                // m, of what is joined
  constexpr std::size_t kFewest = 10;
  constexpr int kFewestStopped = 20, kPassedShare = 10;  // nine of ten are stopped
  Cells cells(kCell);
  std::vector<std::pair<Vec2d, double>> low;  // place, height
  for (const LidarPoint& p : points_) {
    if (!(p.x >= 1 && p.x < kRows && std::abs(p.y) < kColumns / 2.0)) continue;
    const double over = p.z - road_.height(p.x, p.y);
    if (over <= kLow || over >= kHigh) continue;
    low.emplace_back(Vec2d(p.x, p.y), over);
    cells.touch(low.back().first);
  }
  struct Joined {
    std::vector<Vec2d> places;
    double tallest = 0;
    Eigen::AlignedBox2d around;
  };
  std::vector<Joined> joined(static_cast<std::size_t>(cells.number()));
  for (const auto& [place, over] : low) {
    Joined& its = joined[static_cast<std::size_t>(cells.of(place))];
    its.places.push_back(place);
    its.tallest = std::max(its.tallest, over);
    its.around.extend(place);
  }
  std::vector<BevBox> found;
  for (const Joined& one : joined) {
    const double across = one.around.isEmpty() ? 0 : one.around.diagonal().norm();
    if (one.places.size() < kFewest || one.tallest < kTall || across > kLargest || across < kSmallest)
      continue;
    const auto box = car_seen_as(closest_rectangle(one.places));
    if (!box || std::hypot(box->x, box->y) > kFar) continue;
    const RayCount count = rays(*box);
    if (count.stopped > kFewestStopped && kPassedShare * count.passed <= count.stopped + count.passed)
      found.push_back(*box);
  }
  return found;
}

}  // namespace mirage
