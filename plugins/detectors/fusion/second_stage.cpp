#include "second_stage.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "region.h"
#include "sampling.h"

namespace mirage::fusion {

std::vector<std::int64_t> highest(const torch::Tensor& logits, float least, std::size_t most) {
  const torch::Tensor plain = logits.detach().to(torch::kFloat).contiguous();
  const float* value = plain.data_ptr<float>();
  std::vector<std::int64_t> places;
  for (std::int64_t k = 0; k < plain.numel(); ++k)
    if (value[k] > least) places.push_back(k);
  if (places.size() > most) {
    std::nth_element(places.begin(), places.begin() + static_cast<std::ptrdiff_t>(most), places.end(),
                     [&](std::int64_t a, std::int64_t b) {
                       return value[a] > value[b] || (value[a] == value[b] && a < b);
                     });
    places.resize(most);
    std::sort(places.begin(), places.end());
  }
  return places;
}

namespace {

using torch::Tensor;

constexpr double kOccupiedReach = 0.7, kOccupiedAside = 1;  // the raster's reach, in lengths and widths
constexpr double kOwnAlong = 0.8, kOwnAcross = 1.2, kBelow = 0.3, kAbove = 2.7;  // lengths, widths, m
constexpr std::size_t kMaxReturns = 128;                                         // of a region

/// Points in the region, by cell of the first grid.
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
      ++first_[as_size(cell[i]) + 1];
    }
    for (std::size_t k = 1; k < first_.size(); ++k) first_[k] += first_[k - 1];
    points_.resize(first_.back());
    std::vector<std::size_t> next(first_.begin(), first_.end() - 1);
    for (std::size_t i = 0; i < count; ++i)
      if (cell[i] >= 0) points_[next[as_size(cell[i])]++] = static_cast<std::int64_t>(i);
  }
  /// Visits the points of the cells up to `reach` m around (x, y).
  template <class Visit>
  void around(double x, double y, double reach, const Visit& visit) const {
    const auto bound = [](double at, std::int64_t size) {
      return std::clamp(static_cast<std::int64_t>(std::floor(at / kCell)), std::int64_t{0}, size - 1);
    };
    const std::int64_t low = bound(y - reach - kYMin, kCellsY), high = bound(y + reach - kYMin, kCellsY);
    for (std::int64_t row = bound(x - reach - kXMin, kCellsX); row <= bound(x + reach - kXMin, kCellsX);
         ++row)
      for (std::size_t k = first_[as_size(row * kCellsY + low)];
           k < first_[as_size(row * kCellsY + high) + 1]; ++k)
        visit(points_[k]);
  }

 private:
  std::vector<std::size_t> first_;  ///< by cell, in points_
  std::vector<std::int64_t> points_;
};

/// Returns and, behind them, watched places; N × 4, float.
Tensor everything(const SensorTensors& input) {
  const Tensor points = input.points.detach().to(torch::kFloat);
  return (input.watched.defined() ? torch::cat({points, input.watched.detach().to(torch::kFloat)}) : points)
      .contiguous();
}

constexpr float kMinLogit = -4;
constexpr std::size_t kMaxRegions = 256;
constexpr int kRasterAlong = 7, kRasterAcross = 5, kPictureSide = 7;          // places of the rasters
constexpr double kAlongReach = 1.4, kAcrossReach = 1.8, kPictureReach = 1.2;  // of the box's extents
constexpr int kBevPlace = 24, kPicturePlace = 24, kRegionWidth = 96, kGeometryValues = 8, kStageHidden = 128;
constexpr double kMinDepth = 0.1;  // m: of a corner behind the camera (car_in_picture)
constexpr double kFarAway = 70, kLogitScale = 4;

/// `count` places from −1/2 to 1/2.
Tensor raster(int count, const Tensor& like) {
  return torch::linspace(-0.5, 0.5, count, like.options());
}

/// Rows of both, all pairs: n × (a · b) each.
std::pair<Tensor, Tensor> all_pairs(const Tensor& a, const Tensor& b) {
  const auto rows = a.size(0), many = a.size(1), more = b.size(1);
  return {a.unsqueeze(2).expand({rows, many, more}).reshape({rows, many * more}),
          b.unsqueeze(1).expand({rows, many, more}).reshape({rows, many * more})};
}

/// The boxes that the first stage's regressed values encode: n × 5, differentiable.
Tensor decoded(const Tensor& values, const std::vector<std::int64_t>& cells) {
  const Tensor centres = centres_of(cells, kGrids[0]).to(values.scalar_type());
  const Tensor sine = values[kSin2Yaw], cosine = values[kCos2Yaw];
  // No direction at all is straight ahead: atan2 has no slope there.
  const Tensor some = torch::where(sine.square() + cosine.square() > 1e-12, cosine, torch::ones_like(cosine));
  return torch::stack({centres.select(1, 0) + values[kDx], centres.select(1, 1) + values[kDy],
                       kMeanLength * torch::exp(values[kLogLength].clamp(-3, 3)),
                       kMeanWidth * torch::exp(values[kLogWidth].clamp(-3, 3)), torch::atan2(sine, some) / 2},
                      1);
}

