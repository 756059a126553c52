#include "network.h"

#include <algorithm>

#include "base/sizes.h"
#include "region.h"
#include "sampling.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr double kEpsilon = 1e-3, kMomentum = 0.02;
thread_local SampleStatistics* active_statistics = nullptr;

namespace nn = torch::nn;
namespace fn = torch::nn::functional;

constexpr int kHidden = 48;  // of the fusion's MLP
constexpr std::array<int, kGrids.size()> kWidths = {kBevFeatures, 64, 96, 128};
constexpr int kPyramid = 64;
constexpr double kHeard = 0.3;  // RMS that a new non-local mean adds to features

/// The layer in training, with the sample's statistics.
Tensor normalise(ChannelNormImpl& norm, const Tensor& x, SampleStatistics& statistics) {
  const auto [y, mean, scale] =
      torch::native_batch_norm(x, norm.weight, norm.bias, {}, {}, true, kMomentum, kEpsilon);
  statistics.seen.push_back(
      {&norm, mean.detach().clone(), (scale.detach().square().reciprocal() - kEpsilon).clamp_min(0)});
  return y;
}

Tensor to_multiple(const Tensor& x, std::int64_t of) {
  const std::int64_t down = (of - x.size(2) % of) % of, right = (of - x.size(3) % of) % of;
  return down + right == 0 ? x : fn::pad(x, fn::PadFuncOptions({0, right, 0, down}));
}

}  // namespace

ChannelNormImpl::ChannelNormImpl(int channels) {
  weight = register_parameter("weight", torch::ones({channels}));
  bias = register_parameter("bias", torch::zeros({channels}));
  mean = register_buffer("mean", torch::zeros({channels}));
  variance = register_buffer("variance", torch::ones({channels}));
}

Tensor ChannelNormImpl::gain() const {
  return weight / torch::sqrt(variance + kEpsilon);
}

Tensor ChannelNormImpl::shift() const {
  return bias - mean * gain();
}

SampleStatistics::SampleStatistics() {
  active_statistics = this;
}

SampleStatistics::~SampleStatistics() {
  active_statistics = nullptr;
}

SampleStatistics* SampleStatistics::current() {
  return active_statistics;
}

void follow(const std::vector<SampleStatistics::Seen>& seen, std::int64_t samples) {
  const torch::NoGradGuard guard;
  const double share = std::max(kMomentum, 1 / static_cast<double>(std::max<std::int64_t>(1, samples)));
  for (const auto& [norm, mean, variance] : seen) {
    norm->mean.lerp_(mean, share);
    norm->variance.lerp_(variance, share);
  }
}

ConvNormImpl::ConvNormImpl(int in, int out, int kernel, int stride, bool relu) : relu_(relu) {
  conv = register_module(
      "conv",
      nn::Conv2d(nn::Conv2dOptions(in, out, kernel).stride(stride).padding((kernel - 1) / 2).bias(false)));
  channel_norm = register_module("norm", ChannelNorm(out));
  nn::init::kaiming_normal_(conv->weight, 0, torch::kFanOut, torch::kReLU);
}

Tensor ConvNormImpl::forward(const Tensor& x) {
  Tensor y;
  if (SampleStatistics* statistics = SampleStatistics::current()) {
    y = conv(x);
    if (y.scalar_type() == torch::kBFloat16) y = y.to(torch::kFloat);
    y = normalise(*channel_norm, y, *statistics);
  } else {
    const Tensor folded = conv->weight * channel_norm->gain().view({-1, 1, 1, 1});
    y = torch::conv2d(x, folded, channel_norm->shift(), conv->options.stride(), (folded.size(2) - 1) / 2);
  }
  return relu_ ? torch::relu(y) : y;
}

ResidualImpl::ResidualImpl(int channels) {
  first = register_module("first", ConvNorm(channels, channels, 3, 1));
  second = register_module("second", ConvNorm(channels, channels, 3, 1, false));
}

Tensor ResidualImpl::forward(const Tensor& x) {
  return torch::relu(x + second(first(x)));
}

NonLocalMeanImpl::NonLocalMeanImpl(int channels) {
  project = register_module("project", nn::Conv2d(nn::Conv2dOptions(channels, channels, 1).bias(false)));
  norm = register_module("norm", nn::GroupNorm(std::max(1, std::min(8, channels / 4)), channels));
  nn::init::kaiming_normal_(project->weight, 0, torch::kFanOut, torch::kReLU);
  const torch::NoGradGuard guard;
  nn::init::constant_(norm->weight, kHeard);
}

Tensor NonLocalMeanImpl::forward(const Tensor& x) {
  // Σ_j (x_i · x_j) x_j / N = (Σ_j x_j x_jᵀ / N) x_i: a matrix of channels × channels serves all places.
  const Tensor places = x.flatten(2);  // 1 × C × N
  const Tensor gram = torch::matmul(places, places.transpose(1, 2)) /
                      static_cast<double>(std::max<std::int64_t>(1, places.size(2)));
  Tensor mean = project(torch::matmul(gram, places).view_as(x));
  if (mean.scalar_type() == torch::kBFloat16) mean = mean.to(torch::kFloat);
  return x + norm(mean);
}

