#include "network.h"

namespace mirage::guided {
namespace {

namespace nn = torch::nn;
namespace fn = torch::nn::functional;
using torch::Tensor;

constexpr int kHalf = 16, kQuarter = 32, kEighth = 48, kSixteenth = 64;  // channels
constexpr double kFreeLogDepth = 3, kFreeLogSpan = 2;                    // the free guess: 2.7 to 148 m
constexpr double kMostCorrection = 0.25;                                 // |r|

nn::Conv2d conv(int in, int out, int kernel, int stride = 1) {
  nn::Conv2d layer(nn::Conv2dOptions(in, out, kernel).stride(stride).padding((kernel - 1) / 2));
  nn::init::kaiming_normal_(layer->weight, 0, torch::kFanIn, torch::kReLU);
  nn::init::zeros_(layer->bias);
  return layer;
}

Tensor doubled(const Tensor& x) {
  return fn::interpolate(
      x, fn::InterpolateFuncOptions().scale_factor(std::vector<double>{2, 2}).mode(torch::kNearest));
}

/// Σ_k w_k q_k over the candidates that exist.
Tensor mixed_inverse_depth(const Tensor& scores, const Tensor& inverse) {
  const Tensor usable = scores.masked_fill(inverse <= 0, -1e4);
  return (torch::softmax(usable, 0) * inverse).sum(0);
}

}  // namespace

ResidualImpl::ResidualImpl(int channels) {
  first = register_module("first", conv(channels, channels, 3));
  second = register_module("second", conv(channels, channels, 3));
  torch::NoGradGuard guard;
  second->weight.mul_(0.2);  // starts near the identity: nothing normalises what the blocks add up to
}

Tensor ResidualImpl::forward(const Tensor& x) {
  return second(first(x).relu_()).add_(x).relu_();
}

// Strided kernels are even (4 × 4, padding 1): the centre of output i lies at 2 i + 1/2, the middle of the
// two cells it replaces, so that grids of all strides share their edges.
NetworkImpl::NetworkImpl() {
  stem = register_module("stem", conv(kFeatures, kHalf, 4, 2));
  block2 = register_module("block2", Residual(kHalf));
  down4 = register_module("down4", conv(kHalf, kQuarter, 4, 2));
  block4a = register_module("block4a", Residual(kQuarter));
  block4b = register_module("block4b", Residual(kQuarter));
  down8 = register_module("down8", conv(kQuarter, kEighth, 4, 2));
  block8a = register_module("block8a", Residual(kEighth));
  block8b = register_module("block8b", Residual(kEighth));
  down16 = register_module("down16", conv(kEighth, kSixteenth, 4, 2));
  block16a = register_module("block16a", Residual(kSixteenth));
  block16b = register_module("block16b", Residual(kSixteenth));
  lateral16 = register_module("lateral16", conv(kSixteenth, kEighth, 1));
  smooth8 = register_module("smooth8", conv(kEighth, kEighth, 3));
  lateral8 = register_module("lateral8", conv(kEighth, kQuarter, 1));
  smooth4 = register_module("smooth4", conv(kQuarter, kQuarter, 3));
  lateral4 = register_module("lateral4", conv(kQuarter, kHalf, 1));
  smooth2 = register_module("smooth2", conv(kHalf, kHalf, 3));
  head = register_module("head", conv(kHalf, 4 * kOutputs, 3));
  torch::NoGradGuard guard;
  nn::init::normal_(head->weight, 0, 0.01);
  for (int sub = 0; sub < 4; ++sub) {  // pixel_shuffle: channel c of the output comes from 4 c … 4 c + 3
    head->bias[4 * kFreeScore + sub] = -3.0;
    head->bias[4 * kPresence + sub] = 1.0;
  }
  to(torch::kFloat);
  for (Tensor& parameter : parameters())
    if (parameter.dim() == 4) parameter.set_data(parameter.contiguous(at::MemoryFormat::ChannelsLast));
}

Prediction NetworkImpl::forward(const Features& features) {
  const Tensor x2 = block2(stem(features.values).relu_());
  const Tensor x4 = block4b(block4a(down4(x2).relu_()));
  const Tensor x8 = block8b(block8a(down8(x4).relu_()));
  const Tensor x16 = block16b(block16a(down16(x8).relu_()));
  const Tensor y8 = smooth8(doubled(lateral16(x16)).add_(x8)).relu_();
  const Tensor y4 = smooth4(doubled(lateral8(y8)).add_(x4)).relu_();
  const Tensor y2 = smooth2(doubled(lateral4(y4)).add_(x2)).relu_();
  const std::int64_t height = features.candidates.size(1), width = features.candidates.size(2);
  const Tensor out =
      torch::pixel_shuffle(head(y2).contiguous(), 2).squeeze(0).narrow(1, 0, height).narrow(2, 0, width);
  const Tensor free =
      torch::exp(-(kFreeLogDepth + kFreeLogSpan * torch::tanh(out.narrow(0, kFree, 1) / kFreeLogSpan)));
  const Tensor inverse =
      mixed_inverse_depth(out.narrow(0, kScore, kCandidates + 1), torch::cat({features.candidates, free}, 0));
  const Tensor correction = kMostCorrection * torch::tanh(out.select(0, kCorrection));
  return {torch::exp(correction) / inverse, out.select(0, kPresence)};
}

}  // namespace mirage::guided
