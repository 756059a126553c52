// The fusion detector's kernels, in double against central differences, and its four scales one by one.
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>
#include <cstdio>
#include <numeric>

#include "base/random.h"
#include "joins.h"
#include "network.h"
#include "sampling.h"
#include "tensor_checks.h"
#include "weights.h"

namespace mirage::fusion {
namespace {

using test::check;
using test::Street;
using test::tensor_of;
using torch::Tensor;

TEST(FusionKernels, VoxelsMoveWithTheirPoints) {
  RandomStream random(1, "voxel test");
  std::vector<double> points;
  for (int i = 0; i < 8; ++i)
    for (double value : {random.uniform(1, 69), random.uniform(-39, 39), random.uniform(-2.5, 0.9), 0.0})
      points.push_back(value);
  // Three returns in one place, some at the edges of the grid, some outside it.
  for (int i = 0; i < 3; ++i) points.insert(points.end(), {20.03, 3.07, -1.01, 0});
  points.insert(points.end(), {0.05, -39.95, -2.55, 0, 69.93, 39.98, 0.97, 0, -3, 0, 0, 0, 30, 0, 7, 0});
  const Tensor x = tensor_of(points, {-1, 4});
  torch::manual_seed(1);
  const Tensor weights = torch::randn({1, kVoxelsZ, kVoxelsX, kVoxelsY}, torch::kDouble);
  check(x, [&](const Tensor& p) { return (soft_voxels(p) * weights).sum(); });
  EXPECT_EQ(soft_voxels(x).sizes(), weights.sizes());
  // A single point in a corner cell keeps only its share inside the grid; a non-finite point adds nothing.
  EXPECT_EQ(soft_voxels(tensor_of({NAN, 1, 1, 0}, {1, 4})).sum().item<double>(), 0);
}

TEST(FusionKernels, VoxelsKnowWhatAFurtherReturnWouldChange) {
  const Tensor points = tensor_of({10.1, 0.2, -1, 0, 10.3, 0.1, -0.9, 0, 30, 5, 0, 0}, {3, 4});
  // Among returns, on its own, beyond the grid, not finite.
  const Tensor further = tensor_of({10.2, 0.2, -1, 0, 40, -7, -0.5, 0, 500, 0, 0, 0, NAN, 1, 1, 0}, {4, 4});
  torch::manual_seed(1);
  const Tensor weights = torch::randn({1, kVoxelsZ, kVoxelsX, kVoxelsY}, torch::kDouble);
  const auto loss = [&](const Tensor& masses) {
    return (soft_voxels(points, further, masses) * weights).sum();
  };
  for (const double mass : {0.0, 0.7}) check(torch::full({4}, mass, torch::kDouble), loss);
  // Points without mass have no effect.
  const Tensor none = torch::zeros({4}, torch::kDouble).requires_grad_(true);
  EXPECT_TRUE(torch::equal(soft_voxels(points, further, none), soft_voxels(points)));
  const Tensor slopes = torch::autograd::grad({loss(none)}, {none})[0];
  EXPECT_NE(slopes[0].item<double>(), 0);
  EXPECT_NE(slopes[1].item<double>(), 0);
  EXPECT_EQ(slopes[2].item<double>(), 0);
  EXPECT_EQ(slopes[3].item<double>(), 0);
  // A point of mass one is an ordinary point.
  const Tensor one = torch::cat({points, further.narrow(0, 0, 1)});
  EXPECT_TRUE(torch::allclose(soft_voxels(points, further.narrow(0, 0, 1), torch::ones({1}, torch::kDouble)),
                              soft_voxels(one)));
}

TEST(FusionKernels, ReadingTheMapMovesWithMapAndPlace) {
  torch::manual_seed(2);
  const Tensor map = torch::randn({1, 5, 4, 6}, torch::kDouble),
               weights = torch::randn({9, 5}, torch::kDouble);
  // Inside, beyond each edge, and in a corner cell.
  const Tensor at =
      tensor_of({1.3, 2.2, 4.7, 0.4, 0.1, 2.9, -2, 1.5, 9, 1.2, 2.6, -3, 2.1, 8, -1, -1, 4.99, 2.99}, {9, 2});
  check(map, [&](const Tensor& m) { return (bilinear(m, at) * weights).sum(); });
  check(at, [&](const Tensor& a) { return (bilinear(map, a) * weights).sum(); });
  const Tensor one = bilinear(map, tensor_of({3, 2, NAN, 1}, {2, 2}));
  EXPECT_TRUE(torch::equal(one[0], map[0].select(1, 2).select(1, 3)));
  EXPECT_TRUE(torch::isfinite(one).all().item<bool>());
}

TEST(FusionKernels, EachCellTakesTheNearestPointThatTheCameraSees) {
  const Street street;
  const auto nearest = nearest_points(street.points, street.input.projection, 80, 48);
  const auto visible = [&](std::int64_t i) {
    const float* p = street.points.data() + 4 * i;
    const double u = 40 - 40 * p[1] / p[0], v = 24 - 40 * p[2] / p[0];
    return p[0] > 0.5 && u >= -0.5 && u < 79.5 && v >= -0.5 && v < 47.5;
  };
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    const Grid& grid = kGrids[level];
    std::vector<std::int64_t> taken(as_size(grid.rows * grid.columns), -1);
    for (std::size_t k = 0; k < nearest[level].cells.size(); ++k)
      taken[as_size(nearest[level].cells[k])] = nearest[level].points[k];
    for (std::int64_t cell = 0; cell < grid.rows * grid.columns; ++cell) {
      const auto distance = [&](std::int64_t i) {
        return std::hypot(street.points[as_size(4 * i)] - cell_x(cell / grid.columns, grid.cell),
                          street.points[as_size(4 * i + 1)] - cell_y(cell % grid.columns, grid.cell));
      };
      double best = 1e9;
      for (std::int64_t i = 0; i < static_cast<std::int64_t>(street.points.size() / 4); ++i)
        if (visible(i)) best = std::min(best, distance(i));
      if (taken[as_size(cell)] < 0) {
        EXPECT_GT(best, grid.reach) << "level " << level << ", cell " << cell;
        continue;
      }
      EXPECT_TRUE(visible(taken[as_size(cell)]));
      EXPECT_LE(best, grid.reach);
      EXPECT_DOUBLE_EQ(distance(taken[as_size(cell)]), best) << "level " << level << ", cell " << cell;
    }
  }
}

TEST(FusionNetwork, AllFourScalesCarryTheGradientOfPixelsAndPoints) {
  const Street street;
  torch::manual_seed(6);
  Network network(Parts{});
  network->to(torch::kDouble);
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    const auto scalar = [&](const Tensor& image, const Tensor& points) {
      SensorTensors input = street.input;
      input.image = image;
      input.points = points;
      const Tensor added = network->fused(input)[level];
      // Weights that differ from cell to cell and channel to channel.
      const Tensor weights = torch::cos(torch::arange(added.numel(), torch::kDouble)).view(added.sizes());
      return (added * weights).sum();
    };
    ASSERT_TRUE(network->fused(street.input)[level].defined()) << level;
    const auto some = [](std::size_t i) { return i % 397 == 0; };
    check(
        street.input.image, [&](const Tensor& image) { return scalar(image, street.input.points); }, 1e-6,
        1e-4, some);
    // The step must not change which point is a cell's nearest: the choice itself has no gradient.
    check(
        street.input.points, [&](const Tensor& points) { return scalar(street.input.image, points); }, 1e-8,
        1e-3, [](std::size_t i) { return i % 13 == 0; });
    const Tensor image = street.input.image.clone().requires_grad_(true);
    const Tensor points = street.input.points.clone().requires_grad_(true);
    const auto gradients = torch::autograd::grad({scalar(image, points)}, {image, points});
    EXPECT_GT(gradients[0].norm().item<double>(), 1e-3) << "scale " << level;
    EXPECT_GT(gradients[1].norm().item<double>(), 1e-3) << "scale " << level;
  }
}

