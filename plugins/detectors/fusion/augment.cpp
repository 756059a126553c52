#include "augment.h"

#include <cmath>

#include "base/random.h"

namespace mirage::fusion {
namespace {

constexpr double kMostThinning = 0.4, kMostShaking = 0.02;

torch::Tensor thin_and_shake(const torch::Tensor& points, RandomStream& random) {
  const double dropped = random.uniform(0, kMostThinning), shaking = random.uniform(0, kMostShaking);
  const bool thin = random.uniform() < 0.7;
  const std::int64_t count = points.size(0);
  torch::Tensor kept = torch::empty_like(points);
  const float* from = points.data_ptr<float>();
  float* to = kept.data_ptr<float>();
  std::int64_t n = 0;
  for (std::int64_t i = 0; i < count; ++i) {
    if (thin && random.uniform() < dropped) continue;
    for (int a = 0; a < 3; ++a)
      to[4 * n + a] = from[4 * i + a] + static_cast<float>(shaking * random.uniform(-1.7, 1.7));
    to[4 * n + 3] = from[4 * i + 3];
    ++n;
  }
  return kept.narrow(0, 0, n);
}

torch::Tensor change_picture(const torch::Tensor& picture, RandomStream& random) {
  const double exposure = std::exp(random.uniform(-0.5, 0.5));
  const double gamma = std::exp(random.uniform(-0.15, 0.15)), grey = random.uniform(0, 0.35);
  const double noise = random.uniform(0, 0.02);
  torch::Tensor gain = torch::empty({3});
  for (int c = 0; c < 3; ++c) gain[c] = exposure * std::exp(random.uniform(-0.15, 0.15));
  const auto noise_seed = (static_cast<std::uint64_t>(random.next_u32()) << 32) | random.next_u32();

  torch::Tensor x = picture * gain;
  x = x + grey * (x.mean(2, true) - x);
  x = x.clamp(0, 1).pow(gamma);
  auto generator = at::make_generator<at::CPUGeneratorImpl>(noise_seed);
  x = x + noise * torch::sqrt(x + 1e-3) * torch::randn(x.sizes(), generator);
  return x.clamp(0, 1);
}

}  // namespace

SensorTensors augment(const SensorTensors& input, std::uint64_t seed, std::uint64_t index, bool picture) {
  RandomStream random(seed, "detector augmentation", index);
  SensorTensors changed = input;
  changed.points = thin_and_shake(input.points, random);
  if (picture && input.image.defined()) changed.image = change_picture(input.image, random);
  return changed;
}

}  // namespace mirage::fusion