ContinuousFusionImpl::ContinuousFusionImpl(int features, int out) : out_(out) {
  hidden = register_module("hidden", nn::Linear(features + 3, kHidden));
  hidden2 = register_module("hidden2", nn::Linear(kHidden, kHidden));
  last = register_module("last", nn::Linear(kHidden, out));
}

Tensor ContinuousFusionImpl::rows(const Tensor& read, const Tensor& offset) {
  // In float even where convolutions run in bfloat16: rows of 48 gain nothing from it.
  const c10::impl::ExcludeDispatchKeyGuard in_float(c10::DispatchKey::AutocastCPU);
  return last(torch::relu(hidden2(torch::relu(hidden(torch::cat({read, offset}, 1))))));
}

Tensor ContinuousFusionImpl::forward(const Tensor& read, const Tensor& offset, const Tensor& cells,
                                     const Grid& grid) {
  const Tensor y = rows(read, offset);
  const Tensor dense = torch::zeros({grid.rows * grid.columns, out_}, y.options()).index_copy(0, cells, y);
  return dense.view({1, grid.rows, grid.columns, out_}).permute({0, 3, 1, 2});
}

NetworkImpl::NetworkImpl(const Parts& given_parts) : parts(given_parts) {
  if (parts.camera) camera = register_module("camera", CameraNet());
  if (!parts.lidar) return;
  const auto layer = [&](const char* name, int in, int out, int kernel, int stride, bool relu = true) {
    return register_module(name, ConvNorm(in, out, kernel, stride, relu));
  };
  const auto residual = [&](const char* name, int channels) {
    return register_module(name, Residual(channels));
  };
  const int layers = static_cast<int>(kVoxelsZ) + (parts.painted ? kPaintedChannels : 0);
  stem = layer("stem", layers, kWidths[0], 4, 2);
  group1 = residual("group1", kWidths[0]);
  down2 = layer("down2", kWidths[0], kWidths[1], 2, 2);
  group2a = residual("group2a", kWidths[1]);
  group2b = residual("group2b", kWidths[1]);
  down4 = layer("down4", kWidths[1], kWidths[2], 2, 2);
  group4a = residual("group4a", kWidths[2]);
  group4b = residual("group4b", kWidths[2]);
  down8 = layer("down8", kWidths[2], kWidths[3], 2, 2);
  group8 = residual("group8", kWidths[3]);
  lateral8 = layer("lateral8", kWidths[3], kPyramid, 1, 1, false);
  lateral4 = layer("lateral4", kWidths[2], kPyramid, 1, 1, false);
  lateral2 = layer("lateral2", kWidths[1], kPyramid, 1, 1, false);
  reduce = layer("reduce", kPyramid, kWidths[0], 3, 1, false);
  lateral1 = layer("lateral1", kWidths[0], kWidths[0], 1, 1, false);
  smooth = layer("smooth", kWidths[0], kWidths[0], 3, 1);
  head = register_module("head", nn::Conv2d(nn::Conv2dOptions(kWidths[0], kOutputs, 1)));
  if (parts.image) {
    constexpr int features = kCameraFeatures + 1;  // and the mask
    if (parts.denoising) denoise = register_module("denoise", NonLocalMean(kCameraFeatures));
    for (std::size_t level = 0; level < kGrids.size(); ++level)
      fuse[level] =
          register_module("fuse" + std::to_string(1 << level), ContinuousFusion(features, kWidths[level]));
  }
  if (parts.late) join = register_module("join", LateJoin());
  if (parts.second) second = register_module("second", SecondStage());
  torch::NoGradGuard guard;
  nn::init::normal_(head->weight, 0, 0.01);
  nn::init::zeros_(head->bias);
  head->bias[kLogit] = -4.0;  // a prior of 2 %: most cells hold no car (Lin et al., ICCV 2017)
  for (Tensor& parameter : parameters())
    if (parameter.dim() == 4) parameter.set_data(parameter.contiguous(torch::MemoryFormat::ChannelsLast));
}

Tensor NetworkImpl::read_map(const CameraOutput& seen) {
  const Tensor features = denoise.is_empty() ? seen.features : denoise(seen.features);
  return torch::cat({features, torch::avg_pool2d(seen.mask, kFeatureStride / kMaskStride)}, 1);
}

