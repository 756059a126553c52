// The unbiased error against a planted one, under planted noise.
#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "base/random.h"
#include "validation/fidelity/summary.h"
#include "validation/reference/unbiased_error.h"

namespace mirage {
namespace {

constexpr int kWidth = 48, kHeight = 40;
constexpr double kMean = 0.5, kPixels = kWidth * kHeight;

/// A smooth picture, its radiance beyond 1 in part.
ImageF truth() {
  ImageF image(kWidth, kHeight, 3);
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u)
      for (int c = 0; c < 3; ++c)
        image.at(u, v, c) = 0.4f + 0.9f * static_cast<float>(u) / kWidth + 0.1f * static_cast<float>(c);
  return image;
}

/// `image` off by `error` everywhere, to either side by turns, with Gaussian noise of its own.
ImageF render_of(const ImageF& image, double error, double noise, std::uint64_t seed) {
  RandomStream random(seed, "planted noise");
  ImageF out = image;
  for (std::size_t i = 0; i < out.data.size(); ++i)
    out.data[i] += static_cast<float>((i % 2 ? error : -error) + noise * random.normal());
  return out;
}

ImageF everywhere() {
  return {kWidth, kHeight, 1, 1.0f};
}

/// Means over many draws: what the estimates expect.
struct Expected {
  double plain = 0, floor = 0, drawn = 0, unbiased = 0;
  int inside = 0;  ///< intervals that hold the planted error
};
Expected expected(double error, double own_noise, double noise, int draws) {
  Expected result;
  const ImageF right = truth();
  for (int k = 0; k < draws; ++k) {
    const auto seed = static_cast<std::uint64_t>(4 * k);
    Halves drawn{render_of(right, error, own_noise, seed), {}};
    if (own_noise > 0) drawn.second = render_of(right, error, own_noise, seed + 1);
    const Halves reference{render_of(right, 0, noise, seed + 2), render_of(right, 0, noise, seed + 3)};
    const SquaredError found = squared_error(drawn, reference, everywhere(), kPixels, kMean);
    result.plain += found.plain / draws;
    result.floor += found.floor / draws;
    result.drawn += found.drawn / draws;
    result.unbiased += found.unbiased / draws;
    result.inside += found.interval.low <= error / kMean && error / kMean <= found.interval.high;
  }
  return result;
}

TEST(UnbiasedError, RecoversAPlantedErrorWhereThePlainOneIsBiased) {
  const double error = 0.02, noise = 0.08;
  const Expected found = expected(error, 0, noise, 60);
  const double share = error / kMean, floor = noise / std::sqrt(2.0) / kMean;
  EXPECT_NEAR(std::sqrt(found.unbiased), share, 0.05 * share);
  EXPECT_NEAR(std::sqrt(found.floor), floor, 0.02 * floor);
  EXPECT_NEAR(std::sqrt(found.plain), std::hypot(share, floor), 0.02 * floor);
  EXPECT_GT(std::sqrt(found.plain), 2.5 * share);  // what was reported before
  EXPECT_NEAR(found.drawn, found.unbiased, 1e-9);  // no noise of its own
  EXPECT_GE(found.inside, 50);                     // of 60 at 95 %
}

TEST(UnbiasedError, OwnNoiseIsTakenOutAndStaysInWhatIsDrawn) {
  const double error = 0.02, own = 0.1, noise = 0.06;
  const Expected found = expected(error, own, noise, 60);
  EXPECT_NEAR(std::sqrt(found.unbiased), error / kMean, 0.06 * error / kMean);
  EXPECT_NEAR(std::sqrt(found.drawn), std::hypot(error, own / std::sqrt(2.0)) / kMean, 0.01);
  EXPECT_NEAR(std::sqrt(found.floor), std::hypot(own, noise) / std::sqrt(2.0) / kMean, 0.01);
}

TEST(UnbiasedError, NoErrorIsZeroOnAverageAndMayComeOutNegative) {
  const Expected found = expected(0, 0.05, 0.05, 60);
  EXPECT_NEAR(found.unbiased, 0, 1e-4);
  EXPECT_GT(found.plain, 9e-3);
  EXPECT_GE(found.inside, 50);
  int negative = 0;
  for (std::uint64_t k = 0; k < 40; ++k) {
    const ImageF right = truth();
    const Halves a{render_of(right, 0, 0.05, 9000 + 4 * k), render_of(right, 0, 0.05, 9001 + 4 * k)},
        r{render_of(right, 0, 0.05, 9002 + 4 * k), render_of(right, 0, 0.05, 9003 + 4 * k)};
    const SquaredError found_once = squared_error(a, r, everywhere(), kPixels, kMean);
    negative += found_once.unbiased < 0;
    EXPECT_NEAR(found_once.unbiased, found_once.plain - found_once.floor, 1e-12);
  }
  EXPECT_GT(negative, 5);
  EXPECT_LT(negative, 35);
  EXPECT_EQ(signed_root(-0.04), -0.2);
  EXPECT_EQ(signed_root(0.04), 0.2);
}

TEST(UnbiasedError, EqualsTheProductOfDifferences) {
  const ImageF right = truth();
  const Halves a{render_of(right, 0.1, 0.1, 1), render_of(right, 0.1, 0.1, 2)},
      r{render_of(right, 0, 0.1, 3), render_of(right, 0, 0.1, 4)};
  double product = 0;
  for (std::size_t i = 0; i < right.data.size(); ++i) {
    const double a1 = a.first.data[i], a2 = a.second.data[i], r1 = r.first.data[i], r2 = r.second.data[i];
    product += ((a1 - r1) * (a2 - r2) + (a1 - r2) * (a2 - r1)) / 2;
  }
  product /= static_cast<double>(right.data.size()) * kMean * kMean;
  EXPECT_NEAR(squared_error(a, r, everywhere(), kPixels, kMean).unbiased, product, 1e-9);
}

TEST(UnbiasedError, OverExposedPixelsAndWhatLiesBesideTheObjectCount) {
  const ImageF right = truth();
  ImageF brighter = right;
  int over = 0;
  for (float& value : brighter.data)
    if (value > 1) value += 0.3f, ++over;
  ASSERT_GT(over, 100);
  EXPECT_GT(squared_error({brighter, {}}, {right, right}, everywhere(), kPixels, kMean).unbiased, 0.01);
  // The object is the left half; something is drawn beside it: the scale stays the object's.
  ImageF left(kWidth, kHeight, 1), beside = right, both = everywhere();
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u) {
      left.at(u, v) = u < kWidth / 2 ? 1.0f : 0.0f;
      if (u >= kWidth / 2) beside.at(u, v, 0) += 0.5f;
    }
  EXPECT_EQ(squared_error({beside, {}}, {right, right}, left, kPixels / 2, kMean).unbiased, 0);
  EXPECT_NEAR(squared_error({beside, {}}, {right, right}, both, kPixels / 2, kMean).unbiased,
              0.25 / 3 / (kMean * kMean), 1e-6);
  EXPECT_EQ(squared_error({beside, {}}, {right, right}, both, 0, kMean).plain, 0);
  EXPECT_THROW(squared_error({ImageF(3, 3, 3), {}}, {right, right}, both, 1, 1), Failure);
}