/// Points at (along, across), n × m each (m), of the boxes' frames: x and y, n × m each.
std::pair<Tensor, Tensor> in_view(const Tensor& boxes, const Tensor& along, const Tensor& across) {
  const Tensor c = torch::cos(boxes.narrow(1, 4, 1)), s = torch::sin(boxes.narrow(1, 4, 1));
  return {boxes.narrow(1, 0, 1) + along * c - across * s, boxes.narrow(1, 1, 1) + along * s + across * c};
}

/// The bird's-eye view's features over the boxes' rasters: n × places × features.
Tensor from_above(const Tensor& bev, const Tensor& boxes) {
  const auto [along, across] = all_pairs(kAlongReach * boxes.narrow(1, 2, 1) * raster(kRasterAlong, boxes),
                                         kAcrossReach * boxes.narrow(1, 3, 1) * raster(kRasterAcross, boxes));
  const auto [x, y] = in_view(boxes, along, across);
  const Tensor at = torch::stack({(y - kYMin) / kCell - 0.5, (x - kXMin) / kCell - 0.5}, 2);
  return bilinear(bev, at.view({-1, 2})).view({boxes.size(0), kRasterAlong * kRasterAcross, bev.size(1)});
}

/// The picture's features over the rectangles that cars' boxes on `ground` cover: n × places × features.
Tensor from_picture(const Tensor& map, const Tensor& boxes, const Tensor& ground,
                    const Projection& projection) {
  const auto type = boxes.options().requires_grad(false);
  const Tensor l = torch::tensor({.5, .5, -.5, -.5, .5, .5, -.5, -.5}, type),
               w = torch::tensor({.5, -.5, .5, -.5, .5, -.5, .5, -.5}, type),
               h = torch::tensor({0., 0., 0., 0., 1., 1., 1., 1.}, type) * kNominalHeight;
  const auto [x, y] = in_view(boxes, boxes.narrow(1, 2, 1) * l, boxes.narrow(1, 3, 1) * w);
  const Tensor z = ground.unsqueeze(1) + h;
  const Tensor uvw = projected(torch::stack({x, y, z}, 2).view({-1, 3}), projection).view({-1, 8, 3});
  const Tensor uv = uvw.narrow(2, 0, 2) / uvw.narrow(2, 2, 1).clamp_min(kMinDepth);
  const Tensor low = uv.amin(1), high = uv.amax(1);  // n × 2
  const Tensor middle = (low + high) / 2, size = kPictureReach * (high - low);
  const Tensor steps = raster(kPictureSide, boxes);
  const auto [u, v] = all_pairs(middle.narrow(1, 0, 1) + size.narrow(1, 0, 1) * steps,
                                middle.narrow(1, 1, 1) + size.narrow(1, 1, 1) * steps);
  const Tensor at = places_in_map(torch::stack({u, v}, 2).view({-1, 2}), kFeatureStride);
  return bilinear(map, at).view({boxes.size(0), kPictureSide * kPictureSide, map.size(1)});
}

}  // namespace

