#include "second_stage.h"

#include <algorithm>
#include <cmath>

#include "bilinear.h"
#include "detection/car_in_picture.h"
#include "highest.h"
#include "region.h"
#include "region_returns.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr float kLeastLogit = -4;
constexpr std::size_t kMostRegions = 256;
constexpr int kRasterAlong = 7, kRasterAcross = 5, kPictureSide = 7;          // places of the rasters
constexpr double kAlongReach = 1.4, kAcrossReach = 1.8, kPictureReach = 1.2;  // of the box's extents
constexpr int kBevPlace = 24, kPicturePlace = 24, kRegionWidth = 96, kGeometryValues = 8, kStageHidden = 128;
constexpr double kLeastDepth = 0.1;  // m: of a corner behind the camera (car_in_picture)
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

/// The boxes that the first stage's regressed values mean: n × 5, differentiable.
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
  const Tensor uv = uvw.narrow(2, 0, 2) / uvw.narrow(2, 2, 1).clamp_min(kLeastDepth);
  const Tensor low = uv.amin(1), high = uv.amax(1);  // n × 2
  const Tensor middle = (low + high) / 2, size = kPictureReach * (high - low);
  const Tensor steps = raster(kPictureSide, boxes);
  const auto [u, v] = all_pairs(middle.narrow(1, 0, 1) + size.narrow(1, 0, 1) * steps,
                                middle.narrow(1, 1, 1) + size.narrow(1, 1, 1) * steps);
  const Tensor at = places_in_map(torch::stack({u, v}, 2).view({-1, 2}), kImageStride);
  return bilinear(map, at).view({boxes.size(0), kPictureSide * kPictureSide, map.size(1)});
}

}  // namespace

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
  // It starts as the first stage: of what it reads, nothing is silenced but its word.
  const torch::NoGradGuard guard;
  last->weight.zero_();
  last->bias.zero_();
}

std::vector<std::int64_t> SecondStageImpl::chosen(const FirstStage& first) {
  return highest(first.output[kLogit].reshape({-1}), kLeastLogit, kMostRegions);
}

Regions SecondStageImpl::look(const FirstStage& first, const SensorTensors& input,
                              std::vector<std::int64_t> cells) {
  // In float even where convolutions run in bfloat16: places in metres want their digits.
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

  // What is discrete: the ground below each box, whether it is in the picture, which returns are its own.
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
  const Regions regions = look(first, input, cells);
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
