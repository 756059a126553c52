// Adversarial training with the real network on tiny frames: it resumes, resists, and says what is wrong.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attack/adversary.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/field_json.h"
#include "base/files.h"
#include "defense/adversarial_training.h"
#include "exchange/gltf.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;

TEST(Defense, WhatDecidesARunKeepsItsKeys) {
  const DefenseSettings settings;
  EXPECT_EQ(fields_json(settings), nlohmann::json({{"data", ""},
                                                   {"depth", settings.depth},
                                                   {"rooftop", settings.rooftop},
                                                   {"sun", settings.sun},
                                                   {"detector", "fusion"},
                                                   {"steps", 400},
                                                   {"batch", 2},
                                                   {"learning_rate", 5e-4},
                                                   {"minutes", 0},
                                                   {"attacked", 0.5},
                                                   {"adversary_updates", 5},
                                                   {"adversary_batch", 2},
                                                   {"vertex_rate", 5e-3},
                                                   {"texel_rate", 2e-2},
                                                   {"seed", 0}}));
}

TEST(Defense, SettingsOutOfRangeAreOneLine) {
  DefenseSettings settings;
  settings.attacked = 1.5;
  EXPECT_THAT(error_text<InputError>([&] { train_defended(settings); }),
              ::testing::StartsWith("attacked: 1.5: "));
  settings = {};
  settings.steps = 0;
  EXPECT_THAT(error_text<InputError>([&] { train_defended(settings); }), ::testing::StartsWith("steps: 0: "));
}

#ifdef MIRAGE_HAS_FUSION

TEST(Defense, PartsOfAnImageBranchThatTheDetectorLacksAreOneLine) {
  DefenseSettings settings;
  settings.detector.detector = "lidar";
  settings.detector.parts = {"denoising"};
  EXPECT_THAT(error_text<FieldError>([&] { train_defended(settings); }),
              ::testing::StartsWith(
                  "method: denoising: is of the image branch, and lidar has none; use adversarial"));
}

/// Fresh weights, and a few steps from them.
DefenseSettings tiny(const TemporaryFolder& folder, const std::string& out) {
  if (!std::filesystem::exists(folder / "data")) {
    test::write_tiny_data(folder / "data", 3, true);
    DetectorOptions fresh;
    fresh.fresh = true;
    load_detector(fresh)->save(folder / "start.weights", false);
  }
  DefenseSettings settings;
  settings.data = folder / "data";
  settings.validation = folder / "data";
  settings.out = folder / out;
  settings.detector.weights = folder / "start.weights";
  settings.rooftop = "box";
  settings.steps = 4;
  settings.adversary_updates = 2;
  settings.checkpoint.steps = 1;
  settings.threads = 1;
  settings.quiet = true;
  return settings;
}

TEST(Defense, TrainsModelAndAdversaryFromTheGivenWeights) {
  TemporaryFolder folder;
  const DefenseSettings settings = tiny(folder, "out");
  const DefenseResult result = train_defended(settings);
  EXPECT_EQ(result.steps, 4);
  EXPECT_EQ(result.hosts, 3);
  EXPECT_TRUE(result.validated);
  EXPECT_NE(read_file(result.weights), read_file(settings.detector.weights));
  const TexturedMesh last = read_adversary(folder / "out/adversary.glb"), first = initial_adversary({});
  EXPECT_NE(last.mesh.vertices, first.mesh.vertices);
  EXPECT_TRUE(load_detector({"fusion", result.weights, false, 0, 1}));
}

TEST(Defense, ResumesToTheSameBits) {
  TemporaryFolder folder;
  DefenseSettings settings = tiny(folder, "whole");
  settings.detector.parts = {"denoising", "depth-gate"};
  train_defended(settings);
  settings.out = folder / "parts";
  settings.stop = [steps = 0]() mutable { return ++steps == 2; };
  EXPECT_THROW(train_defended(settings), Interrupted);
  EXPECT_TRUE(std::filesystem::exists(folder / "parts/adversary-2.json"));
  EXPECT_FALSE(std::filesystem::exists(folder / "parts/adversary-1.json"));
  settings.stop = [] { return false; };
  train_defended(settings);
  EXPECT_EQ(read_file(folder / "whole/adversary.glb"), read_file(folder / "parts/adversary.glb"));
  EXPECT_EQ(read_file(folder / "whole/fusion.weights"), read_file(folder / "parts/fusion.weights"));
  // Runs that began before a training could end by time have no such key.
  EXPECT_FALSE(read_json(folder / "whole/training.json").at("options").contains("minutes"));
  settings.learning_rate *= 2;
  EXPECT_THAT(error_text<InputError>([&] { train_defended(settings); }),
              ::testing::HasSubstr("other options"));
}

TEST(Defense, WithoutAdversaryEverySampleIsClean) {
  TemporaryFolder folder;
  DefenseSettings settings = tiny(folder, "out");
  settings.adversary_updates = 0;
  settings.detector.parts = {"depth-gate"};
  train_defended(settings);
  EXPECT_EQ(read_adversary(folder / "out/adversary.glb").mesh.vertices, initial_adversary({}).mesh.vertices);
}

#endif

}  // namespace
}  // namespace mirage