RegionReturns::RegionReturns(const Tensor& boxes, const SensorTensors& input, int width, int height) {
  const Tensor all = everything(input), plain = boxes.detach().to(torch::kFloat).contiguous();
  const std::span<const float> points(all.data_ptr<float>(), as_size(all.numel()));
  const std::int64_t recorded = input.points.size(0);
  const LowestReturns returns(points.first(as_size(4 * recorded)));
  const Buckets buckets(points);
  std::vector<std::int64_t> row_of(as_size(all.size(0)), -1), mine;
  for (std::int64_t k = 0; k < plain.size(0); ++k) {
    const BevBox box = bev_box(plain.data_ptr<float>() + kBoxParts * k);
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
    std::sort(mine.begin(), mine.end());  // in the sweep's order: watched places come last
    const std::size_t own = mine.size() - watched,
                      step = std::max<std::size_t>(1, (own + kMaxReturns - 1) / kMaxReturns);
    const auto take = [&](std::int64_t i) {
      std::int64_t& row = row_of[as_size(i)];
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
  const Tensor logits = features_at(mask, points, input.projection, kMaskStride);
  return nothing.index_copy(0, seen, torch::sigmoid(logits).select(1, 0));
}

Tensor RegionReturns::occupancy(const Tensor& boxes, const Tensor& ground_heights, const SensorTensors& input,
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
  const Tensor high =
      ((point.select(1, 2) - ground_heights.index_select(0, of)) / kNominalHeight).clamp(0, 1);
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

Tensor Regions::refined() const {
  const Tensor units = torch::tensor(std::vector<double>(kChangeUnits.begin(), kChangeUnits.end()),
                                     boxes.options().requires_grad(false));
  const Tensor by = change * units;
  const auto [x, y] = in_view(boxes, by.narrow(1, 0, 1), by.narrow(1, 1, 1));
  return torch::cat({x, y, boxes.narrow(1, 2, 2) * torch::exp(by.narrow(1, 2, 2).clamp(-1, 1)),
                     boxes.narrow(1, 4, 1) + by.narrow(1, 4, 1)},
                    1);
}

SecondStageImpl::SecondStageImpl() {
  const auto linear = [&](const char* name, int in, int out) {
    return register_module(name, torch::nn::Linear(in, out));
  };
  bev_place = linear("bev_place", kBevFeatures, kBevPlace);
  bev_region = linear("bev_region", kBevPlace * kRasterAlong * kRasterAcross, kRegionWidth);
  picture_place = linear("picture_place", kCameraFeatures + 1, kPicturePlace);
  picture_region = linear("picture_region", kPicturePlace * kPictureSide * kPictureSide, kRegionWidth);
  returns_region = linear("returns_region", kOccupancy, kRegionWidth);
  together = linear("together", 3 * kRegionWidth + kGeometryValues, kStageHidden);
  hidden = linear("hidden", kStageHidden, kStageHidden);
  last = linear("last", kStageHidden, 1 + kBoxParts);
  // It starts as the first stage: only its last layer is zero.
  const torch::NoGradGuard guard;
  last->weight.zero_();
  last->bias.zero_();
}

std::vector<std::int64_t> SecondStageImpl::chosen(const FirstStage& first) {
  return highest(first.output[kLogit].reshape({-1}), kMinLogit, kMaxRegions);
}

Regions SecondStageImpl::find_regions(const FirstStage& first, const SensorTensors& input,
                                      std::vector<std::int64_t> cells) {
  // In float even where convolutions run in bfloat16: places in metres need the precision.
  const c10::impl::ExcludeDispatchKeyGuard in_float(c10::DispatchKey::AutocastCPU);
  Regions regions;
  const Tensor flat = first.output.reshape({kOutputs, -1});
  regions.cells = std::move(cells);
  const auto count = static_cast<std::int64_t>(regions.cells.size());
  const auto type = first.output.options().requires_grad(false);
  const Tensor values = flat.index_select(1, torch::tensor(regions.cells, torch::kLong));
  regions.boxes = decoded(values, regions.cells);
  regions.logits = values[kLogit];
  regions.change = torch::zeros({count, kBoxParts}, type);
  if (count == 0) return regions;
  const Tensor& boxes = regions.boxes;

  // Discrete values: the ground below each box, whether it is in the picture, and the choice of its returns.
  const int width = static_cast<int>(input.image.size(1)), height = static_cast<int>(input.image.size(0));
  const RegionReturns found(boxes, input, width, height);
  const Tensor ground = torch::tensor(found.ground).to(type.dtype()),
               visible = torch::tensor(found.visible).to(type.dtype()).unsqueeze(1);

  const Tensor above = torch::relu(bev_place(from_above(first.bev, boxes))).flatten(1);
  const Tensor seen =
      torch::relu(picture_place(from_picture(first.picture, boxes, ground, input.projection))).flatten(1) *
      visible;
  const Tensor occupied = found.occupancy(boxes, ground, input, first.mask);
  const Tensor bearing = torch::atan2(boxes.select(1, 1), boxes.select(1, 0)) - boxes.select(1, 4);
  const Tensor geometry = torch::stack(
      {torch::hypot(boxes.select(1, 0), boxes.select(1, 1)) / kFarAway,
       torch::log(boxes.select(1, 2) / kMeanLength), torch::log(boxes.select(1, 3) / kMeanWidth), ground / 2,
       regions.logits / kLogitScale, torch::sin(2 * bearing), torch::cos(2 * bearing), visible.squeeze(1)},
      1);
  const Tensor all = torch::cat({torch::relu(bev_region(above)), torch::relu(picture_region(seen)),
                                 torch::relu(returns_region(occupied)), geometry},
                                1);
  const Tensor word = last(torch::relu(hidden(torch::relu(together(all)))));
  regions.logits = regions.logits + word.select(1, 0);
  regions.change = word.narrow(1, 1, kBoxParts);
  return regions;
}

Tensor SecondStageImpl::forward(const FirstStage& first, const SensorTensors& input) {
  return refine(first, input, chosen(first));
}

Tensor SecondStageImpl::refine(const FirstStage& first, const SensorTensors& input,
                               const std::vector<std::int64_t>& cells) {
  const Regions regions = find_regions(first, input, cells);
  if (regions.cells.empty()) return first.output;
  const Tensor boxes = regions.refined();
  const Tensor centres = centres_of(regions.cells, kGrids[0]).to(boxes.scalar_type());
  const Tensor columns = torch::stack(
      {regions.logits, boxes.select(1, 0) - centres.select(1, 0), boxes.select(1, 1) - centres.select(1, 1),
       torch::log(boxes.select(1, 2) / kMeanLength), torch::log(boxes.select(1, 3) / kMeanWidth),
       torch::sin(2 * boxes.select(1, 4)), torch::cos(2 * boxes.select(1, 4))});
  return first.output.reshape({kOutputs, -1})
      .index_copy(1, torch::tensor(regions.cells, torch::kLong), columns)
      .view_as(first.output);
}

}  // namespace mirage::fusion
