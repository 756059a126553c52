// The clean detections before an attack, and the messages when there are none.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <numbers>

#include "attack/attack.h"
#include "attack/clean_detections.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "scene/data/read_frames.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

constexpr int kFrames = 3;

std::vector<BevBox> cars_of(int frame) {
  return {{10.0 + 6 * frame, 3, 4, 1.8, 0.2}, {14.0 + 6 * frame, -4, 4.4, 1.7, 1.3 + 0.25 * frame}};
}

/// Frames of two cars each; the picture's brightness says which frame it is.
void write_street(const std::filesystem::path& data) {
  test::write_tiny_data(data, kFrames);
  for (int i = 0; i < kFrames; ++i) {
    Frame frame = read_frame(data, "00000" + std::to_string(i));
    frame.image = ImageF(248, 75, 3, 0.1f + 0.2f * static_cast<float>(i));
    const Label like = frame.labels.at(0);
    frame.labels.clear();
    for (const BevBox& box : cars_of(i)) {
      frame.labels.push_back(like);
      frame.labels.back().box.bev = box;
    }
    write_frame(data, frame);
  }
}

/// Finds every car of write_street; a test may change its boxes.
class Street : public test::StandInDetector {
 public:
  using Change = std::function<Detection(Detection)>;
  explicit Street(Change change = {}, int most = 100) : change_(std::move(change)), most_(most) {}
  std::array<double, 4> region() const override { return {0, 70, -40, 40}; }
  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool) override {
    ++passes;
    const int frame = static_cast<int>(std::lround((input.image->data[0] - 0.1) / 0.2));
    std::vector<Detection> found;
    for (const BevBox& box : cars_of(frame)) {
      Detection proposal{box, 3 - 0.1 * static_cast<double>(found.size())};
      if (change_) proposal = change_(proposal);
      if (proposal.score() > score_threshold && static_cast<int>(found.size()) < most_)
        found.push_back(proposal);
    }
    return found;
  }
  std::uint64_t weights_version() const override { return version; }
  int passes = 0;
  std::uint64_t version = 0;

 private:
  Change change_;
  int most_;
};

class CleanSightsTest : public testing::Test {
 protected:
  CleanSightsTest() { write_street(folder_ / "data"); }
  CleanPerformance look(Street::Change change, int most = 100) {
    DetectorPool pool;
    pool.push_back(std::make_unique<Street>(std::move(change), most));
    FrameStore store(FrameSource{folder_ / "data", "ip-basic", "box"});
    std::vector<Host> hosts;
    for (int i = 0; i < kFrames; ++i)
      for (int label : {0, 1}) hosts.push_back({{"00000" + std::to_string(i), label}, {}});
    CleanDetectionCache sights;
    const CleanPerformance found = measure_clean_performance(pool, store, hosts, {}, sights, true);
    refusal_.clear();
    try {
      require_detections(found, *pool.front());
    } catch (const InputError& error) {
      refusal_ = error.what();
    }
    return found;
  }
  /// The error message for boxes that were changed by `change` and therefore match no vehicle.
  std::string refusal(const std::function<void(BevBox&)>& change) {
    const CleanPerformance found = look([&](Detection proposal) {
      change(proposal.box.bev);
      return proposal;
    });
    EXPECT_EQ(found.found, 0);
    EXPECT_THAT(refusal_, testing::Not(HasSubstr("\n")));
    return refusal_;
  }
  TemporaryFolder folder_;
  std::string refusal_;
};

TEST_F(CleanSightsTest, EveryVehicleFoundIsCounted) {
  const CleanPerformance found = look({});
  EXPECT_EQ(found.found, 6);
  EXPECT_EQ(found.vehicles, 6);
  EXPECT_EQ(found.frames, 3);
  EXPECT_NEAR(found.ap70, 1, 1e-12);
  EXPECT_TRUE(found.hints.empty());
  EXPECT_EQ(refusal_, "");
  EXPECT_EQ(describe(found), "finds 6 of 6 vehicles (AP 0.7 100.0 %)");
  const auto json = to_json(found);
  EXPECT_EQ(json.at("found"), 6);
  EXPECT_EQ(json.at("vehicles"), 6);
  EXPECT_NEAR(json.at("ap50").get<double>(), 1, 1e-12);
}

