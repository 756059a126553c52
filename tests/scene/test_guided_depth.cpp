// The shipped guided network and its training.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/json_fields.h"
#include "base/random.h"
#include "base/schedule.h"
#include "generator/generator.h"
#include "scene/data/kitti.h"
#include "scene/depth/learned_depth.h"
#include "scene/depth_completion.h"
#include "support/files.h"

#ifdef MIRAGE_HAS_GUIDED
namespace mirage {
namespace {

using test::error_text;
using testing::HasSubstr;

/// Ground plane and a box in a small camera; returns on every fourth row.
DepthSample small_frame(std::uint64_t seed) {
  DepthSample frame{ImageF(112, 64, 3), ImageF(112, 64, 1), ImageF(112, 64, 1)};
  RandomStream random(seed, "small depth frame");
  const int left = 20 + random.below(50);
  for (int v = 0; v < 64; ++v)
    for (int u = 0; u < 112; ++u) {
      const bool box = u >= left && u < left + 25 && v >= 22 && v < 45;
      const float ground = v > 30 ? 60.f / static_cast<float>(v - 29) : 0;
      frame.truth.at(u, v) = box ? 9.f : ground;
      if (v % 4 == 0 && v >= 16 && u % 2 == 0) frame.sparse.at(u, v) = frame.truth.at(u, v);
      for (int c = 0; c < 3; ++c)
        frame.image.at(u, v, c) = static_cast<float>((box          ? 0.7
                                                      : ground > 0 ? 0.3
                                                                   : 0.9) +
                                                     random.uniform(-0.05, 0.05));
    }
  return frame;
}

std::unique_ptr<LearnedDepth> fresh(std::uint64_t seed = 1, int threads = 1) {
  return load_learned_depth({"guided", {}, true, seed, threads});
}

DepthSample sample_of(const DepthSample& frame) {
  return {frame.image, frame.sparse, frame.truth};
}

bool finite(const ImageF& image) {
  return std::all_of(image.data.begin(), image.data.end(), [](float x) { return std::isfinite(x) && x > 0; });
}

TEST(GuidedDepth, ShippedWeightsBeatIpBasicOnAFreshFrame) {
  const Rig rig = read_rig(std::filesystem::path(MIRAGE_SOURCE) / "scenes/rigs/kitti64.toml");
  FrameTruth made;
  const Frame frame = generate_frame(rig, 987, 5, &made);
  const ImageF& truth = made.depth;
  const ImageF sparse = sparse_depth(frame.sweep, frame.calibration);
  const auto guided = load_depth_completion({"guided"});
  const ImageF learned = guided->complete(frame.image, sparse), classical = complete_depth(sparse);
  Image<std::uint8_t> both(truth.width, truth.height, 1);
  std::size_t sky = 0, learned_sky = 0;
  for (std::size_t i = 0; i < truth.data.size(); ++i) {
    both.data[i] = learned.data[i] < kFarDepth && classical.data[i] < kFarDepth;
    sky += !(truth.data[i] > 0);
    learned_sky += !(truth.data[i] > 0) && learned.data[i] < kFarDepth;
  }
  EXPECT_LT(depth_errors(truth, learned, 80, both).rmse, depth_errors(truth, classical, 80, both).rmse);
  EXPECT_LT(depth_errors(truth, fill_as_benchmark(learned), 80).rmse,
            depth_errors(truth, fill_as_benchmark(classical), 80).rmse);
  EXPECT_LT(static_cast<double>(learned_sky), 0.3 * static_cast<double>(sky));
  EXPECT_EQ(learned.data, guided->complete(frame.image, sparse).data);
}

TEST(GuidedDepth, OddInputs) {
  const auto guided = load_depth_completion({"guided"});
  const DepthSample frame = small_frame(1);
  const ImageF none(112, 64, 1);
  EXPECT_TRUE(finite(guided->complete(frame.image, none)));
  ImageF one = none;
  one.at(50, 40) = 7;
  EXPECT_TRUE(finite(guided->complete(frame.image, one)));
  ImageF dirty = frame.sparse;
  dirty.at(11, 17) = std::nanf("");
  dirty.at(31, 33) = HUGE_VALF;
  dirty.at(51, 35) = -5;
  EXPECT_EQ(guided->complete(frame.image, dirty).data, guided->complete(frame.image, frame.sparse).data);
  ImageF extreme = frame.sparse;
  extreme.at(20, 20) = 1e-20f;
  extreme.at(22, 20) = 1e30f;
  EXPECT_TRUE(finite(guided->complete(frame.image, extreme)));
  ImageF bright = frame.image;
  for (std::size_t i = 0; i < bright.data.size(); i += 7) bright.data[i] = i % 2 ? 1e30f : -1e30f;
  EXPECT_TRUE(finite(guided->complete(bright, frame.sparse)));
  for (const auto& [w, h] : {std::pair(1, 1), std::pair(17, 3), std::pair(5, 40)})
    EXPECT_TRUE(finite(guided->complete(ImageF(w, h, 3, 0.5f), ImageF(w, h, 1, 4)))) << w << 'x' << h;
  ImageF broken = frame.image;
  broken.at(3, 4, 0) = std::nanf("");
  EXPECT_THROW(guided->complete(broken, frame.sparse), InputError);
}

TEST(GuidedDepth, NoPictureTalksItOutOfWhatWasMeasured) {
  // A wall at 20 m with returns on every fifth row, with a picture of bright sky.
  ImageF sparse(112, 64, 1);
  for (int v = 7; v < 64; v += 5)
    for (int u = 0; u < 112; u += 2) sparse.at(u, v) = 20;
  for (const float brightness : {0.f, 1.f}) {
    const ImageF dense = load_depth_completion({"guided"})->complete(ImageF(112, 64, 3, brightness), sparse);
    for (int v = 7; v <= 62; ++v)
      for (int u = 0; u < 112; ++u) ASSERT_NEAR(dense.at(u, v), 20, 0.6) << u << ' ' << v;
  }
}

TEST(GuidedDepth, LearnsOneFrameByHeart) {
  const auto model = fresh();
  const std::vector<DepthSample> samples = {sample_of(small_frame(1))};
  double first = 0, last = 0;
  for (int i = 0; i < 60; ++i) {
    const double loss = model->train_step(samples, 2e-3)[0];
    if (i == 0) first = loss;
    last = loss;
  }
  EXPECT_LT(last, first / 3);
}

TEST(GuidedDepth, SamplesWithNothingToLearnFromGiveNoNan) {
  const auto model = fresh();
  DepthSample sky = sample_of(small_frame(1)), unknown = sky, empty = sky;
  std::fill(sky.truth.data.begin(), sky.truth.data.end(), 0.f);
  std::fill(unknown.truth.data.begin(), unknown.truth.data.end(), -1.f);
  std::fill(empty.sparse.data.begin(), empty.sparse.data.end(), 0.f);
  const std::vector<DepthSample> samples = {sky, unknown, empty};
  for (int i = 0; i < 3; ++i)
    for (float loss : model->train_step(samples, 1e-3)) EXPECT_TRUE(std::isfinite(loss));
  EXPECT_TRUE(finite(model->complete(empty.image, empty.sparse)));
}

TEST(GuidedDepth, SeedAndDataDecideNotThreads) {
  const std::vector<DepthSample> samples = {sample_of(small_frame(1)), sample_of(small_frame(2)),
                                            sample_of(small_frame(3))};
  const auto one = fresh(4, 1), three = fresh(4, 3), other = fresh(5, 1);
  for (int i = 0; i < 3; ++i) {
    const auto loss = one->train_step(samples, 1e-3);
    EXPECT_EQ(loss, three->train_step(samples, 1e-3)) << i;
    EXPECT_NE(loss, other->train_step(samples, 1e-3)) << i;
  }
}

TEST(GuidedDepth, DamagedWeightsAreRefused) {
  test::TemporaryFolder folder;
  const auto model = fresh();
  model->save(folder / "a.weights", false);
  EXPECT_LT(std::filesystem::file_size(folder / "a.weights"), 1u << 20);
  const std::string bytes = read_file(folder / "a.weights");
  for (const std::string& damaged : {bytes.substr(0, bytes.size() / 2), std::string("not weights at all")}) {
    write_file(folder / "a.weights", damaged);
    const std::string text = error_text<InputError>([&] {
      load_learned_depth({"guided", folder / "a.weights", false, 0, 1});
    });
    EXPECT_THAT(text, HasSubstr("not a readable weights file"));
    EXPECT_THAT(text, HasSubstr((folder / "a.weights").string()));
  }
}

TEST(GuidedDepth, WeightsThatDeclareMoreThanTheyHoldAreRefusedUnread) {
  test::TemporaryFolder folder;
  fresh()->save(folder / "a.weights", false);
  std::string bytes = read_file(folder / "a.weights");
  bytes.replace(0, 4, "\xf0\xff\xff\xff");  // of the header's length
  write_file(folder / "a.weights", bytes);
  rusage before{}, after{};
  getrusage(RUSAGE_SELF, &before);
  const std::string text = error_text<InputError>([&] {
    load_learned_depth({"guided", folder / "a.weights", false, 0, 1});
  });
  getrusage(RUSAGE_SELF, &after);
  EXPECT_THAT(text, HasSubstr((folder / "a.weights").string()));
  EXPECT_THAT(text, HasSubstr("does not begin with a header's length"));
  EXPECT_LT(after.ru_maxrss - before.ru_maxrss, 16 * 1024);  // KB
}

/// Two frames as mirage generate --depth writes them.
void write_set(const std::filesystem::path& folder) {
  for (int i = 0; i < 2; ++i) {
    const DepthSample made = small_frame(static_cast<std::uint64_t>(10 + i));
    Frame frame;
    frame.id = "00000" + std::to_string(i);
    frame.calibration.camera = {80, 80, 55.5, 30, 112, 64};
    frame.calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
    frame.image = made.image;
    for (int v = 0; v < 64; ++v)
      for (int u = 0; u < 112; ++u)
        if (const float z = made.sparse.at(u, v); z > 0)
          frame.sweep.push_back(
              {z, z * (55.5f - static_cast<float>(u)) / 80, z * (30 - static_cast<float>(v)) / 80, 0.2f});
    write_depth_png(true_depth_file(folder, frame.id), made.truth);
    write_frame(folder, frame);
  }
}

TEST(DepthTraining, WhatDecidesARunKeepsItsKeys) {
  const nlohmann::json keys = {{"backend", "guided"}, {"data", ""},  {"steps", 4000},
                               {"batch", 2},          {"crop", 320}, {"learning_rate", 2e-3},
                               {"minutes", 0},        {"seed", 0},   {"without_picture", 0},
                               {"shift", 1},          {"scatter", 0}};
  EXPECT_EQ(fields_json(DepthTrainingOptions()), keys);
}

TEST(DepthTraining, AStoppedRunGoesOnToTheSameWeights) {
  test::TemporaryFolder folder;
  write_set(folder / "data");
  DepthTrainingOptions options;
  options.data = folder / "data";
  options.steps = 4;
  options.batch = 2;
  options.crop = 80;
  options.quiet = true;
  options.threads = 2;
  options.checkpoint.steps = 2;
  options.out = folder / "whole";
  const DepthTrainingResult whole = train_depth(options);
  EXPECT_EQ(whole.steps, 4);

  // The run after two steps.
  options.out = folder / "parts";
  make_output_folder(options.out);
  {
    // Step s takes samples 2 s and 2 s + 1; an epoch is one step, so both frames come, in the epoch's order.
    const auto model = fresh(options.seed);
    std::vector<DepthSample> frames = {read_depth_frame(options.data, "000000"),
                                       read_depth_frame(options.data, "000001")};
    for (std::uint64_t step = 0; step < 2; ++step) {
      RandomStream random(options.seed, "depth training order", step);
      const bool swapped = random.below(2) == 0;
      const std::vector<DepthSample> samples = {
          augmented_crop(frames[swapped ? 1 : 0], options.crop, options.seed, 2 * step),
          augmented_crop(frames[swapped ? 0 : 1], options.crop, options.seed, 2 * step + 1)};
      model->train_step(samples, one_cycle_rate(options.learning_rate, static_cast<double>(step) / 4));
    }
    model->save(options.out / "checkpoint-2.weights", true);
    auto state = read_json(folder / "whole/training.json");
    state["step"] = 2;
    state["weights"] = "checkpoint-2.weights";
    write_json(options.out / "training.json", state);
  }
  options.threads = 1;
  const DepthTrainingResult parts = train_depth(options);
  EXPECT_EQ(read_file(whole.weights), read_file(parts.weights));
  EXPECT_FALSE(std::filesystem::exists(options.out / "checkpoint-2.weights"));

  options.learning_rate = 1e-4;
  EXPECT_THAT(error_text<InputError>([&] { train_depth(options); }), HasSubstr("other options"));
}

TEST(DepthTraining, AFrameWithoutTrueDepthIsNamed) {
  test::TemporaryFolder folder;
  write_set(folder / "data");
  std::filesystem::remove(true_depth_file(folder / "data", "000001"));
  DepthTrainingOptions options;
  options.data = folder / "data";
  options.out = folder / "out";
  options.quiet = true;
  options.crop = 80;
  EXPECT_THAT(error_text<InputError>([&] { train_depth(options); }), HasSubstr("mirage generate --depth"));
}

TEST(DepthTraining, SamplesDependOnSeedAndIndexAlone) {
  const DepthSample frame = small_frame(3);
  const DepthSample a = augmented_crop(frame, 80, 1, 7), b = augmented_crop(frame, 80, 1, 7),
                    c = augmented_crop(frame, 80, 1, 8);
  EXPECT_EQ(a.image.data, b.image.data);
  EXPECT_EQ(a.sparse.data, b.sparse.data);
  EXPECT_EQ(a.truth.data, b.truth.data);
  EXPECT_NE(a.image.data, c.image.data);
  EXPECT_EQ(a.image.width, 80);
  EXPECT_EQ(augmented_crop(frame, 5000, 1, 7).image.width, frame.image.width);
  for (std::uint64_t i = 0; i < 20; ++i) {
    const DepthSample sample = augmented_crop(frame, 80, 2, i);
    for (float x : sample.image.data) ASSERT_TRUE(x >= 0 && x <= 1);
    for (float z : sample.sparse.data) ASSERT_TRUE(std::isfinite(z) && z >= 0);
  }
}

}  // namespace
}  // namespace mirage
#endif
