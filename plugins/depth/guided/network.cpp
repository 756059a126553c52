#include "network.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/sizes.h"
#include "scene/depth_completion.h"

namespace mirage::guided {
namespace {

namespace fn = torch::nn::functional;

constexpr int kReach = 2;              // columns that a return fills to its sides
constexpr float kMinDistance = 0.5f;   // m; bounds the inverse depth
constexpr float kHalfDistance = 8;     // pixels at which a distance reads 1/2; beams lie about 5 apart
constexpr float kEnclosed = 12;        // pixels
constexpr float kMeanLogDepth = 2.8f;  // about 16 m
constexpr float kToneMean = 0.45f, kToneSpread = 0.28f;

/// Inverse depth of the returns, each widened over gaps at its sides: the nearest column wins, then the
/// nearest depth.
std::vector<float> widened(const MirageDepthInput& input) {
  const int w = input.width, h = input.height;
  std::vector<float> wide(as_size(w) * as_size(h));
  for (int v = 0; v < h; ++v) {
    const float* row = input.sparse + as_size(v) * as_size(w);
    for (int u = 0; u < w; ++u)
      for (int reach = 0; reach <= kReach; ++reach) {
        const float left = u >= reach ? row[u - reach] : 0, right = u + reach < w ? row[u + reach] : 0;
        const float depth = left > 0 && right > 0 ? std::min(left, right) : std::max(left, right);
        if (!(depth > 0)) continue;
        wide[as_size(v) * as_size(w) + as_size(u)] = 1 / std::max(depth, kMinDistance);
        break;
      }
  }
  return wide;
}

/// Carries each return along the columns, downwards (first row to last) or upwards.
void carry(const std::vector<float>& wide, int width, int height, bool downwards, float* inverse,
           float* distance) {
  std::vector<float> value(as_size(width)), away(as_size(width), 1e9f);
  for (int i = 0; i < height; ++i) {
    const std::size_t row = as_size(downwards ? i : height - 1 - i) * as_size(width);
    for (int u = 0; u < width; ++u) {
      const float here = wide[row + as_size(u)];
      value[as_size(u)] = here > 0 ? here : value[as_size(u)];
      away[as_size(u)] = here > 0 ? 0 : away[as_size(u)] + 1;
      inverse[row + as_size(u)] = value[as_size(u)];
      distance[row + as_size(u)] = away[as_size(u)] / (away[as_size(u)] + kHalfDistance);
    }
  }
}

namespace nn = torch::nn;
using torch::Tensor;

constexpr int kHalf = 16, kQuarter = 32, kEighth = 48, kSixteenth = 64;  // channels
constexpr double kFreeLogDepth = 3, kFreeLogSpan = 2;                    // the free guess: 2.7 to 148 m
constexpr double kMaxCorrection = 0.25;                                  // |r|

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

constexpr double kHuber = 20, kSquare = 16;       // m, m: squares count e² / kSquare
constexpr double kScored = 85, kFarWeight = 0.2;  // m; farther pixels count little
constexpr double kGuessWeight = 0.25;             // where IP-Basic has no value
constexpr double kMaxTruthDistance = 140;         // m; the network's range
constexpr double kAbsolute = 0.3, kRelative = 1, kPresenceWeight = 1;

}  // namespace

Features make_features(const MirageDepthInput& input) {
  const int w = input.width, h = input.height;
  const auto area = as_size(w) * as_size(h);
  Features features;
  features.candidates = torch::zeros({kCandidates, h, w});
  torch::Tensor values = torch::empty({kFeatures, h, w});
  float* out = values.data_ptr<float>();
  for (std::size_t i = 0; i < area; ++i)
    for (std::size_t c = 0; c < 3; ++c)  // a square root spreads the shadows much as sRGB does
      out[c * area + i] = (std::sqrt(std::clamp(input.image[3 * i + c], 0.f, 4.f)) - kToneMean) / kToneSpread;

  float* inverse = features.candidates.data_ptr<float>();
  float* distance = out + (3 + kCandidates) * area;
  const std::vector<float> wide = widened(input);
  carry(wide, w, h, true, inverse + kAbove * area, distance + kAbove * area);
  carry(wide, w, h, false, inverse + kBelow * area, distance + kBelow * area);
  const torch::Tensor far = values.narrow(0, 3 + kCandidates, 2).amax(0);
  features.enclosed = far <= kEnclosed / (kEnclosed + kHalfDistance);
  ImageF sparse(w, h, 1);
  std::copy_n(input.sparse, area, sparse.data.begin());
  const ImageF prior = complete_depth(sparse);
  for (std::size_t i = 0; i < area; ++i) {
    const bool has_depth = prior.data[i] < kFarDepth;
    inverse[kPrior * area + i] = has_depth ? 1 / std::max(prior.data[i], kMinDistance) : 0;
    distance[kPrior * area + i] = has_depth ? 0.f : 1.f;
  }
  const torch::Tensor q = features.candidates;
  values.narrow(0, 3, kCandidates)
      .copy_(torch::where(q > 0, -torch::log(q.clamp_min(1e-6)) - kMeanLogDepth, 0.0));
  const auto padding = [](int side) { return (kStride - side % kStride) % kStride; };
  features.values =
      fn::pad(values.unsqueeze(0), fn::PadFuncOptions({0, padding(w), 0, padding(h)}).mode(torch::kReplicate))
          .contiguous(at::MemoryFormat::ChannelsLast);
  return features;
}

ResidualImpl::ResidualImpl(int channels) {
  first = register_module("first", conv(channels, channels, 3));
  second = register_module("second", conv(channels, channels, 3));
  torch::NoGradGuard guard;
  second->weight.mul_(0.2);  // starts near the identity: nothing normalises the blocks' sum
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
  const Tensor correction = kMaxCorrection * torch::tanh(out.select(0, kCorrection));
  return {torch::exp(correction) / inverse, out.select(0, kPresence)};
}

LossTerms completion_loss(const Prediction& prediction, const Features& features, const Tensor& truth) {
  const Tensor present = truth > 0;
  const Tensor target = torch::where(present, truth, 1.0).clamp_max(kMaxTruthDistance);
  const Tensor weight = present.to(torch::kFloat) * torch::where(target <= kScored, 1.0, kFarWeight) *
                        torch::where(features.candidates[kPrior] > 0, 1.0, kGuessWeight);
  const Tensor depth = torch::where(present, prediction.depth, 1.0);
  const Tensor huber =
      fn::huber_loss(depth, target, fn::HuberLossFuncOptions().reduction(torch::kNone).delta(kHuber)) *
      (2 / kSquare);
  const Tensor absolute = torch::abs(depth - target);
  const Tensor relative = torch::abs(torch::log(depth) - torch::log(target));
  const Tensor depth_loss =
      ((huber + kAbsolute * absolute + kRelative * relative) * weight).sum() / weight.sum().clamp_min(1);
  const Tensor has_depth = (truth >= 0).to(torch::kFloat);
  const Tensor presence_loss =
      fn::binary_cross_entropy_with_logits(
          prediction.presence, present.to(torch::kFloat),
          fn::BinaryCrossEntropyWithLogitsFuncOptions().weight(has_depth).reduction(torch::kSum)) /
      has_depth.sum().clamp_min(1);
  return {depth_loss + kPresenceWeight * presence_loss, depth_loss.item<double>(),
          presence_loss.item<double>()};
}

}  // namespace mirage::guided
