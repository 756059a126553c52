// The second stage: the content of a region, its gradients, and its training targets.
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <cmath>
#include <numbers>

#include "loss.h"
#include "network.h"
#include "second_stage.h"
#include "tensor_checks.h"

namespace mirage::fusion {
namespace {

using test::check;
using test::Street;
using test::tensor_of;
using torch::Tensor;

constexpr std::int64_t kLeftCar = 40 * kCellsY + 90, kRightCar = 40 * kCellsY + 70;  // 20 m ahead, ±5 m

/// A street whose first stage has two proposals, one of them turned, with random features all over.
struct TwoCars {
  Street street;
  FirstStage first;
  SecondStage stage;
  TwoCars() {
    torch::manual_seed(41);
    stage->to(torch::kDouble);
    {
      const torch::NoGradGuard guard;
      stage->last->weight.normal_(0, 0.3);  // nonzero last layer, as after training
      stage->last->bias.normal_(0, 0.3);
    }
    first.output = torch::zeros({kOutputs, kCellsX, kCellsY}, torch::kDouble);
    first.output[kLogit].fill_(-8);
    first.output[kCos2Yaw].fill_(1);
    first.output[kLogit][40][90] = 0.5;
    first.output[kLogit][40][70] = 0.7;
    // No value on a kink: a raster along grid lines, or two corners on one edge of the rectangle.
    first.output[kDx][40][90] = -0.04;
    first.output[kDy][40][90] = 0.11;
    first.output[kDy][40][70] = 0.07;
    first.output[kSin2Yaw][40][90] = -0.3;
    first.output[kSin2Yaw][40][70] = 0.8;
    first.output[kDx][40][70] = 0.13;
    first.output[kLogLength][40][70] = 0.21;
    const std::int64_t rows = 64 / kFeatureStride, columns = 96 / kFeatureStride;  // of 48 × 80, padded
    first.bev = torch::randn({1, kBevFeatures, kCellsX, kCellsY}, torch::kDouble);
    first.picture = torch::randn({1, kCameraFeatures + 1, rows, columns}, torch::kDouble);
    first.mask = torch::randn({1, 1, 2 * rows, 2 * columns}, torch::kDouble);
    // Three returns on the left car, one on the right one, one far from both, and road beside each car.
    street.input.points = tensor_of({20.1, 5.05, -1, 0, 21.3, 4.8, -0.4, 0, 19.2, 5.6, 0.2,  0,  20.4, -4.7,
                                     -0.9, 0,    40, 0, -1.6, 0,   18.5, 4, -1.7, 0,   18.5, -4, -1.7, 0},
                                    {7, 4});
  }
  /// A weighted sum of outputs for both cars, with weights that do not cancel.
  Tensor word(const FirstStage& from, const SensorTensors& input) {
    const Tensor y = stage(from, input).reshape({kOutputs, -1});
    return y[kLogit][kLeftCar] - 2 * y[kLogit][kRightCar] + y[kDx][kRightCar] + y[kSin2Yaw][kLeftCar];
  }
};

TEST(SecondStage, BeginsAsTheFirst) {
  TwoCars cars;
  SecondStage fresh;
  fresh->to(torch::kDouble);
  const Tensor before = cars.first.output.reshape({kOutputs, -1}),
               after = fresh(cars.first, cars.street.input).reshape({kOutputs, -1});
  for (const std::int64_t cell : {kLeftCar, kRightCar}) {
    for (const int value : {kLogit, kDx, kDy, kLogLength, kLogWidth})
      EXPECT_NEAR(after[value][cell].item<double>(), before[value][cell].item<double>(), 1e-12);
    EXPECT_NEAR(std::atan2(after[kSin2Yaw][cell].item<double>(), after[kCos2Yaw][cell].item<double>()),
                std::atan2(before[kSin2Yaw][cell].item<double>(), before[kCos2Yaw][cell].item<double>()),
                1e-12);
  }
}

TEST(SecondStage, ChangesProposalsAndNothingElse) {
  TwoCars cars;
  const Tensor moved =
      (cars.stage(cars.first, cars.street.input) - cars.first.output).abs().sum(0).view({-1});
  EXPECT_GT(moved[kLeftCar].item<double>(), 1e-3);
  EXPECT_GT(moved[kRightCar].item<double>(), 1e-3);
  EXPECT_NEAR(moved.sum().item<double>(), (moved[kLeftCar] + moved[kRightCar]).item<double>(), 1e-12);
  cars.first.output[kLogit].fill_(-8);
  EXPECT_TRUE(torch::equal(cars.stage(cars.first, cars.street.input), cars.first.output));  // no regions
}

TEST(SecondStage, LooksAtEverySourceOfARegion) {
  TwoCars cars;
  const double before = cars.word(cars.first, cars.street.input).item<double>();
  const auto moves = [&](const auto& change) {
    TwoCars other;
    change(other);
    return std::abs(other.word(other.first, other.street.input).item<double>() - before);
  };
  EXPECT_GT(moves([](TwoCars& c) { c.first.bev.add_(0.5); }), 1e-6);
  EXPECT_GT(moves([](TwoCars& c) { c.first.picture.add_(0.5); }), 1e-6);
  EXPECT_GT(moves([](TwoCars& c) { c.first.mask.add_(2); }), 1e-6);
  EXPECT_GT(moves([](TwoCars& c) { c.street.input.points[1][2] += 0.3; }), 1e-6);
  EXPECT_EQ(moves([](TwoCars& c) { c.street.input.points[4][1] += 0.3; }), 0);  // far from both
  // Pixels have an effect without returns: the right car without its one return.
  EXPECT_GT(moves([](TwoCars& c) { c.street.input.points[3][0] = -5; }), 1e-6);
}

TEST(SecondStage, GradientsMatchDifferences) {
  TwoCars cars;
  const auto every = [](std::size_t n) { return [n](std::size_t i) { return i % n == 0; }; };
  const auto in = [&](Tensor FirstStage::*map) {
    return [&cars, map](const Tensor& x) {
      FirstStage first = cars.first;
      first.*map = x;
      return cars.word(first, cars.street.input);
    };
  };
  check(cars.first.picture, in(&FirstStage::picture), 1e-5, 1e-5, every(29));
  check(cars.first.mask, in(&FirstStage::mask), 1e-5, 1e-5);
  const Tensor reached = [&] {
    const Tensor leaf = cars.first.bev.clone().requires_grad_(true);
    return torch::autograd::grad({in(&FirstStage::bev)(leaf)}, {leaf})[0].abs().reshape({-1}).contiguous();
  }();
  int looked = 0;
  check(cars.first.bev, in(&FirstStage::bev), 1e-5, 1e-5,
        [&](std::size_t i) { return reached.data_ptr<double>()[i] > 0 && ++looked % 97 == 0; });
  EXPECT_GT(looked, 1000);
  // The inputs from the first stage: the logit, and the region's position.
  check(cars.first.output, in(&FirstStage::output), 1e-7, 1e-5, [](std::size_t i) {
    const auto cell = static_cast<std::int64_t>(i) % (kCellsX * kCellsY);
    return cell == kLeftCar || cell == kRightCar || i == 7;
  });
  check(
      cars.street.input.points,
      [&](const Tensor& points) {
        SensorTensors input = cars.street.input;
        input.points = points;
        return cars.word(cars.first, input);
      },
      1e-7, 1e-5, [](std::size_t i) { return i < 20; });  // the last two are the ground
  cars.street.input.watched = tensor_of({20.3, 5, -1, 0, 20.3, -4.9, -0.8, 0, 60, 0, -1, 0}, {3, 4});
  for (const double mass : {0.0, 0.6})
    check(torch::full({3}, mass, torch::kDouble), [&](const Tensor& masses) {
      SensorTensors input = cars.street.input;
      input.masses = masses;
      return cars.word(cars.first, input);
    });
}

TEST(SecondStage, DegenerateRegionsStayFinite) {
  const auto finite = [](TwoCars& cars) {
    FirstStage first = cars.first;
    for (Tensor FirstStage::*map :
         {&FirstStage::output, &FirstStage::bev, &FirstStage::picture, &FirstStage::mask})
      first.*map = (first.*map).detach().requires_grad_(true);
    SensorTensors input = cars.street.input;
    input.points = input.points.detach().requires_grad_(true);
    const Tensor y = cars.stage(first, input);
    EXPECT_TRUE(torch::isfinite(y).all().item<bool>());
    for (const Tensor& gradient :
         torch::autograd::grad({y.sum()}, {first.output, first.bev, first.picture, first.mask, input.points},
                               {}, {}, false, true))
      EXPECT_TRUE(!gradient.defined() || torch::isfinite(gradient).all().item<bool>());
  };
  TwoCars none;
  none.street.input.points = torch::zeros({0, 4}, torch::kDouble);
  finite(none);
  TwoCars wild;  // boxes without direction, of extreme sizes, at the region's edge and at the sensor
  wild.first.output[kSin2Yaw].fill_(0);
  wild.first.output[kCos2Yaw].fill_(0);
  wild.first.output[kLogLength][40][90] = 50;
  wild.first.output[kLogWidth][40][70] = -50;
  for (const auto& [row, column] : {std::pair{0, 0}, {139, 159}, {0, 80}})
    wild.first.output[kLogit][row][column] = 3;
  wild.street.input.points[0] = std::numeric_limits<double>::quiet_NaN();
  wild.street.input.points[1] = 0.1;
  finite(wild);
}

TEST(RegionReturns, AreThoseInAndAroundABox) {
  Street street;
  // On a road at −1.7 m: inside, half a metre beside, further, on the roof, above it, below the road.
  street.input.points = tensor_of(
      {20, 0, -1.7, 0, 20, 1.9, -1, 0, 20, 2, -1, 0, 21, 0, 0.9, 0, 21, 0, 1.2, 0, 19, 0.2, -1.2, 0}, {6, 4});
  const Tensor box = tensor_of({20, 0, 4, 1.6, 0}, {1, 5});
  const RegionReturns found(box, street.input, 80, 48);
  EXPECT_NEAR(found.ground[0], -1.7, 1e-6);
  EXPECT_EQ(found.visible[0], 1);
  const Tensor points = found.points_of(street.input).index_select(0, torch::tensor(found.which));
  EXPECT_TRUE(
      torch::equal(points, street.input.points.narrow(1, 0, 3).index_select(0, torch::tensor({0, 1, 3, 5}))));
  // Turned by 90°, it includes the returns ahead and not those beside.
  const RegionReturns turned(tensor_of({20, 0, 4, 1.6, std::numbers::pi / 2}, {1, 5}), street.input, 80, 48);
  EXPECT_EQ(turned.which.size(), 5u);
  EXPECT_EQ(RegionReturns(tensor_of({-9, 0, 4, 1.6, 0}, {1, 5}), street.input, 80, 48).visible[0], 0);
}

TEST(RegionReturns, OfManyAFewCountAndAllThatAreWatched) {
  Street street;
  std::vector<double> crowd;
  for (int i = 0; i < 1000; ++i) crowd.insert(crowd.end(), {20 + 1e-3 * i, 0.1, -1, 0});
  street.input.points = tensor_of(crowd, {1000, 4});
  street.input.watched = tensor_of({20, 0, -1, 0, 20, 0.2, -1, 0, 50, 0, -1, 0}, {3, 4});
  street.input.masses = torch::zeros({3}, torch::kDouble);
  const RegionReturns found(tensor_of({20, 0, 4, 1.6, 0}, {1, 5}), street.input, 80, 48);
  EXPECT_EQ(found.region.size(), 125u + 2u);  // every eighth
  EXPECT_EQ(found.masses_of(street.input).sum().item<double>(), 125);
  const Tensor evidence = found.evidence_of(street.input, torch::full({1, 1, 16, 24}, 3., torch::kDouble));
  EXPECT_NEAR(evidence.min().item<double>(), 1 / (1 + std::exp(-3.0)), 1e-12);
}

/// One region: its first-stage box, the change to it, and its logit.
Regions region(const std::vector<double>& box, const std::vector<double>& change, double logit) {
  Regions regions;
  regions.cells = {0};
  regions.boxes = tensor_of(box, {1, 5});
  regions.change = tensor_of(change, {1, kBoxParts}).requires_grad_(true);
  regions.logits = tensor_of({logit}, {1}).requires_grad_(true);
  return regions;
}

TEST(RegionLoss, IsLeastWhereTheNewBoxIsTheLabelAndTheScoreSaysHowGoodItIs) {
  const std::vector<MirageBox> car = {{20, 3, 4.2f, 1.7f, 0.3f}};
  const std::vector<double> off = {20.3, 2.8, 3.9, 1.6, 0.2 - std::numbers::pi};  // half a turn
  const double c = std::cos(off[4]), s = std::sin(off[4]), dx = 20 - off[0], dy = 3 - off[1];
  const std::vector<double> right = {(c * dx + s * dy) / kChangeUnits[0], (c * dy - s * dx) / kChangeUnits[1],
                                     std::log(4.2 / 3.9) / kChangeUnits[2],
                                     std::log(1.7 / 1.6) / kChangeUnits[3], 0.1 / kChangeUnits[4]};
  const LossTerms best = region_loss(region(off, right, 6), car, {});
  EXPECT_NEAR(best.box, 0, 1e-4);
  EXPECT_LT(best.score, 0.01);  // an IoU of 1 has the target score 1
  EXPECT_GT(region_loss(region(off, {0, 0, 0, 0, 0}, 6), car, {}).box, 0.1);
  EXPECT_GT(region_loss(region(off, right, -6), car, {}).score, 1);
  // Away from the car there is nothing to find, and the box has no regression target.
  const LossTerms beside = region_loss(region({20, 9, 4, 1.7, 0}, {1, 1, 1, 1, 1}, 2), car, {});
  EXPECT_GT(beside.score, 2);
  EXPECT_EQ(beside.box, 0);
  EXPECT_EQ(region_loss(region({20, 9, 4, 1.7, 0}, {1, 1, 1, 1, 1}, 2), car,
                        std::vector<MirageBox>{{20, 9, 6, 2, 0}})
                .score,
            0);  // ignored
}

TEST(RegionLoss, GradientMatchesDifferences) {
  const std::vector<MirageBox> car = {{20, 3, 4.2f, 1.7f, 0.3f}};
  const auto at = [&](const Tensor& word) {
    Regions regions = region({20.3, 2.8, 3.9, 1.6, 0.2}, {0, 0, 0, 0, 0}, 0);
    regions.logits = word.narrow(0, 0, 1);
    regions.change = word.narrow(0, 1, kBoxParts).view({1, kBoxParts});
    return region_loss(regions, car, {}).total;
  };
  // In float. The target of the score follows the box, but has no gradient.
  const Tensor word = tensor_of({0.4, 0.2, -0.6, 0.3, 0.1, 0.5}, {6}).requires_grad_(true);
  const Tensor gradient = torch::autograd::grad({at(word)}, {word})[0];
  for (std::int64_t i = 0; i < 1; ++i) {
    Tensor up = word.detach().clone(), down = word.detach().clone();
    up[i] += 1e-2;
    down[i] -= 1e-2;
    EXPECT_NEAR(gradient[i].item<double>(), (at(up) - at(down)).item<double>() / 2e-2, 1e-3);
  }
  for (std::int64_t i = 1; i < 6; ++i) EXPECT_NE(gradient[i].item<double>(), 0);
}

}  // namespace
}  // namespace mirage::fusion
