// A stored vehicle reads back as the same vehicle, and errors of a damaged file name the field.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "base/random.h"
#include "support/files.h"
#include "validation/fidelity/summary.h"
#include "validation/fidelity/validate.h"
#include "validation/fidelity/vehicle_result.h"
#include "validation/reference/unbiased_error.h"

namespace mirage {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;

VehicleResult whole_vehicle() {
  VehicleResult vehicle;
  vehicle.host = {"000003", 2};
  vehicle.name = "000003_2";
  vehicle.from_box = true;
  vehicle.visible_share = 0.75, vehicle.adversary_points = 31;
  vehicle.losses = {{"full", "ended unexpectedly", 2}};
  vehicle.shown = {{"host_rect", {1, 2, 3, 4}}};
  SeenResult& seen = vehicle.seen.emplace();
  seen.matched.mask_iou = 0.99, seen.matched.rays = 12;
  seen.samples = 64;
  seen.surround = SurroundResult{{{"CAM_BACK", seen.matched, seen.full}}};
  seen.full.mae = 0.1, seen.full.error.unbiased = -0.25, seen.full.error.interval = {-0.5, -1, 0.5};
  seen.range = 9.5, seen.detected = true, seen.clean = {0.8, 0.9};
  seen.raster = {0.1, 0.2, -1.5, true, false}, seen.cycles = {0.9, 0.8, 1.5, false, true};
  seen.conditions = VerdictResults{{{{ConditionLight::raster, ConditionReturns::ideal}, seen.raster}},
                                   {{{Channel::image, "noise"}, seen.cycles}}};
  seen.pictures = {{"clean", "pictures/000003_2_clean.png"}};
  LadderResult& ladder = seen.ladder.emplace();
  LightRungResult rung;
  rung.effect = "+clear sky", rung.group = "cycles", rung.base = "matched", rung.seconds = 2;
  rung.change.psnr = HUGE_VAL;  // equal pictures
  rung.to_full.relative = 0.3, rung.outcome = seen.raster;
  ladder.light = {rung};
  ladder.lidar = {{"noise", 7, 0.5, -0.25, 0.125, std::nullopt}};
  ladder.reference = {256, 8, 0.02};
  ladder.features = {{"range", 9.5}};
  return vehicle;
}

TEST(VehicleResult, ReadsAsItWasWritten) {
  const VehicleResult vehicle = whole_vehicle();
  const json stored = json::parse(to_json(vehicle).dump());
  const VehicleResult read = read_vehicle("v.json", stored);
  EXPECT_EQ(to_json(read), to_json(vehicle));
  EXPECT_EQ(read.seen->ladder->light.at(0).change.psnr, HUGE_VAL);
  EXPECT_EQ(read.seen->cycles.fooled(), true);
  EXPECT_FALSE(read.seen->ladder->lidar.at(0).outcome);
  VehicleResult unseen;
  unseen.host = {"000004", 0};
  EXPECT_EQ(to_json(read_vehicle("v.json", to_json(unseen))), to_json(unseen));
  EXPECT_FALSE(read_vehicle("v.json", to_json(unseen)).seen);
}

/// Every missing field, or one of another type, is an error; otherwise it would be read as 0.
TEST(VehicleResult, EveryFieldIsMissed) {
  const json whole = to_json(whole_vehicle());
  int fields = 0;
  for (const json& place : whole.flatten()) static_cast<void>(place), ++fields;
  int refused = 0, kept = 0;
  const json flat = whole.flatten();
  for (const auto& [pointer, value] : flat.items()) {
    json damaged = whole;
    damaged[json::json_pointer(pointer)] = json::array({"no"});
    try {
      read_vehicle("v.json", damaged);
      ++kept;
      // Values for the report alone, and roots beside their squares.
      EXPECT_TRUE(pointer.starts_with("/host_rect") || pointer.find("error_") != std::string::npos ||
                  pointer.ends_with("/floor"))
          << pointer;
    } catch (const InputError& error) {
      ++refused;
      EXPECT_THAT(std::string(error.what()), AllOf(HasSubstr("v.json"), HasSubstr("made again"))) << pointer;
    }
  }
  EXPECT_EQ(refused + kept, fields);
  EXPECT_GT(refused, 80);
}

}  // namespace

// The unbiased error against a planted one, under planted noise.

namespace {

constexpr int kWidth = 48, kHeight = 40;
constexpr double kMean = 0.5, kPixels = kWidth * kHeight;

/// A smooth picture, with radiance beyond 1 in some places.
ImageF truth() {
  ImageF image(kWidth, kHeight, 3);
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u)
      for (int c = 0; c < 3; ++c)
        image.at(u, v, c) = 0.4f + 0.9f * static_cast<float>(u) / kWidth + 0.1f * static_cast<float>(c);
  return image;
}

/// `image` with alternating errors of ±`error` everywhere, and its own Gaussian noise.
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

