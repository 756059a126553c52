#include "norm.h"

#include <algorithm>

namespace mirage::fusion {
namespace {

using torch::Tensor;

constexpr double kEpsilon = 1e-3, kMomentum = 0.02;
thread_local SampleStatistics* active_statistics = nullptr;

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

SampleStatistics::SampleStatistics() : before_(active_statistics) {
  active_statistics = this;
}

SampleStatistics::~SampleStatistics() {
  active_statistics = before_;
}

SampleStatistics* SampleStatistics::active() {
  return active_statistics;
}

Tensor normalise(ChannelNormImpl& norm, const Tensor& x, SampleStatistics& statistics) {
  const auto [y, mean, scale] =
      torch::native_batch_norm(x, norm.weight, norm.bias, {}, {}, true, kMomentum, kEpsilon);
  statistics.seen.push_back(
      {&norm, mean.detach().clone(), (scale.detach().square().reciprocal() - kEpsilon).clamp_min(0)});
  return y;
}

void follow(const std::vector<SampleStatistics::Seen>& seen, std::int64_t samples) {
  const torch::NoGradGuard guard;
  const double share = std::max(kMomentum, 1 / static_cast<double>(std::max<std::int64_t>(1, samples)));
  for (const auto& [norm, mean, variance] : seen) {
    norm->mean.lerp_(mean, share);
    norm->variance.lerp_(variance, share);
  }
}

}  // namespace mirage::fusion
