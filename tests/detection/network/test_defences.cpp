// The parts of the network that resist: non-local means and the depth gate.
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cstdio>

#include "depth_gate.h"
#include "network.h"
#include "tensor_checks.h"
#include "weights.h"

namespace mirage::fusion {
namespace {

using test::check;
using test::Street;
using test::tensor_of;
using torch::Tensor;

/// With a gain and a step, so that it does something.
NonLocalMean awake(int channels) {
  torch::manual_seed(11);
  NonLocalMean mean(channels);
  mean->to(torch::kDouble);
  const torch::NoGradGuard guard;
  mean->norm->weight.uniform_(0.5, 1.5);
  mean->norm->bias.uniform_(-0.5, 0.5);
  return mean;
}

TEST(NonLocalMean, IsHeardFromTheStartAndCanLearn) {
  torch::manual_seed(10);
  NonLocalMean mean(16);
  const Tensor x = torch::rand({1, 16, 5, 7});
  const Tensor y = mean(x);
  EXPECT_NEAR((y - x).square().mean().sqrt().item<double>(), 0.3, 0.02);
  const auto gradient = torch::autograd::grad({(y * torch::rand_like(y)).sum()}, {mean->norm->weight})[0];
  EXPECT_GT(gradient.norm().item<float>(), 1e-4);
}

TEST(NonLocalMean, IsTheMeanOverAllPlacesWeighedByInnerProducts) {
  NonLocalMean mean = awake(8);
  const torch::NoGradGuard guard;
  const Tensor x = torch::randn({1, 8, 3, 4}, torch::kDouble), places = x.flatten(2)[0];  // 8 × 12
  Tensor expected = torch::zeros_like(places);
  for (int i = 0; i < 12; ++i)
    for (int j = 0; j < 12; ++j) {
      const Tensor a = places.select(1, i), b = places.select(1, j);
      expected.select(1, i) += a.dot(b) * b / 12;
    }
  const Tensor projected = mean->norm(mean->project(expected.view({1, 8, 3, 4})));
  EXPECT_LT((mean(x) - x - projected).abs().max().item<double>(), 1e-12);
}

TEST(NonLocalMean, GradientMatchesDifferencesAlsoWhereItIsDegenerate) {
  NonLocalMean mean = awake(8);
  torch::manual_seed(12);
  const Tensor weights = torch::randn({1, 8, 3, 4}, torch::kDouble);
  const auto scalar = [&](const Tensor& x) { return (mean(x) * weights).sum(); };
  check(torch::randn({1, 8, 3, 4}, torch::kDouble), scalar, 1e-6, 1e-5);
  check(torch::full({1, 8, 3, 4}, 0.3, torch::kDouble), scalar, 1e-6, 1e-4);  // all places alike
  // Dark: nothing to average, and the norm divides by its ε alone.
  const Tensor dark = mean(torch::zeros({1, 8, 3, 4}, torch::kDouble));
  EXPECT_TRUE(torch::isfinite(dark).all().item<bool>());
  EXPECT_TRUE(torch::isfinite(mean(torch::rand({1, 8, 1, 1}, torch::kDouble))).all().item<bool>());
}

// What was shipped before added 0.4 % to its features: its row of the paper's table was adversarial training
// once more.
TEST(NonLocalMean, OfTheShippedDefenceIsHeard) {
  const std::string file =
      std::string(MIRAGE_SOURCE) + "/plugins/detectors/fusion/weights/fusion-kitti64-denoising.weights";
  auto archive = open_weights(file);
  Network network(parts_of(archive));
  ASSERT_FALSE(network->denoise.is_empty());
  copy_network(file, *network);
  const torch::NoGradGuard guard;
  SensorTensors input = Street(640, 192).input;
  input.image = input.image.to(torch::kFloat);
  const Tensor features = network->see(input).features;
  const double share =
      (network->denoise(features) - features).norm().item<double>() / features.norm().item<double>();
  std::printf("the non-local mean adds %.2f of the features\n", share);
  EXPECT_GT(share, 0.05);
}

TEST(DepthGate, IsOpenAtOneDepthAndShutBehindSomethingNearer) {
  const Tensor z = tensor_of({20, 20, 20, 40, 40}, {5}),
               front = tensor_of({20, 17, 14.2857142857, 20, 10}, {5});
  const Tensor gate = depth_gate(z, front);
  EXPECT_GT(gate[0].item<double>(), 0.99);
  EXPECT_GT(gate[1].item<double>(), 0.95);
  EXPECT_NEAR(gate[2].item<double>(), 0.5, 1e-6);
  EXPECT_LT(gate[3].item<double>(), 1e-3);
  EXPECT_LT(gate[4].item<double>(), 1e-6);
}

TEST(DepthGate, GradientMatchesDifferences) {
  const Tensor z = tensor_of({20, 24, 27.9, 28.1, 33, 6}, {6}),
               front = tensor_of({20, 20, 20, 20, 20, 4.2}, {6});
  const Tensor weights = tensor_of({1, -2, 3, 0.5, 1, 2}, {6});
  check(z, [&](const Tensor& depth) { return (depth_gate(depth, front) * weights).sum(); });
  check(front, [&](const Tensor& near) { return (depth_gate(z, near) * weights).sum(); });
}

TEST(DepthGate, FindsWhatStandsBeforeAPoint) {
  // A camera that looks along x: u = 40 − 40 y / x, v = 24 − 40 z / x.
  const Projection projection = Street().input.projection;
  const std::vector<float> points = {
      30, 0,    0,   0,  // 0: far, in the middle
      10, 0.5,  0.5, 0,  // 1: near, two pixels beside it
      10, 8,    0,   0,  // 2: near, 32 pixels beside it
      30, 24,   0,   0,  // 3: far, behind 2
      10, 8.1f, 0,   0,  // 4: as deep as 2: the first one counts
      -5, 0,    0,   0,  // 5: behind the camera
      12, -60,  0,   0,  // 6: outside the picture
  };
  const std::vector<std::int64_t> chosen = {0, 1, 2, 3, 4};
  const auto before = nearest_before(points, projection, 80, 48, chosen);
  EXPECT_EQ(before, (std::vector<std::int64_t>{1, 1, 2, 2, 4}));
}

TEST(DepthGate, TheGatedFusionCarriesTheGradientOfPixelsAndPoints) {
  const Street street;
  torch::manual_seed(6);
  Network network(Parts{true, true, true});
  network->to(torch::kDouble);
  const auto scalar = [&](const Tensor& image, const Tensor& points) {
    SensorTensors input = street.input;
    input.image = image;
    input.points = points;
    const Tensor added = network->fused(input)[1];
    return (added * torch::cos(torch::arange(added.numel(), torch::kDouble)).view(added.sizes())).sum();
  };
  check(
      street.input.image, [&](const Tensor& image) { return scalar(image, street.input.points); }, 1e-6, 1e-4,
      [](std::size_t i) { return i % 397 == 0; });
  // The step must not change which point is nearest: that choice has no gradient.
  check(
      street.input.points, [&](const Tensor& points) { return scalar(street.input.image, points); }, 1e-8,
      1e-3, [](std::size_t i) { return i % 7 == 0; });
}

}  // namespace
}  // namespace mirage::fusion
