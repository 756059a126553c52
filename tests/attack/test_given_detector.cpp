#include <gmock/gmock.h>

#include <fstream>

#include "attack/attack.h"
#include "attack/run.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "detection/process_detector.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::StandInDetector;
using testing::HasSubstr;
using testing::ThrowsMessage;

class GivenDetectorTest : public testing::Test {
 protected:
  void SetUp() override {
    test::write_tiny_data(folder_ / "data", 4);
    settings_.data = folder_ / "data";
    settings_.out = folder_ / "run";
    settings_.rooftop = "box";
    settings_.iterations = 2;
    settings_.quiet = true;
    settings_.detector.detector = kInProcessDetector;
  }
  InProcessDetector stand_in(const std::string& content) {
    return {[] { return std::make_unique<StandInDetector>(); }, content};
  }

  test::TemporaryFolder folder_;
  AttackSettings settings_ = test::tiny_attack();
};

TEST_F(GivenDetectorTest, IsAttackedAndGoesOnWithTheSameContentOnly) {
  {
    const ScopedDetectors gift({stand_in("one")});
    EXPECT_EQ(run_attack(settings_).iterations, 2);
  }
  settings_.iterations = 3;
  const ScopedDetectors gift({stand_in("another")});
  EXPECT_THROW(run_attack(settings_), InputError);
}

TEST_F(GivenDetectorTest, OutsideOfItsProgramTheRunsCopyIsUsed) {
  {
    const ScopedDetectors gift({stand_in("one")});
    run_attack(settings_);
  }
  EXPECT_THAT([&] { load_detector(settings_.detector); }, ThrowsMessage<InputError>(HasSubstr("Python")));
  const mirage::Run run = read_run(settings_.out);
  DetectorOptions asked;
  asked.detector.clear();
  asked.defense.clear();
  EXPECT_THAT(
      [&] { use_detector_of(run, asked); },
      ThrowsMessage<InputError>(testing::AllOf(HasSubstr("mirage.evaluate"), HasSubstr("--detector"))));
  std::ofstream(settings_.out / kInProcessDetectorCopy) << "a model";
  // The copy is code: it is read only if this user's own program made it, or if the run is trusted.
  EXPECT_THAT(
      [&] { use_detector_of(run, asked); },
      ThrowsMessage<InputError>(testing::AllOf(HasSubstr("--trust-run"), HasSubstr(kInProcessDetectorCopy))));
  use_detector_of(read_run(settings_.out, TrustRun::yes), asked);
  EXPECT_EQ(asked.detector, "torchscript");
  asked = DetectorOptions();
  asked.detector.clear();
  asked.defense.clear();
  const test::TemporaryFolder cache;
  setenv("MIRAGE_CACHE", cache.path().c_str(), 1);
  remember_code_made_here(settings_.out / kInProcessDetectorCopy);
  use_detector_of(run, asked);
  std::ofstream(settings_.out / kInProcessDetectorCopy) << "another model";
  EXPECT_FALSE(is_code_made_here(settings_.out / kInProcessDetectorCopy));
  setenv("MIRAGE_CACHE", "off", 1);
  EXPECT_EQ(asked.detector, "torchscript");
  EXPECT_EQ(asked.weights, settings_.out / kInProcessDetectorCopy);
  DetectorOptions other;
  other.detector = "lidar";
  use_detector_of(run, other);
  EXPECT_EQ(other.detector, "lidar");
}

TEST_F(GivenDetectorTest, OneAtATime) {
  const ScopedDetectors gift({stand_in("one")});
  EXPECT_THROW(ScopedDetectors({stand_in("two")}), Failure);
}

}  // namespace
}  // namespace mirage
