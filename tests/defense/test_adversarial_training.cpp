// Adversarial training with the real network on tiny frames: it resumes, hardens, and reports errors.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attack/adversary.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "defense/adversarial_training.h"
#include "defense/certificate.h"
#include "exchange/gltf.h"
#include "support/each_field.h"
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
                                                   {"seed", 0},
                                                   {"carried", "adversary"},
                                                   {"defense", "none"},
                                                   {"left_out", 0.0},
                                                   {"placement", "roof"},
                                                   {"precision", "float"},
                                                   {"cameras", "first"},
                                                   {"classes", "Car"},
                                                   {"sensors", ""},
                                                   {"rig", ""}}));
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

TEST(Defense, AShareThatRoundsToNoneOrAllOfABatchIsRefused) {
  const auto text = [](double attacked, int batch) {
    DefenseSettings settings;
    settings.attacked = attacked;
    settings.batch = batch;
    return error_text<FieldError>([&] { train_defended(settings); });
  };
  EXPECT_THAT(text(0.2, 2), ::testing::StartsWith("attacked: 0.2: rounds to none of a batch of 2; "));
  EXPECT_THAT(text(0.8, 2), ::testing::StartsWith("attacked: 0.8: rounds to all of a batch of 2; "));
}

TEST(Defense, AMethodSaysWhichSettingsItLeavesUnused) {
  EXPECT_THAT(unused_fields("adversarial"), ::testing::IsEmpty());
  EXPECT_THAT(unused_fields("denoising"), ::testing::IsEmpty());
  for (const char* clean : {"depth-gate", "picture-dropout"})
    EXPECT_THAT(unused_fields(clean),
                ::testing::UnorderedElementsAre("attacked", "adversary_updates", "adversary_batch",
                                                "vertex_rate", "texel_rate"));
  for (const char* random : {"roof-objects", "ceiling"})
    EXPECT_THAT(unused_fields(random), ::testing::UnorderedElementsAre("adversary_updates", "adversary_batch",
                                                                       "vertex_rate", "texel_rate"));
}

#ifdef MIRAGE_HAS_FUSION

TEST(Defense, ADetectorOfPicturesIsRefused) {
  DefenseSettings settings;
  settings.detector.detector = "camera";
  EXPECT_THAT(error_text<FieldError>([&] { train_defended(settings); }),
              ::testing::StartsWith("detector: camera: finds boxes in the picture alone"));
}

TEST(Defense, PartsOfAnImageBranchThatTheDetectorLacksAreOneLine) {
  DefenseSettings settings;
  settings.detector.detector = "lidar";
  settings.detector.parts = {"denoising"};
  EXPECT_THAT(
      error_text<FieldError>([&] { train_defended(settings); }),
      ::testing::StartsWith(
          "method: denoising: needs a detector that sees the picture, and lidar does not; use adversarial"));
}

/// A few steps from fresh weights.
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
  EXPECT_EQ(read_json(folder / "whole/training.json").at("options").at("minutes"), 0);
  settings.learning_rate *= 2;
  EXPECT_THAT(error_text<InputError>([&] { train_defended(settings); }),
              ::testing::HasSubstr("other options"));
}

TEST(Defense, OtherFramesOrAnotherUnitAreAnotherRun) {
  TemporaryFolder folder;
  DefenseSettings settings = tiny(folder, "out");
  settings.steps = 1;
  settings.adversary_updates = 0;
  TrainingOptions training;
  training.data = settings.data;
  training.detector = "lidar";
  training.out = folder / "lidar";
  training.steps = 1;
  training.quiet = true;
  train_defended(settings);
  train_detector(training);
  EXPECT_NO_THROW(train_defended(settings));
  EXPECT_NO_THROW(train_detector(training));
  const auto expect_refused = [&] {
    EXPECT_THAT(error_text<InputError>([&] { train_defended(settings); }),
                ::testing::HasSubstr("other options"));
    EXPECT_THAT(error_text<InputError>([&] { train_detector(training); }),
                ::testing::HasSubstr("other options"));
  };
  const auto sweep = folder / "data/training/velodyne/000001.bin";
  const std::string bytes = read_file(sweep);
  write_file(sweep, bytes.substr(16));  // one return less
  expect_refused();
  write_file(sweep, bytes);
  std::string unit = read_file(shipped_file("scenes/rigs/kitti64.toml"));
  unit.replace(unit.find("height = 1.73"), 13, "height = 1.83");
  write_file(folder / "data/rig.toml", unit);
  expect_refused();
}