/// Means over many draws: the expectations of the estimates.
struct Expected {
  double plain = 0, floor = 0, drawn = 0, unbiased = 0;
  int inside = 0;  ///< number of intervals that hold the planted error
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
  EXPECT_GT(std::sqrt(found.plain), 2.5 * share);  // the earlier measure
  EXPECT_NEAR(found.drawn, found.unbiased, 1e-9);  // without noise of its own
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
  // The object is the left half, with other pixels drawn beside it: the scale is that of the object.
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

/// A vehicle with one rung and the given squared errors.
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
  // For one frame: its vehicles; for one vehicle: its picture's own interval.
  const std::vector<VehicleResult> frame{vehicle_with("a", 0.01, 0.1), vehicle_with("a", 0.03, 0.1)};
  EXPECT_EQ(summarize_vehicles(frame, {}).ladder.at(0).error.over, IntervalBasis::vehicles);
  const PooledError one = summarize_vehicles({frame[0]}, {}).ladder.at(0).error;
  EXPECT_EQ(one.over, IntervalBasis::pixels);
  EXPECT_NEAR(one.unbiased.low, 0, 1e-9);
}

}  // namespace

// The vehicles that a validation selects.

namespace {

std::vector<std::string> names(const std::vector<HostId>& hosts) {
  std::vector<std::string> result;
  for (const HostId& id : hosts) result.push_back(host_name(id));
  return result;
}

TEST(SelectHosts, TestFramesComeFirstAndWhole) {
  ::mirage::Run run;  // the fixture has a Run of its own
  run.train = {{"000001", 0}, {"000002", 3}};
  run.test = {{"000005", 0}, {"000005", 2}, {"000009", 1}};
  using Names = std::vector<std::string>;
  EXPECT_EQ(select_hosts(run, 0).size(), 5u);  // fewer than a verdict needs
  EXPECT_EQ(names(select_hosts(run, 1)), (Names{"000005_0", "000005_2"}));
  EXPECT_EQ(names(select_hosts(run, 3)), (Names{"000005_0", "000005_2", "000009_1", "000001_0"}));
  EXPECT_EQ(select_hosts(run, 99).size(), 5u);
}

TEST(SelectHosts, AsManyWholeFramesAsAVerdictWants) {
  ::mirage::Run run;
  for (int frame = 0; frame < 60; ++frame)
    for (int label = 0; label < 3; ++label)
      (frame < 20 ? run.test : run.train).push_back({std::to_string(frame), label});
  const std::vector<HostId> hosts = select_hosts(run, 0);
  EXPECT_EQ(hosts.size(), 102u);
  EXPECT_EQ(hosts[59].frame, "19");  // the held-out ones first
  EXPECT_EQ(hosts.back().label, 2);
}

TEST(SelectHosts, WhatIsShownIsAllTestVehiclesAndNoOthers) {
  ::mirage::Run run;
  run.train = {{"000001", 0}, {"000002", 3}};
  run.test = {{"000005", 0}, {"000005", 2}, {"000009", 1}};
  using Names = std::vector<std::string>;
  EXPECT_EQ(names(shown_hosts(run, 0)), (Names{"000005_0", "000005_2", "000009_1"}));
  EXPECT_EQ(names(shown_hosts(run, 1)), (Names{"000005_0", "000005_2"}));
  EXPECT_EQ(shown_hosts(run, 9).size(), 5u);
}

TEST(SelectHosts, TheLadderIsSpreadOverTheFrames) {
  const std::vector<HostId> hosts{{"a", 0}, {"a", 1}, {"a", 4}, {"b", 2}, {"c", 0}, {"c", 1}};
  using Chosen = std::vector<bool>;
  EXPECT_EQ(ladder_hosts(hosts, 0), (Chosen{0, 0, 0, 0, 0, 0}));
  EXPECT_EQ(ladder_hosts(hosts, 2), (Chosen{1, 0, 0, 1, 0, 0}));
  EXPECT_EQ(ladder_hosts(hosts, 4), (Chosen{1, 1, 0, 1, 1, 0}));
  EXPECT_EQ(ladder_hosts(hosts, 99), (Chosen{1, 1, 1, 1, 1, 1}));
  EXPECT_EQ(ladder_hosts(hosts, -1), (Chosen{1, 1, 1, 1, 1, 1}));
}

TEST(SelectHosts, AHostThatTheDataDoesNotHoldIsAnInputError) {
  Frame frame;
  frame.labels.resize(2);
  frame.labels[1].type = "Car";
  EXPECT_NO_THROW(label_of(frame, {"000001", 1}));
  EXPECT_THROW(label_of(frame, {"000001", 2}), InputError);
  frame.labels[1].in_space = false;  // another set of labels than the run's
  EXPECT_THROW(label_of(frame, {"000001", 1}), InputError);
  frame.labels[1] = {};
  frame.labels[1].type = "vehicle.foo";
  EXPECT_THROW(label_of(frame, {"000001", 1}), InputError);
}

}  // namespace
}  // namespace mirage