ReadFeatures NetworkImpl::read_image(const SensorTensors& input) {
  ReadFeatures sampled;
  const int width = static_cast<int>(input.image.size(1)), height = static_cast<int>(input.image.size(0));
  const Tensor rows =  // for the discrete choice of points only
      input.points.detach().to(torch::kFloat).contiguous();
  const std::span<const float> flat(rows.data_ptr<float>(), as_size(rows.numel()));
  sampled.nearest = nearest_points(flat, input.projection, width, height);
  // All scales read the same map: one look-up for all of them.
  std::vector<std::int64_t> indices;
  for (const NearestPoints& level : sampled.nearest)
    indices.insert(indices.end(), level.points.begin(), level.points.end());
  if (indices.empty()) return sampled;
  const Tensor all = input.points.narrow(1, 0, 3);
  sampled.points = all.index_select(0, torch::tensor(indices));
  const Tensor uvw = projected(sampled.points, input.projection);
  const Tensor uv = uvw.narrow(1, 0, 2) / uvw.narrow(1, 2, 1);

  sampled.map = read_map(see(input));
  sampled.read = bilinear(sampled.map.to(torch::kCPU), places_in_map(uv, kFeatureStride));
  if (parts.depth_gate) {
    const auto before = nearest_before(flat, input.projection, width, height, indices);
    const Tensor front = projected(all.index_select(0, torch::tensor(before)), input.projection).select(1, 2);
    sampled.read = sampled.read * depth_gate(uvw.select(1, 2), front).unsqueeze(1);
  }
  return sampled;
}

std::array<Tensor, kGrids.size()> NetworkImpl::fused(const SensorTensors& input) {
  std::array<Tensor, kGrids.size()> added;
  const ReadFeatures sampled = read_image(input);
  if (!sampled.read.defined()) return added;
  const torch::Device device = head->weight.device();
  std::int64_t from = 0;
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    const Grid& grid = kGrids[level];
    const std::vector<std::int64_t>& cells = sampled.nearest[level].cells;
    const auto count = static_cast<std::int64_t>(cells.size());
    if (count == 0) continue;
    const Tensor centres = centres_of(cells, grid);
    const Tensor offset = sampled.points.narrow(0, from, count) - centres.to(sampled.points.dtype());
    added[level] = fuse[level](sampled.read.narrow(0, from, count).to(device), offset.to(device),
                               torch::tensor(cells).to(device), grid);
    from += count;
  }
  return added;
}

CameraOutput NetworkImpl::see(const SensorTensors& input, bool with_boxes) {
  if (input.camera.defined()) return input.camera;
  if (camera.is_empty() || !input.image.defined() || input.image.numel() == 0) return {};
  return camera(input.image, with_boxes || parts.late || !parts.lidar);
}

SensorTensors in_type_of(NetworkImpl& network, SensorTensors input) {
  const torch::Dtype type =
      (network.head.is_empty() ? network.camera->mask_out->weight : network.head->weight).scalar_type();
  if (input.image.defined()) input.image = input.image.to(type);
  input.points = input.points.to(type);
  if (input.watched.defined()) input.watched = input.watched.to(type), input.masses = input.masses.to(type);
  return input;
}

FirstStage NetworkImpl::first_stage(const SensorTensors& sensors) {
  SensorTensors input = sensors;
  input.camera = see(sensors);  // once, for every part that reads it
  const bool picture = input.image.defined() && input.image.numel() > 0;
  std::array<Tensor, kGrids.size()> added;
  if (parts.image && picture) added = fused(input);
  const auto with = [&](std::size_t level, const Tensor& x) {
    return added[level].defined() ? x + added[level] : x;
  };
  Tensor voxels = soft_voxels(input.points, input.watched, input.masses);
  if (parts.painted) voxels = torch::cat({voxels, painted_voxels(input)}, 1);
  const Tensor x1 = group1(with(0, stem(voxels.to(head->weight.device()))));
  const Tensor x2 = group2b(group2a(with(1, down2(x1))));
  const Tensor x4 = group4b(group4a(with(2, down4(x2))));
  const Tensor x8 = group8(with(3, down8(to_multiple(x4, 2))));
  const Tensor up8 = twice(lateral8(x8)).narrow(2, 0, x4.size(2));
  const Tensor p4 = torch::relu(lateral4(x4) + up8);
  const Tensor p2 = torch::relu(lateral2(x2) + twice(p4));
  const Tensor p1 = torch::relu(lateral1(x1) + twice(reduce(p2)));
  const Tensor bev = smooth(p1);
  const torch::Dtype type = input.points.scalar_type();
  FirstStage first;
  first.output = head(bev).squeeze(0).to(torch::kCPU).to(type);
  if (!parts.second || !picture) return first;
  first.bev = bev.to(torch::kCPU).to(type);
  first.picture = read_map(input.camera).to(torch::kCPU).to(type);
  first.mask = input.camera.mask.to(torch::kCPU).to(type);
  return first;
}

Tensor NetworkImpl::forward(const SensorTensors& sensors) {
  SensorTensors input = sensors;
  input.camera = see(sensors);
  const bool picture = input.image.defined() && input.image.numel() > 0;
  const FirstStage first = first_stage(input);
  if (parts.late && picture) return join(first.output, input);
  return parts.second && picture ? second(first, input) : first.output;
}

}  // namespace mirage::fusion