TEST_F(CleanSightsTest, MistakesInTheBoxesAreNamedWithWhatWouldBeFound) {
  EXPECT_THAT(refusal([](BevBox& box) { box.yaw *= 180 / std::numbers::pi; }),
              AllOf(HasSubstr("finds none of the 6 vehicles"), HasSubstr("6 of 6 headings are beyond ±2π"),
                    HasSubstr("6 of 6 would be found with yaw read as degrees")));
  EXPECT_THAT(refusal([](BevBox& box) { std::swap(box.length, box.width); }),
              HasSubstr("6 of 6 would be found with length and width exchanged"));
  EXPECT_THAT(refusal([](BevBox& box) { box.yaw = -box.yaw - std::numbers::pi / 2; }),
              HasSubstr("6 of 6 would be found with yaw read as KITTI's rotation_y"));
  EXPECT_THAT(refusal([](BevBox& box) {  // x right, y forward
                box = {-box.y, box.x, box.length, box.width, box.yaw + std::numbers::pi / 2};
              }),
              HasSubstr("6 of 6 would be found with the axes read as x = y, y = −x"));
  EXPECT_THAT(refusal([](BevBox& box) {  // the camera's x and z, heading about its axis
                box = {-box.y, box.x, box.length, box.width, -box.yaw - std::numbers::pi / 2};
              }),
              HasSubstr("6 of 6 would be found with the axes read as x = y, y = −x, yaw clockwise"));
  EXPECT_THAT(refusal([](BevBox& box) { box.x += 1.7, box.y -= 1; }),
              HasSubstr("6 of 6 would be found with all boxes moved by x -1.70 m, y +1.00 m"));
  EXPECT_THAT(refusal([](BevBox& box) { box.x += 900; }), HasSubstr("away (median)"));
  EXPECT_THAT(refusal([](BevBox& box) {
                box.length *= 0.75;
                box.width *= 0.85;
              }),
              HasSubstr("6 of 6 would be found at IoU 0.5"));
}

TEST_F(CleanSightsTest, ScoresAndNumbersOfBoxesAreLookedAt) {
  const auto with_logit = [&](double logit) {
    return look([=](Detection proposal) {
      proposal.logit = logit;
      return proposal;
    });
  };
  EXPECT_EQ(with_logit(-2).found, 0);
  EXPECT_THAT(refusal_, AllOf(HasSubstr("6 of 6 would be found at scores over 0.02"), HasSubstr("0.12")));
  with_logit(-9);
  EXPECT_THAT(refusal_, AllOf(HasSubstr("gives no box with a score over 0.02"), HasSubstr("top-k")));
  const CleanPerformance one = look(
      [](Detection proposal) {
        proposal.box.bev = {60, 30, 4, 2, 0};
        return proposal;
      },
      1);
  EXPECT_EQ(one.found, 0);
  EXPECT_THAT(refusal_, HasSubstr("every frame has 1 box: is its top-k too small?"));
}

TEST_F(CleanSightsTest, FewFoundAreToldApartFromNone) {
  CleanPerformance few;
  few.vehicles = 100, few.found = 9;
  const Street detector;
  EXPECT_NO_THROW(require_detections(few, detector));
  few.found = 0;
  EXPECT_THAT(error_text<InputError>([&] { require_detections(few, detector); }),
              HasSubstr("none of the 100"));
}

TEST_F(CleanSightsTest, WhatWasSeenIsForgottenWhenTheWeightsChange) {
  Street detector;
  FrameStore store(FrameSource{folder_ / "data", "ip-basic", "box"});
  const auto prepared = store.get("000000");
  CleanDetectionCache sights;
  EXPECT_EQ(sights.of(*prepared, detector).size(), 2u);
  sights.of(*prepared, detector);
  sights.all_of(*prepared, detector);
  EXPECT_EQ(detector.passes, 1);
  detector.version = 1;  // as after a training step
  sights.of(*prepared, detector);
  sights.of(*prepared, detector);
  EXPECT_EQ(detector.passes, 2);
}

TEST_F(CleanSightsTest, AnAttackOnADetectorThatFindsNothingIsRefused) {
  AttackSettings settings = test::tiny_attack();
  settings.data = folder_ / "data";
  settings.out = folder_ / "run";
  settings.iterations = 1;
  settings.rooftop = "box";
  settings.quiet = true;
  settings.min_view = 0;
  DetectorPool pool;
  pool.push_back(std::make_unique<Street>([](Detection proposal) {
    std::swap(proposal.box.bev.length, proposal.box.bev.width);
    return proposal;
  }));
  EXPECT_THAT(error_text<InputError>([&] { run_attack(settings, pool); }),
              AllOf(HasSubstr("finds none of the"), HasSubstr("length and width exchanged")));
  EXPECT_FALSE(std::filesystem::exists(settings.out / "run.json"));
}

}  // namespace
}  // namespace mirage
