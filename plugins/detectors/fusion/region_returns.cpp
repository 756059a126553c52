#include "region_returns.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "bilinear.h"
#include "detection/car_in_picture.h"
#include "region.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr double kOccupiedReach = 0.7, kOccupiedAside = 1;  // the raster's reach, in lengths and widths
constexpr double kOwnAlong = 0.8, kOwnAcross = 1.2, kBelow = 0.3, kAbove = 2.7;  // lengths, widths, m
constexpr std::size_t kMostReturns = 128;                                        // of a region

/// Points by cell of the first grid: what of the region they are in.
class Buckets {
 public:
  explicit Buckets(std::span<const float> points) : first_(kCellsX * kCellsY + 1, 0) {
    const std::size_t count = points.size() / 4;
    std::vector<std::int32_t> cell(count, -1);
    for (std::size_t i = 0; i < count; ++i) {
      const double row = std::floor((points[4 * i] - kXMin) / kCell),
                   column = std::floor((points[4 * i + 1] - kYMin) / kCell);
      if (!(row >= 0 && row < kCellsX && column >= 0 && column < kCellsY && std::isfinite(points[4 * i + 2])))
        continue;
      cell[i] = static_cast<std::int32_t>(row) * static_cast<std::int32_t>(kCellsY) +
                static_cast<std::int32_t>(column);
      ++first_[static_cast<std::size_t>(cell[i]) + 1];
    }
    for (std::size_t k = 1; k < first_.size(); ++k) first_[k] += first_[k - 1];
    points_.resize(first_.back());
    std::vector<std::size_t> next(first_.begin(), first_.end() - 1);
    for (std::size_t i = 0; i < count; ++i)
      if (cell[i] >= 0) points_[next[static_cast<std::size_t>(cell[i])]++] = static_cast<std::int64_t>(i);
  }
  /// Of the cells up to `reach` m around (x, y).
  template <class Visit>
  void around(double x, double y, double reach, const Visit& visit) const {
    const auto bound = [](double at, std::int64_t size) {
      return std::clamp(static_cast<std::int64_t>(std::floor(at / kCell)), std::int64_t{0}, size - 1);
    };
    const std::int64_t low = bound(y - reach - kYMin, kCellsY), high = bound(y + reach - kYMin, kCellsY);
    for (std::int64_t row = bound(x - reach - kXMin, kCellsX); row <= bound(x + reach - kXMin, kCellsX);
         ++row)
      for (std::size_t k = first_[static_cast<std::size_t>(row * kCellsY + low)];
           k < first_[static_cast<std::size_t>(row * kCellsY + high) + 1]; ++k)
        visit(points_[k]);
  }

 private:
  std::vector<std::size_t> first_;  ///< by cell, in points_
  std::vector<std::int64_t> points_;
};

/// Returns and, behind them, what is watched; N × 4, float.
Tensor everything(const SensorTensors& input) {
  const Tensor points = input.points.detach().to(torch::kFloat);
  return (input.watched.defined() ? torch::cat({points, input.watched.detach().to(torch::kFloat)}) : points)
      .contiguous();
}

}  // namespace

RegionReturns::RegionReturns(const Tensor& boxes, const SensorTensors& input, int width, int height) {
  const Tensor all = everything(input), plain = boxes.detach().to(torch::kFloat).contiguous();
  const std::span<const float> points(all.data_ptr<float>(), static_cast<std::size_t>(all.numel()));
  const std::int64_t recorded = input.points.size(0);
  const LowestReturns returns(points.first(static_cast<std::size_t>(4 * recorded)),
                              {kXMin, kXMax, kYMin, kYMax, kZMin, kZMax});
  const Buckets buckets(points);
  std::vector<std::int64_t> row_of(static_cast<std::size_t>(all.size(0)), -1), mine;
  for (std::int64_t k = 0; k < plain.size(0); ++k) {
    const float* b = plain.data_ptr<float>() + 5 * k;
    const BevBox box{b[0], b[1], b[2], b[3], b[4]};
    const double floor = returns.ground(box), c = std::cos(box.yaw), s = std::sin(box.yaw);
    ground.push_back(static_cast<float>(floor));
    visible.push_back(car_in_picture(box, floor, input.projection, width, height) ? 1.f : 0.f);
    mine.clear();
    std::size_t watched = 0;
    buckets.around(box.x, box.y, std::hypot(kOwnAlong * box.length, kOwnAcross * box.width),
                   [&](std::int64_t i) {
                     const float* p = points.data() + 4 * i;
                     const double dx = p[0] - box.x, dy = p[1] - box.y;
                     if (std::abs(dx * c + dy * s) > kOwnAlong * box.length ||
                         std::abs(dy * c - dx * s) > kOwnAcross * box.width || p[2] < floor - kBelow ||
                         p[2] > floor + kAbove)
                       return;
                     mine.push_back(i);
                     if (i >= recorded) ++watched;
                   });
    std::sort(mine.begin(), mine.end());  // as the sweep has them: what is watched comes last
    const std::size_t own = mine.size() - watched,
                      step = std::max<std::size_t>(1, (own + kMostReturns - 1) / kMostReturns);
    const auto take = [&](std::int64_t i) {
      std::int64_t& row = row_of[static_cast<std::size_t>(i)];
      if (row < 0) {
        row = static_cast<std::int64_t>(rows_.size());
        if (seen_at(points.data() + 4 * i, input.projection, width, height)) seen_.push_back(row);
        rows_.push_back(i);
      }
      region.push_back(k);
      which.push_back(row);
    };
    for (std::size_t n = 0; n < own; n += step) take(mine[n]);
    for (std::size_t n = own; n < mine.size(); ++n) take(mine[n]);
  }
}