TEST(FusionNetwork, TakesPicturesOfAnySize) {
  Network network(Parts{});
  const torch::NoGradGuard guard;
  for (const auto& [width, height] : {std::pair{1, 1}, {3, 2}, {33, 31}, {320, 95}}) {
    SensorTensors input = Street(width, height).input;
    input.image = input.image.to(torch::kFloat);
    input.points = input.points.to(torch::kFloat);
    const Tensor output = network->forward(input);
    EXPECT_EQ(output.sizes(), (std::vector<std::int64_t>{kOutputs, kCellsX, kCellsY}));
    EXPECT_TRUE(torch::isfinite(output).all().item<bool>()) << width << " × " << height;
  }
}

TEST(FusionNetwork, IsSmallEnoughToShip) {
  const auto count = [](bool with_image) {
    std::int64_t sum = 0;
    for (const Tensor& parameter : Network(Parts{with_image, false, false, with_image})->parameters())
      sum += parameter.numel();
    return sum;
  };
  EXPECT_LT(4 * count(true), 10'000'000) << "bytes";
  EXPECT_LT(count(false), count(true));
}

}  // namespace

// The network's robust layers: non-local means and the depth gate.

namespace {

/// With nonzero weights, so that it has an effect.
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

// The earlier shipped layer added 0.4 % to its features: its row of the paper's table was in effect
// adversarial training again.
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
