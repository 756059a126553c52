#include "network.h"

#include <algorithm>

#include "region.h"
#include "voxels.h"

namespace mirage::fusion {
namespace {

namespace nn = torch::nn;
namespace fn = torch::nn::functional;
using torch::Tensor;

constexpr int kImageFeatures = 32;
constexpr int kFine = 32, kCoarse = 64, kDeep = 96, kPyramid = 48;
constexpr int kSmallestImage = 32;  // pixels a side; smaller ones vanish on the way to an eighth

Tensor upsample(const Tensor& x, const Tensor& like) {
  return fn::interpolate(x, fn::InterpolateFuncOptions()
                                .size(std::vector<std::int64_t>{like.size(2), like.size(3)})
                                .mode(torch::kNearest));
}

}  // namespace

// Strided kernels are even (4 × 4, padding 1): the centre of output i lies at 2 i + 1/2, the middle of the
// two cells it replaces, so that grids of all strides share their edges.
ConvNormImpl::ConvNormImpl(int in, int out, int kernel, int stride, bool relu) : relu_(relu) {
  conv = register_module(
      "conv",
      nn::Conv2d(nn::Conv2dOptions(in, out, kernel).stride(stride).padding((kernel - 1) / 2).bias(false)));
  norm = register_module("norm", nn::GroupNorm(std::max(1, std::min(8, out / 4)), out));
  nn::init::kaiming_normal_(conv->weight, 0, torch::kFanOut, torch::kReLU);
}

Tensor ConvNormImpl::forward(const Tensor& x) {
  const Tensor y = norm(conv(x));
  return relu_ ? torch::relu(y) : y;
}

ResidualImpl::ResidualImpl(int channels) {
  first = register_module("first", ConvNorm(channels, channels, 3, 1));
  second = register_module("second", ConvNorm(channels, channels, 3, 1, false));
}

Tensor ResidualImpl::forward(const Tensor& x) {
  return torch::relu(x + second(first(x)));
}

ImageBranchImpl::ImageBranchImpl() {
  stem = register_module("stem", ConvNorm(3, 16, 4, 2));
  block2 = register_module("block2", Residual(16));
  down4 = register_module("down4", ConvNorm(16, 32, 4, 2));
  block4 = register_module("block4", Residual(32));
  down8 = register_module("down8", ConvNorm(32, 64, 4, 2));
  block8 = register_module("block8", Residual(64));
  lateral4 = register_module("lateral4", ConvNorm(32, kImageFeatures, 1, 1, false));
  lateral8 = register_module("lateral8", ConvNorm(64, kImageFeatures, 1, 1, false));
  smooth = register_module("smooth", ConvNorm(kImageFeatures, kImageFeatures, 3, 1));
}

Tensor ImageBranchImpl::forward(const Tensor& picture) {
  // A square root spreads the shadows much as sRGB does; the small term bounds its slope at black.
  const Tensor tone = torch::sqrt(picture.clamp_min(0) + 1e-3);
  const Tensor full = ((tone - 0.45) / 0.28).permute({2, 0, 1}).unsqueeze(0);
  const Tensor half = torch::avg_pool2d(full, 2);
  const Tensor x2 = block2(stem(half));
  const Tensor x4 = block4(down4(x2));
  const Tensor x8 = block8(down8(x4));
  return smooth(torch::relu(lateral4(x4) + upsample(lateral8(x8), x4)));
}

ContinuousFusionImpl::ContinuousFusionImpl(int out, std::int64_t rows, std::int64_t columns, double cell)
    : out_(out), rows_(rows), columns_(columns), cell_(cell) {
  hidden = register_module("hidden", nn::Linear(kImageFeatures + 3, 64));
  hidden2 = register_module("hidden2", nn::Linear(64, 64));
  last = register_module("last", nn::Linear(64, out));
}

Tensor ContinuousFusionImpl::forward(const Tensor& features, const SensorTensors& input) {
  const Tensor rows = input.points.detach().contiguous();  // for the discrete choice of points only
  const int width = static_cast<int>(input.image.size(1)), height = static_cast<int>(input.image.size(0));
  const NearestPoints nearest =
      nearest_points({rows.data_ptr<float>(), static_cast<std::size_t>(rows.numel())}, input.projection,
                     width, height, rows_, columns_, cell_);
  const auto count = static_cast<std::int64_t>(nearest.cells.size());
  if (count == 0) return {};
  const Tensor cells = torch::tensor(nearest.cells), chosen = torch::tensor(nearest.points);
  Tensor centres = torch::empty({count, 3});
  for (std::int64_t k = 0; k < count; ++k) {
    float* centre = centres.data_ptr<float>() + 3 * k;
    centre[0] = static_cast<float>(cell_x(nearest.cells[k] / columns_, cell_));
    centre[1] = static_cast<float>(cell_y(nearest.cells[k] % columns_, cell_));
    centre[2] = -1;  // halfway up a car
  }
  const Tensor points = input.points.narrow(1, 0, 3).index_select(0, chosen);

  std::vector<double> m(input.projection.begin(), input.projection.end());
  const Tensor matrix = torch::tensor(m, torch::kFloat).view({3, 4});
  const Tensor uvw = torch::matmul(points, matrix.narrow(1, 0, 3).t()) + matrix.select(1, 3);
  const Tensor uv = uvw.narrow(1, 0, 2) / uvw.narrow(1, 2, 1);
  // Pixel centres are whole numbers: edges lie at −1/2 and width − 1/2, which grid_sample calls −1 and 1.
  const Tensor size =
      torch::tensor({static_cast<float>(features.size(3) * 8), static_cast<float>(features.size(2) * 8)});
  const Tensor grid = (2 * (uv + 0.5) / size - 1).view({1, 1, count, 2});
  const Tensor sampled = fn::grid_sample(
      features, grid,
      fn::GridSampleFuncOptions().mode(torch::kBilinear).padding_mode(torch::kBorder).align_corners(false));
  const Tensor read = sampled.view({kImageFeatures, count}).t();

  const Tensor joined = torch::cat({read, points - centres}, 1);
  const Tensor y = last(torch::relu(hidden2(torch::relu(hidden(joined)))));
  const Tensor dense = torch::zeros({rows_ * columns_, out_}).index_copy(0, cells, y);
  return dense.view({1, rows_, columns_, out_}).permute({0, 3, 1, 2});
}

NetworkImpl::NetworkImpl(bool with_image) {
  stem = register_module("stem", ConvNorm(static_cast<int>(kVoxelsZ), kFine, 4, 2));
  block1 = register_module("block1", Residual(kFine));
  down2 = register_module("down2", ConvNorm(kFine, kCoarse, 4, 2));
  block2a = register_module("block2a", Residual(kCoarse));
  block2b = register_module("block2b", Residual(kCoarse));
  down4 = register_module("down4", ConvNorm(kCoarse, kDeep, 4, 2));
  block4a = register_module("block4a", Residual(kDeep));
  block4b = register_module("block4b", Residual(kDeep));
  lateral4 = register_module("lateral4", ConvNorm(kDeep, kPyramid, 1, 1, false));
  lateral2 = register_module("lateral2", ConvNorm(kCoarse, kPyramid, 1, 1, false));
  reduce = register_module("reduce", ConvNorm(kPyramid, kFine, 3, 1, false));
  lateral1 = register_module("lateral1", ConvNorm(kFine, kFine, 1, 1, false));
  smooth = register_module("smooth", ConvNorm(kFine, kFine, 3, 1));
  head = register_module("head", nn::Conv2d(nn::Conv2dOptions(kFine, kOutputs, 1)));
  if (with_image) {
    image = register_module("image", ImageBranch());
    fuse_fine = register_module("fuse_fine", ContinuousFusion(kFine, kCellsX, kCellsY, kCell));
    fuse_coarse = register_module("fuse_coarse", ContinuousFusion(kCoarse, kCoarseX, kCoarseY, kCoarseCell));
  }
  torch::NoGradGuard guard;
  nn::init::normal_(head->weight, 0, 0.01);
  nn::init::zeros_(head->bias);
  head->bias[kLogit] = -4.0;  // a prior of 2 %: most cells hold no car (Lin et al., ICCV 2017)
}

Tensor NetworkImpl::forward(const SensorTensors& input) {
  Tensor fine_image, coarse_image;
  if (!image.is_empty() && input.image.defined() && input.image.size(0) >= kSmallestImage &&
      input.image.size(1) >= kSmallestImage) {
    const Tensor features = image(input.image);
    fine_image = fuse_fine(features, input);
    coarse_image = fuse_coarse(features, input);
  }
  Tensor x1 = stem(soft_voxels(input.points));
  if (fine_image.defined()) x1 = x1 + fine_image;
  x1 = block1(x1);
  Tensor x2 = down2(x1);
  if (coarse_image.defined()) x2 = x2 + coarse_image;
  x2 = block2b(block2a(x2));
  const Tensor x4 = block4b(block4a(down4(x2)));
  const Tensor p2 = torch::relu(lateral2(x2) + upsample(lateral4(x4), x2));
  const Tensor p1 = torch::relu(lateral1(x1) + upsample(reduce(p2), x1));
  return head(smooth(p1)).squeeze(0);
}

}  // namespace mirage::fusion
