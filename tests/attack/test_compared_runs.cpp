// Comparisons of detectors on the objects of runs: the runs must be against the compared detectors.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attack/comparison.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "detection/process_detector.h"
#include "exchange/gltf.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::Everywhere;
using testing::AllOf;
using testing::HasSubstr;

/// Has a shorter range: of the tiny data's cars, at 11.4 m plus 4 cm per frame, it finds those of two frames.
class NearSighted : public Everywhere {
 public:
  std::array<double, 4> region() const override { return {0, 11.46, -25, 25}; }
};

/// Finds nothing.
class FindsNothing : public Everywhere {
 public:
  std::vector<Detection> forward(const SensorView&, double, bool) override { return {}; }
};

template <class Kind>
InProcessDetector given(const std::string& content) {
  return {[] { return std::make_unique<Kind>(); }, content};
}

class ComparedRuns : public testing::Test {
 protected:
  void SetUp() override {
    test::write_tiny_data(folder_ / "data", 4, true);
    request_.data = folder_ / "data";
    request_.rooftop = "box";
    request_.settings.quiet = true;
    request_.detectors.resize(2);
    request_.detectors[0].detector = kInProcessDetector;
    request_.detectors[1].detector = kSecondInProcessDetector;
  }
  /// A run's folder; its detector is the first one of `detectors`, with that content hash.
  template <class Change>
  std::filesystem::path run(const char* name, const std::string& content, const Change& change) {
    AttackSettings settings = test::tiny_attack();
    settings.data = folder_ / "data";
    settings.rooftop = "box";
    settings.detector.detector = kInProcessDetector;
    settings.weights_hash = content;
    change(settings);
    test::write_run_json(folder_ / name, settings, {{"000000", 0}}, {{"000001", 0}});
    for (const char* mesh : {"adversary.glb", "random.glb"})
      write_adversary(folder_ / name / mesh, initial_adversary());
    return folder_ / name;
  }
  std::filesystem::path run(const char* name, const std::string& content) {
    return run(name, content, [](AttackSettings&) {});
  }
  std::string refusal(const std::vector<std::filesystem::path>& runs, bool adaptive = false) {
    request_.runs = runs;
    request_.adaptive = adaptive;
    return test::error_text<FieldError>([&] { compare(request_); });
  }

  test::TemporaryFolder folder_;
  ComparisonRequest request_;
};

TEST_F(ComparedRuns, AreOfOnePlaceWhichIsTheComparisonsAndOfOneSimulation) {
  const ScopedDetectors gift({given<Everywhere>("one"), given<Everywhere>("two")});
  const auto plain = run("plain", "one");
  const auto lit = run("lit", "two", [](auto& s) { s.simulation.light = LightModel::visible; });
  const auto behind = run("behind", "two", [](auto& s) { set_from_text("rear-rack", s.placement); });
  for (const auto& runs : {std::vector{plain, lit}, std::vector{lit, plain}})
    EXPECT_THAT(refusal(runs), AllOf(HasSubstr("runs: "), HasSubstr("light"), HasSubstr("one simulation")));
  for (const auto& runs : {std::vector{plain, behind}, std::vector{behind, plain}, std::vector{behind}})
    EXPECT_THAT(refusal(runs), AllOf(HasSubstr("placement: roof"), HasSubstr("--place rear-rack")));
  set_from_text("rear-rack", request_.placement);
  EXPECT_THAT(refusal({plain}), AllOf(HasSubstr("placement: rear-rack"), HasSubstr("--place roof")));
}

TEST_F(ComparedRuns, AreNamedOnceAndAttackedTheDetectorWhoseTheyAre) {
  const ScopedDetectors gift({given<Everywhere>("one"), given<Everywhere>("two")});
  const auto one = run("one", "one"), two = run("two", "two");
  EXPECT_THAT(refusal({one, folder_ / "data" / ".." / "one"}), HasSubstr("named twice"));
  EXPECT_THAT(refusal({two, one}, true), AllOf(HasSubstr("runs: "), HasSubstr("other weights")));
  const auto other = run("other", "", [](auto& s) { s.detector.detector = "lidar"; });
  EXPECT_THAT(refusal({one, other}, true), AllOf(HasSubstr("other"), HasSubstr("attacked lidar")));
  const auto defended = run("defended", "two", [](auto& s) { s.detector.defense = "jpeg:50"; });
  EXPECT_THAT(refusal({one, defended}, true), HasSubstr("defence jpeg:50"));
  request_.runs = {one, two};
  request_.adaptive = true;
  const Comparison result = compare(request_);
  EXPECT_EQ(result.hosts, 3);  // of four, one of which the run was trained on
  ASSERT_TRUE(result.own);
}

TEST_F(ComparedRuns, ADetectorIsNotComparedWithItself) {
  const ScopedDetectors gift({given<Everywhere>("one")});
  request_.detectors[1] = request_.detectors[0];
  EXPECT_THAT(refusal({run("one", "one")}), HasSubstr("is compared with itself"));
}

TEST_F(ComparedRuns, TheVehiclesAreThoseInTheRegionsOfBoth) {
  request_.meshes = {MIRAGE_SOURCE "/scenes/objects/ellipsoid.glb"};
  for (const bool near_first : {true, false}) {
    const InProcessDetector near = given<NearSighted>("near"), far = given<Everywhere>("far");
    const ScopedDetectors gift(near_first ? std::vector{near, far} : std::vector{far, near});
    EXPECT_EQ(compare(request_).hosts, 2);
  }
}

TEST_F(ComparedRuns, ADetectorThatFindsNothingLeavesNothingToCompare) {
  request_.meshes = {MIRAGE_SOURCE "/scenes/objects/ellipsoid.glb"};
  const ScopedDetectors gift({given<Everywhere>("one"), given<FindsNothing>("two")});
  const Comparison result = compare(request_);
  EXPECT_EQ(result.found, (std::array<int, 2>{4, 0}));
  EXPECT_TRUE(result.few());
  EXPECT_EQ(to_json(result).at("found"), nlohmann::json({4, 0}));
}

}  // namespace
}  // namespace mirage