TEST(Defense, WithoutAdversaryEverySampleIsClean) {
  TemporaryFolder folder;
  DefenseSettings settings = tiny(folder, "out");
  settings.adversary_updates = 0;
  settings.detector.parts = {"depth-gate"};
  train_defended(settings);
  EXPECT_EQ(read_adversary(folder / "out/adversary.glb").mesh.vertices, initial_adversary({}).mesh.vertices);
}

TEST(Defense, RandomMeshesTeachTheModelAndNothingElseLearns) {
  TemporaryFolder folder;
  DefenseSettings settings = tiny(folder, "random");
  set_method("roof-objects", settings);
  train_defended(settings);
  EXPECT_EQ(read_adversary(folder / "random/adversary.glb").mesh.vertices,
            initial_adversary({}).mesh.vertices);
  DefenseSettings clean = tiny(folder, "clean");
  clean.adversary_updates = 0;
  train_defended(clean);
  // It was trained on more than the plain frames.
  EXPECT_NE(read_file(folder / "random/fusion.weights"), read_file(folder / "clean/fusion.weights"));
}

TEST(Defense, ShareOfPicturesLeftOutChangesWhatIsLearned) {
  TemporaryFolder folder;
  const auto image_weights = [&](const std::string& out, double left_out) {
    DefenseSettings settings = tiny(folder, out);
    settings.adversary_updates = 0;
    settings.left_out = left_out;
    train_defended(settings);
    return read_file(folder / out / "fusion.weights");
  };
  const std::string all = image_weights("all", 0), half = image_weights("half", 0.5),
                    none = image_weights("none", 1);
  EXPECT_NE(all, half);
  EXPECT_NE(half, none);
}

#endif

TEST(Defense, RandomLoadsFillHalfOfTheBoxToAllOfIt) {
  const AdversaryLimits limits;
  Vec3d least = Vec3d::Constant(1e9), most = Vec3d::Zero();
  for (std::uint64_t index = 0; index < 40; ++index) {
    const TexturedMesh mesh = random_load(3, index, limits);
    const Vec3d half = half_lengths(mesh.mesh).cwiseQuotient(limits.half);
    least = least.cwiseMin(half);
    most = most.cwiseMax(half);
    EXPECT_EQ(mesh.mesh.vertices, random_load(3, index, limits).mesh.vertices);
  }
  EXPECT_GE(least.minCoeff(), 0.5);
  EXPECT_LE(most.maxCoeff(), 1.0);
  EXPECT_LT(least.maxCoeff(), 0.65);
  EXPECT_GT(most.minCoeff(), 0.85);
  EXPECT_NE(random_load(3, 0, limits).mesh.vertices, random_load(4, 0, limits).mesh.vertices);
}

TEST(Defense, EveryMethodHasItsSettings) {
  for (const std::string& word : defense_methods()) {
    DefenseSettings settings;
    set_method(word, settings);
    EXPECT_EQ(word.find("denoising") != std::string::npos,
              settings.detector.parts == std::vector<std::string>{"denoising"});
    EXPECT_EQ(word.find("depth-gate") != std::string::npos,
              settings.detector.parts == std::vector<std::string>{"depth-gate"});
    EXPECT_EQ(word == "roof-objects" || word == kCeiling, settings.carried == Carried::random);
    EXPECT_EQ(word == kCeiling, settings.detector.defense == kTrainedCeiling);
    EXPECT_EQ(word == "picture-dropout", settings.left_out > 0);
    EXPECT_EQ(word == "picture-dropout" || word == "depth-gate", settings.adversary_updates == 0);
  }
}

TEST(DefenseSettings, EachFieldChangesTheIdentityOfWhatIsMadeOfIt) {
  const test::TemporaryFolder folder;
  test::expect_identity_follows(DefenseSettings(), folder.path());
  test::expect_identity_follows(CertificateSettings(), folder.path());
}

}  // namespace
}  // namespace mirage