Tensor RegionReturns::points_of(const SensorTensors& input) const {
  Tensor all = input.points.narrow(1, 0, 3);
  if (input.watched.defined()) all = torch::cat({all, input.watched.narrow(1, 0, 3)});
  return all.index_select(0, torch::tensor(rows_));
}

Tensor RegionReturns::masses_of(const SensorTensors& input) const {
  const Tensor ones = torch::ones({input.points.size(0)}, input.points.options().requires_grad(false));
  return (input.watched.defined() ? torch::cat({ones, input.masses}) : ones)
      .index_select(0, torch::tensor(rows_));
}

Tensor RegionReturns::evidence_of(const SensorTensors& input, const Tensor& mask) const {
  const Tensor nothing =
      torch::zeros({static_cast<std::int64_t>(rows_.size())}, input.points.options().requires_grad(false));
  if (seen_.empty()) return nothing;
  const Tensor seen = torch::tensor(seen_), points = points_of(input).index_select(0, seen);
  const Tensor logits = bilinear(mask, places_in_map(pixels_of(points, input.projection), kMaskStride));
  return nothing.index_copy(0, seen, torch::sigmoid(logits).select(1, 0));
}

Tensor RegionReturns::occupancy(const Tensor& boxes, const Tensor& above, const SensorTensors& input,
                                const Tensor& mask) const {
  constexpr std::int64_t cells = kOccupiedAlong * kOccupiedAcross;
  const auto count = boxes.size(0);
  Tensor mass = torch::zeros({count * cells, kOccupiedLayers}, boxes.options().requires_grad(false));
  if (region.empty()) return mass.view({count, kOccupancy});
  const Tensor of = torch::tensor(region), row = torch::tensor(which);
  const Tensor box = boxes.index_select(0, of), point = points_of(input).index_select(0, row);
  const Tensor c = torch::cos(box.select(1, 4)), s = torch::sin(box.select(1, 4));
  const Tensor dx = point.select(1, 0) - box.select(1, 0), dy = point.select(1, 1) - box.select(1, 1);
  // Cells' centres at 0, 1, …: a return beyond the last fades out over a cell.
  const Tensor along =
                   ((dx * c + dy * s) / box.select(1, 2) / (2 * kOccupiedReach) + 0.5) * (kOccupiedAlong - 1),
               across = ((dy * c - dx * s) / box.select(1, 3) / (2 * kOccupiedAside) + 0.5) *
                        (kOccupiedAcross - 1);
  const Tensor high = ((point.select(1, 2) - above.index_select(0, of)) / kNominalHeight).clamp(0, 1);
  const Tensor evidence = evidence_of(input, mask).index_select(0, row);
  const Tensor layers =
      torch::stack({1 - high, high, evidence}, 1) * masses_of(input).index_select(0, row).unsqueeze(1);
  const Tensor low_along = torch::floor(along.detach()), low_across = torch::floor(across.detach());
  for (const int next_along : {0, 1})
    for (const int next_across : {0, 1}) {
      const Tensor i = low_along + next_along, j = low_across + next_across;
      const Tensor share = (1 - (along - i).abs()) * (1 - (across - j).abs());
      const Tensor inside =
          torch::nonzero((i >= 0) & (i < kOccupiedAlong) & (j >= 0) & (j < kOccupiedAcross)).squeeze(1);
      const Tensor cell = (of * cells + (i * kOccupiedAcross + j).to(torch::kLong)).index_select(0, inside);
      mass = mass.index_add(0, cell, (share.unsqueeze(1) * layers).index_select(0, inside));
    }
  return (mass / (1 + mass)).view({count, kOccupancy});
}

}  // namespace mirage::fusion
