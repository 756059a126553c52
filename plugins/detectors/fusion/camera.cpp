#include "camera.h"

#include <torch/script.h>

#include <cmath>
#include <stdexcept>

namespace mirage::fusion {
namespace {

namespace nn = torch::nn;
namespace fn = torch::nn::functional;
using torch::Tensor;

constexpr std::array<int, 3> kStrides = {8, 16, 32};
constexpr std::int64_t kMaxFeatureDepth = 32;
constexpr double kPaddingGrey = 114;  // the training's value beyond a picture's border
constexpr std::int64_t kCocoCar = 2, kCocoClasses = 80;

nn::Conv2d plain_conv(int in, int out) {
  return nn::Conv2d(nn::Conv2dOptions(in, out, 1));
}

}  // namespace

std::int64_t padded_size(std::int64_t size) {
  return (size + kMaxFeatureDepth - 1) / kMaxFeatureDepth * kMaxFeatureDepth;
}

Tensor network_picture(const Tensor& linear, std::int64_t rows, std::int64_t columns) {
  const Tensor x = linear.clamp(0, 1);
  // The power's slope is infinite at 0, where the other branch is taken: bounded before, so that no NaN
  // comes back through the branch that is not.
  const Tensor curve = 1.055 * x.clamp_min(0.0031308).pow(1 / 2.4) - 0.055;
  const Tensor srgb = torch::where(x <= 0.0031308, 12.92 * x, curve) * 255;
  const Tensor bgr = srgb.flip(2).permute({2, 0, 1}).unsqueeze(0);
  const std::int64_t down = rows - bgr.size(2), right = columns - bgr.size(3);
  return fn::pad(bgr, fn::PadFuncOptions({0, right, 0, down}).value(kPaddingGrey));
}

Tensor twice(const Tensor& x) {
  return fn::interpolate(
      x, fn::InterpolateFuncOptions().scale_factor(std::vector<double>{2, 2}).mode(torch::kNearest));
}

Tensor focus(const Tensor& x) {
  using torch::indexing::None;
  using torch::indexing::Slice;
  const auto part = [&](int row, int column) {
    return x.index({Slice(), Slice(), Slice(row, None, 2), Slice(column, None, 2)});
  };
  return torch::cat({part(0, 0), part(1, 0), part(0, 1), part(1, 1)}, 1)
      .contiguous(torch::MemoryFormat::ChannelsLast);
}

ConvSiluImpl::ConvSiluImpl(int in, int out, int kernel, int stride, int groups) {
  conv = register_module(
      "conv",
      nn::Conv2d(nn::Conv2dOptions(in, out, kernel).stride(stride).padding((kernel - 1) / 2).groups(groups)));
  // No norm holds the signal up: without this it dies on its way through sixty fresh layers.
  nn::init::kaiming_normal_(conv->weight, 0, torch::kFanIn, torch::kReLU);
  const torch::NoGradGuard guard;
  nn::init::zeros_(conv->bias);
}

Tensor ConvSiluImpl::forward(const Tensor& x) {
  return torch::silu(conv(x));
}

DepthwiseImpl::DepthwiseImpl(int in, int out, int stride) {
  each = register_module("each", ConvSilu(in, in, 3, stride, in));
  across = register_module("across", ConvSilu(in, out, 1));
}

Tensor DepthwiseImpl::forward(const Tensor& x) {
  return across(each(x));
}

// Modules are registered in the order in which YOLOX lists its layers: read_coco relies on it.
CspImpl::CspImpl(int in, int out, int depth, bool shortcut) : shortcut_(shortcut) {
  const int half = out / 2;
  through = register_module("through", ConvSilu(in, half, 1));
  past = register_module("past", ConvSilu(in, half, 1));
  for (int i = 0; i < depth; ++i) {
    narrow.push_back(register_module("narrow" + std::to_string(i), ConvSilu(half, half, 1)));
    wide.push_back(register_module("wide" + std::to_string(i), Depthwise(half, half)));
  }
  join = register_module("join", ConvSilu(2 * half, out, 1));
}

Tensor CspImpl::forward(const Tensor& x) {
  Tensor y = through(x);
  for (std::size_t i = 0; i < narrow.size(); ++i) {
    const Tensor z = wide[i](narrow[i](y));
    y = shortcut_ ? y + z : z;
  }
  return join(torch::cat({y, past(x)}, 1));
}

PictureHeadImpl::PictureHeadImpl(int in) {
  constexpr int width = 64;
  stem = register_module("stem", ConvSilu(in, width, 1));
  class1 = register_module("class1", Depthwise(width, width));
  class2 = register_module("class2", Depthwise(width, width));
  class_out = register_module("class_out", plain_conv(width, 1));
  box1 = register_module("box1", Depthwise(width, width));
  box2 = register_module("box2", Depthwise(width, width));
  box_out = register_module("box_out", plain_conv(width, 4));
  object_out = register_module("object_out", plain_conv(width, 1));
  const torch::NoGradGuard guard;
  object_out->bias.fill_(-4.6);  // a prior of 1 %
  class_out->bias.fill_(0);
}

Tensor PictureHeadImpl::forward(const Tensor& x) {
  const Tensor start = stem(x);
  const Tensor box = box2(box1(start));
  return torch::cat({box_out(box), object_out(box), class_out(class2(class1(start)))}, 1);
}

CameraNetImpl::CameraNetImpl() {
  stem = register_module("stem", ConvSilu(12, 16, 3));
  down4 = register_module("down4", Depthwise(16, 32, 2));
  group4 = register_module("group4", Csp(32, 32, 1, true));
  down8 = register_module("down8", Depthwise(32, 64, 2));
  group8 = register_module("group8", Csp(64, 64, 3, true));
  down16 = register_module("down16", Depthwise(64, 128, 2));
  group16 = register_module("group16", Csp(128, 128, 3, true));
  down32 = register_module("down32", Depthwise(128, 256, 2));
  pool_in = register_module("pool_in", ConvSilu(256, 128, 1));
  pool_out = register_module("pool_out", ConvSilu(512, 256, 1));
  group32 = register_module("group32", Csp(256, 256, 1, false));
  lateral16 = register_module("lateral16", ConvSilu(256, 128, 1));
  top16 = register_module("top16", Csp(256, 128, 1, false));
  lateral8 = register_module("lateral8", ConvSilu(128, 64, 1));
  top8 = register_module("top8", Csp(128, 64, 1, false));
  up16 = register_module("up16", Depthwise(64, 64, 2));
  bottom16 = register_module("bottom16", Csp(128, 128, 1, false));
  up32 = register_module("up32", Depthwise(128, 128, 2));
  bottom32 = register_module("bottom32", Csp(256, 256, 1, false));
  for (std::size_t level = 0; level < heads.size(); ++level)
    heads[level] =
        register_module("head" + std::to_string(kStrides[level]), PictureHead(64 << static_cast<int>(level)));
  mask_fine = register_module("mask_fine", ConvSilu(32, 32, 1));
  mask_coarse = register_module("mask_coarse", ConvSilu(64, 32, 1));
  mask_join = register_module("mask_join", ConvSilu(32, 16, 3));
  mask_out = register_module("mask_out", plain_conv(16, 1));
  const torch::NoGradGuard guard;
  mask_out->bias.fill_(-3);
  stem->conv->weight.mul_(1 / kPaddingGrey);  // pictures come as 0 to 255
  for (Tensor& parameter : parameters())
    if (parameter.dim() == 4) parameter.set_data(parameter.contiguous(torch::MemoryFormat::ChannelsLast));
}

CameraOutput CameraNetImpl::forward(const Tensor& picture, bool with_boxes) {
  const Tensor input = network_picture(picture, padded_size(picture.size(0)), padded_size(picture.size(1)));
  const Tensor x4 = group4(down4(stem(focus(input))));
  const Tensor x8 = group8(down8(x4));
  const Tensor x16 = group16(down16(x8));
  const Tensor pooled = pool_in(down32(x16));
  std::vector<Tensor> windows = {pooled};
  for (int k = 0; k < kPoolings; ++k)
    windows.push_back(torch::max_pool2d(windows.back(), kPooledSide, 1, kPooledSide / 2));
  const Tensor x32 = group32(pool_out(torch::cat(windows, 1)));
  const Tensor l16 = lateral16(x32);
  const Tensor l8 = lateral8(top16(torch::cat({twice(l16), x16}, 1)));
  const Tensor p8 = top8(torch::cat({twice(l8), x8}, 1));
  CameraOutput output;
  output.features = p8.to(picture.scalar_type());
  output.mask = mask_out(mask_join(mask_fine(x4) + twice(mask_coarse(p8)))).to(picture.scalar_type());
  if (!with_boxes) return output;
  const Tensor p16 = bottom16(torch::cat({up16(p8), l8}, 1));
  const Tensor p32 = bottom32(torch::cat({up32(p16), l16}, 1));
  std::vector<Tensor> rows;
  const std::array<Tensor, 3> scales = {p8, p16, p32};
  for (std::size_t level = 0; level < scales.size(); ++level)
    rows.push_back(heads[level](scales[level]).flatten(2).squeeze(0).t());
  const Tensor all = torch::cat(rows).to(picture.scalar_type());
  decode_rows(all, picture.size(0), picture.size(1), output);
  return output;
}

void decode_rows(const Tensor& all, std::int64_t height, std::int64_t width, CameraOutput& output) {
  const std::vector<Place> places = places_of(height, width);
  // A copy: the graph keeps it for the backward pass, when `places` is gone.
  const Tensor at =
      torch::from_blob(const_cast<Place*>(places.data()), {static_cast<std::int64_t>(places.size()), 3})
          .to(all.options(), false, true);
  const Tensor stride = at.narrow(1, 2, 1);
  // YOLOX counts from a place's upper left corner and from the picture's edge.
  const Tensor centre = at.narrow(1, 0, 2) + (all.narrow(1, 0, 2) - 0.5) * stride;
  const Tensor half = all.narrow(1, 2, 2).clamp(-8, 8).exp() * (stride / 2);
  output.boxes = torch::cat({centre - half, centre + half}, 1);
  output.logits = logit_of_product(all.select(1, 4), all.select(1, 5));
}

std::vector<Place> places_of(std::int64_t height, std::int64_t width) {
  std::vector<Place> places;
  for (const int stride : kStrides)
    for (std::int64_t row = 0; row < padded_size(height) / stride; ++row)
      for (std::int64_t column = 0; column < padded_size(width) / stride; ++column)
        places.push_back({(static_cast<float>(column) + 0.5f) * static_cast<float>(stride) - 0.5f,
                          (static_cast<float>(row) + 0.5f) * static_cast<float>(stride) - 0.5f,
                          static_cast<float>(stride)});
  return places;
}

Tensor logit_of_product(const Tensor& a, const Tensor& b) {
  return -torch::logsumexp(torch::stack({-a, -b, -a - b}), 0);
}

void read_coco(CameraNetImpl& network, const std::string& file) {
  std::vector<Tensor> theirs;
  try {
    const torch::jit::Module module = torch::jit::load(file, torch::kCPU);
    for (const auto& parameter : module.named_parameters()) theirs.push_back(parameter.value.detach());
  } catch (const std::exception&) {
    throw std::runtime_error("neither a weights file nor a TorchScript network; check --start");
  }
  const torch::NoGradGuard guard;
  std::size_t next = 0;
  for (auto& item : network.named_parameters()) {
    if (item.key().starts_with("mask_")) continue;
    if (next == theirs.size()) throw std::runtime_error("a TorchScript network, but not YOLOX-nano");
    Tensor from = theirs[next++];
    if (from.size(0) == kCocoClasses && item.value().size(0) == 1) from = from.narrow(0, kCocoCar, 1);
    if (from.sizes() != item.value().sizes())
      throw std::runtime_error("a TorchScript network, but not YOLOX-nano: " + item.key() +
                               " has another shape");
    item.value().copy_(from);
  }
  if (next != theirs.size()) throw std::runtime_error("a TorchScript network, but not YOLOX-nano");
}

}  // namespace mirage::fusion
