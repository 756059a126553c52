// Painting, late fusion, and norms that freeze.
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>

#include "joins.h"
#include "network.h"
#include "tensor_checks.h"

namespace mirage::fusion {
namespace {

using test::check;
using test::Street;
using test::tensor_of;
using torch::Tensor;

Parts named(bool painted, bool late, bool image = false) {
  Parts parts{image};
  parts.painted = painted;
  parts.late = late;
  return parts;
}

/// The camera's output for the street's picture: cars on the left, nothing on the right.
CameraOutput half_and_half(const Street& street) {
  CameraOutput seen;
  const std::int64_t rows = 64 / kMaskStride, columns = 96 / kMaskStride;  // of 48 × 80, padded
  seen.mask = torch::full({1, 1, rows, columns}, -3., torch::kDouble);
  seen.mask.narrow(3, 0, 10).fill_(3);
  seen.features = torch::rand({1, kCameraFeatures, rows / 2, columns / 2}, torch::kDouble);
  const auto places =
      static_cast<std::int64_t>(places_of(street.input.image.size(0), street.input.image.size(1)).size());
  seen.boxes = torch::zeros({places, 4}, torch::kDouble);
  seen.logits = torch::full({places}, -20., torch::kDouble);
  return seen;
}

TEST(Painting, EvidenceGoesToTheColumnsOfItsReturns) {
  Street street;
  street.input.points = tensor_of({20.1, 5.05, -1, 0, 20.1, -5.05, -1, 0, -4, 0, 0, 0, 20, 60, 0, 0}, {4, 4});
  street.input.camera = half_and_half(street);
  const Tensor painted = painted_voxels(street.input)[0];
  // u = 40 − 40 y / x: +5 m lies left of the middle. One return's mass of 1 over its columns.
  const auto around = [&](int channel, double y) {
    const auto row = static_cast<std::int64_t>(20.1 / kVoxel - 0.5);
    const auto column = static_cast<std::int64_t>((y - kYMin) / kVoxel - 0.5);
    return painted[channel].narrow(0, row, 2).narrow(1, column, 2).sum().item<double>();
  };
  EXPECT_GT(around(0, 5.05), 10 * around(1, 5.05));
  EXPECT_GT(around(1, -5.05), 10 * around(0, -5.05));
  EXPECT_LT(painted.sum().item<double>(), 2);  // two returns, each under 1; the others are out of view
  Street blind = street;
  blind.input.camera = {};
  EXPECT_EQ(painted_voxels(blind.input).abs().sum().item<double>(), 0);
}

TEST(Painting, GradientOfMaskAndReturnsMatchesDifferences) {
  Street street;
  street.input.camera = half_and_half(street);
  torch::manual_seed(31);
  const Tensor weights = torch::randn({1, kPaintedChannels, kVoxelsX, kVoxelsY}, torch::kDouble);
  street.input.camera.mask = torch::randn({1, 1, 16, 24}, torch::kDouble);
  check(street.input.camera.mask, [&](const Tensor& mask) {
    SensorTensors input = street.input;
    input.camera.mask = mask;
    return (painted_voxels(input) * weights).sum();
  });
  // The step must not move a return into other columns: the choice of columns has no gradient.
  check(
      street.input.points,
      [&](const Tensor& points) {
        SensorTensors input = street.input;
        input.points = points;
        return (painted_voxels(input) * weights).sum();
      },
      1e-8, 1e-3, [](std::size_t i) { return i % 3 == 0; });
  // Presence gradients of further returns: in view, beside others, out of view.
  street.input.watched = tensor_of({20.3, 2.1, -1, 0, 20.1, 2, -0.8, 0, -5, 0, -1, 0}, {3, 4});
  for (const double mass : {0.0, 0.6})
    check(torch::full({3}, mass, torch::kDouble), [&](const Tensor& masses) {
      SensorTensors input = street.input;
      input.masses = masses;
      return (painted_voxels(input) * weights).sum();
    });
  street.input.watched = Tensor();
  // Three returns at one place.
  street.input.points = tensor_of({20.1, 2, -1, 0, 20.1, 2, -1, 0, 20.1, 2, -1, 0}, {3, 4});
  check(
      street.input.points,
      [&](const Tensor& points) {
        SensorTensors input = street.input;
        input.points = points;
        return (painted_voxels(input) * weights).sum();
      },
      1e-7, 1e-4);
}

/// The backbone's output: one proposal of a car's size 20 m ahead, one to the right of it.
Tensor two_proposals() {
  Tensor output = torch::full({kOutputs, kCellsX, kCellsY}, 0., torch::kDouble);
  output[kLogit].fill_(-8);
  output[kCos2Yaw].fill_(1);
  output[kLogit][40][90] = 0.5;  // 20.25 m ahead, 5.25 m to the left
  output[kLogit][40][70] = 0.7;
  return output;
}

TEST(LateJoin, PairsProposalsWithBoxesThatOverlapThem) {
  Street street;
  street.input.camera = half_and_half(street);
  torch::manual_seed(32);
  LateJoin join;
  join->to(torch::kDouble);
  const Tensor plain = two_proposals();
  const Tensor without = join(plain, street.input);
  // The first car's place in the picture: u = 40 − 40 · 5.25 / 20.25 = 29.6.
  street.input.camera.boxes[3] = tensor_of({25, 22, 34, 27.5}, {4});
  street.input.camera.logits[3] = 4.0;
  const Tensor with = join(plain, street.input);
  EXPECT_NE(with[kLogit][40][90].item<double>(), without[kLogit][40][90].item<double>());
  EXPECT_EQ(with[kLogit][40][70].item<double>(), without[kLogit][40][70].item<double>());
  EXPECT_EQ(with[kLogit][10][10].item<double>(), -8);  // not a proposal
  EXPECT_TRUE(torch::equal(with.narrow(0, kDx, 6), plain.narrow(0, kDx, 6)));
}

TEST(LateJoin, GradientOfBothLogitsMatchesDifferences) {
  Street street;
  street.input.camera = half_and_half(street);
  street.input.camera.boxes[3] = tensor_of({25, 22, 34, 27.5}, {4});
  street.input.camera.boxes[4] = tensor_of({24, 21, 36, 28}, {4});
  street.input.camera.logits[3] = 1.0;
  street.input.camera.logits[4] = -0.5;
  torch::manual_seed(33);
  LateJoin join;
  join->to(torch::kDouble);
  const auto cell = [](std::size_t i) { return i == 40 * kCellsY + 90 || i == 40 * kCellsY + 70 || i == 7; };
  check(
      two_proposals(),
      [&](const Tensor& output) {
        const Tensor joined = join(output, street.input)[kLogit];
        return 2 * joined[40][90] - joined[40][70] + joined[0][7];
      },
      1e-6, 1e-5, cell);
  check(
      street.input.camera.logits,
      [&](const Tensor& logits) {
        SensorTensors input = street.input;
        input.camera.logits = logits;
        return join(two_proposals(), input)[kLogit][40][90];
      },
      1e-6, 1e-5, [](std::size_t i) { return i < 6; });
}

TEST(Joins, EveryDetectorCarriesTheGradientOfPixelsToItsLogits) {
  for (const Parts& parts : {named(true, false), named(false, true), named(false, false, true)}) {
    const Street street;
    torch::manual_seed(34);
    Network network(parts);
    network->to(torch::kDouble);
    {
      const torch::NoGradGuard guard;
      network->head->weight.mul_(30);   // after initialisation the head gives almost 0,
      network->head->bias[kLogit] = 0;  // and late fusion only joins proposals
      if (parts.late)
        for (PictureHead& head : network->camera->heads) head->object_out->bias.fill_(1);
    }
    const auto scalar = [&](const Tensor& image) {
      SensorTensors input = street.input;
      input.image = image;
      const Tensor logits = network->forward(input)[kLogit];
      return (logits * torch::cos(torch::arange(logits.numel(), torch::kDouble)).view(logits.sizes())).sum();
    };
    const Tensor image = street.input.image.clone().requires_grad_(true);
    EXPECT_GT(torch::autograd::grad({scalar(image)}, {image})[0].norm().item<double>(), 1e-6);
    if (parts.late) continue;  // the set of pairs jumps with the boxes
    check(street.input.image, scalar, 1e-6, 2e-4, [](std::size_t i) { return i % 997 == 0; });
  }
}

TEST(Joins, WithoutAPictureTheBackboneSpeaksAlone) {
  for (const Parts& parts : {named(true, false), named(false, true), named(false, false, true)}) {
    torch::manual_seed(35);
    Network network(parts);
    const torch::NoGradGuard guard;
    SensorTensors input = Street().input;
    input.points = input.points.to(torch::kFloat);
    input.image = Tensor();
    EXPECT_TRUE(torch::isfinite(network->forward(input)).all().item<bool>());
  }
}

TEST(ChannelNorm, FrozenItIsTheFoldedConvolutionOfItsRunningMean) {
  torch::manual_seed(36);
  ConvNorm layer(3, 6, 3, 1);
  layer->to(torch::kDouble);
  const Tensor x = torch::randn({1, 3, 9, 11}, torch::kDouble) * 2 + 1;
  const torch::NoGradGuard guard;
  layer->channel_norm->weight.uniform_(0.5, 1.5);
  layer->channel_norm->bias.uniform_(-1, 1);
  Tensor own;
  {
    SampleStatistics statistics;
    own = layer(x);
    ASSERT_EQ(statistics.seen.size(), 1u);
    follow(statistics.seen, 1);  // the first sample is the mean
  }
  EXPECT_LT((layer(x) - own).abs().max().item<double>(), 1e-9);
  const Tensor y = layer->conv(x);
  const Tensor expected = torch::relu(y * layer->channel_norm->gain().view({1, -1, 1, 1}) +
                                      layer->channel_norm->shift().view({1, -1, 1, 1}));
  EXPECT_LT((layer(x) - expected).abs().max().item<double>(), 1e-12);
}

TEST(ChannelNorm, FrozenItIsLocal) {
  // Attacks evaluate this piecewise: a change in one corner does not reach the opposite one.
  torch::manual_seed(37);
  Residual block(8);
  const torch::NoGradGuard guard;
  Tensor x = torch::randn({1, 8, 20, 20});
  const Tensor before = block(x).clone();
  x.narrow(2, 0, 1).narrow(3, 0, 1).add_(5);
  const Tensor moved = (block(x) - before).abs().sum(1)[0];
  EXPECT_GT(moved[0][0].item<float>(), 0);
  EXPECT_EQ(moved.narrow(0, 4, 16).sum().item<float>(), 0);
  EXPECT_EQ(moved.narrow(1, 4, 16).sum().item<float>(), 0);
}

}  // namespace
}  // namespace mirage::fusion