/// A vehicle with one rung whose squared errors are given.
VehicleResult vehicle_with(const std::string& frame, double unbiased, double floor) {
  VehicleResult vehicle;
  vehicle.host.frame = frame;
  LightRungResult rung;
  rung.effect = "soft";
  SquaredError& error = rung.error;
  error.plain = unbiased + floor;
  error.floor = floor;
  error.unbiased = error.drawn = unbiased;
  error.interval = {signed_root(unbiased), signed_root(unbiased) - 0.1, signed_root(unbiased) + 0.1};
  vehicle.seen.emplace().ladder.emplace().light = {rung};
  return vehicle;
}

TEST(UnbiasedError, RowsPoolTheSquaresOfTheVehicles) {
  std::vector<VehicleResult> vehicles;
  for (int i = 0; i < 20; ++i)
    vehicles.push_back(vehicle_with(std::to_string(i), i % 2 ? 0.04 : -0.02, 0.09));
  const ValidationSummary all = summarize_vehicles(vehicles, {});
  const PooledError& pooled = all.ladder.at(0).error;
  EXPECT_NEAR(pooled.unbiased.value, 0.1, 1e-9);  // not the mean of roots
  EXPECT_NEAR(pooled.floor, 0.3, 1e-9);
  EXPECT_NEAR(pooled.plain, std::sqrt(0.1), 1e-9);
  EXPECT_LT(pooled.unbiased.low, 0.08);
  EXPECT_GT(pooled.unbiased.high, 0.12);
  const auto row = to_json(all).at("ladder").at(0);
  EXPECT_EQ(row.at("interval_over"), "clusters");
  EXPECT_EQ(row.at("interval").at("value"), row.at("error_unbiased"));
  EXPECT_EQ(row.at("error_plain"), pooled.plain);
  // One frame alone: its vehicles; one vehicle alone: its picture's own.
  const std::vector<VehicleResult> frame{vehicle_with("a", 0.01, 0.1), vehicle_with("a", 0.03, 0.1)};
  EXPECT_EQ(summarize_vehicles(frame, {}).ladder.at(0).error.over, DrawnOver::vehicles);
  const PooledError one = summarize_vehicles({frame[0]}, {}).ladder.at(0).error;
  EXPECT_EQ(one.over, DrawnOver::pixels);
  EXPECT_NEAR(one.unbiased.low, 0, 1e-9);
}

}  // namespace
}  // namespace mirage
