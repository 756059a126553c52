// Criteria for a hidden vehicle, on outcomes with known shares.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <utility>

#include "attack/evaluate_run.h"
#include "attack/evaluation.h"
#include "base/files.h"
#include "support/files.h"
#include "support/planted.h"

namespace mirage {
namespace {

const BevBox kParked{10, 0, 4, 2, 0};

HostOutcome judged_host(const std::string& frame_name, const std::vector<Detection>& clean,
                        const std::vector<Detection>& attacked) {
  Frame frame;
  Label label;
  label.type = "Car";
  label.box.bev = kParked;
  frame.labels = {label};
  return judge({frame_name, 0}, frame, clean, attacked, EvaluationSettings());
}

TEST(Hiding, ABoxThatOnlyTurnedIsHiddenForTheSeedAndHasNotVanished) {
  const Detection on{kParked, 3};
  // Turned on the spot by 0.4 rad: IoU 0.68, with the same centre.
  const Detection turned{{10, 0, 4, 2, 0.4}, 3};
  const HostOutcome outcome = judged_host("0", {on}, {turned});
  EXPECT_GT(outcome.attacked_iou, 0.5);
  EXPECT_LT(outcome.attacked_iou, 0.7);
  EXPECT_TRUE(outcome.hidden);
  EXPECT_EQ(outcome.attacked_distance, 0);
  const MissRates rates = miss_rates(std::vector{outcome});
  EXPECT_EQ(rates.iou70.share.value, 1);
  EXPECT_EQ(rates.iou50.share.value, 0);
  EXPECT_EQ(rates.vanished.share.value, 0);
  EXPECT_EQ(rates.distance1m->share.value, 0);
}

TEST(Hiding, EachRuleHasItsOwnDenominator) {
  const Detection on{kParked, 3};
  const Detection shifted{{11.5, 0, 4, 2, 0}, 3};  // IoU 5/11, 1.5 m
  const Detection corner{{13.2, 0, 4, 2, 0}, 3};   // IoU 1/9, 3.2 m
  const Detection elsewhere{{40, 5, 4, 2, 0}, 3};  // IoU 0
  const std::vector<HostOutcome> hosts = {
      judged_host("0", {on}, {on}),          // found by every rule
      judged_host("1", {on}, {shifted}),     // hidden at 0.7, 0.5 and 1 m
      judged_host("2", {on}, {corner}),      // … and at 2 m, but a detection overlaps it
      judged_host("3", {on}, {elsewhere}),   // vanished
      judged_host("4", {on}, {}),            // vanished
      judged_host("5", {shifted}, {}),       // detected by the rules 0.1 and 2 m alone: vanished
      judged_host("6", {corner}, {corner}),  // detected by the rule 0.1 alone: still there
      judged_host("7", {elsewhere}, {}),     // detected by no rule
      judged_host("8", {}, {on})};
  const MissRates rates = miss_rates(hosts);
  EXPECT_EQ(rates.iou70.vehicles, 5);
  EXPECT_DOUBLE_EQ(rates.iou70.share.value, 4 / 5.);
  EXPECT_EQ(rates.iou50.vehicles, 5);
  EXPECT_DOUBLE_EQ(rates.iou50.share.value, 4 / 5.);
  EXPECT_EQ(rates.vanished.vehicles, 7);
  EXPECT_DOUBLE_EQ(rates.vanished.share.value, 3 / 7.);
  EXPECT_EQ(rates.distance1m->vehicles, 5);
  EXPECT_DOUBLE_EQ(rates.distance1m->share.value, 4 / 5.);
  EXPECT_EQ(rates.distance2m->vehicles, 6);
  EXPECT_DOUBLE_EQ(rates.distance2m->share.value, 4 / 6.);
  EXPECT_LT(rates.vanished.share.low, 3 / 7.);
  EXPECT_GT(rates.vanished.share.high, 3 / 7.);

  const Evaluation all = summarize(hosts);
  EXPECT_EQ(all.rates.vehicles, 5);
  EXPECT_DOUBLE_EQ(all.rates.fn_asr.value, rates.iou70.share.value);  // FN ASR is the rule IoU 0.7
  const nlohmann::json json = to_json(all);
  EXPECT_EQ(json.at("hidden").at("vanished").at("vehicles"), 7);
  EXPECT_DOUBLE_EQ(json.at("hidden").at("distance2m").at("value"), 4 / 6.);
  EXPECT_TRUE(json.at("asr").is_number());  // the earlier key keeps its meaning
  EXPECT_DOUBLE_EQ(json.at("outcomes").at(1).at("attacked_distance"), 1.5);
  EXPECT_TRUE(json.at("outcomes").at(4).at("attacked_distance").is_null());  // no detection at all
}

TEST(Hiding, NothingFoundCleanTellsNothing) {
  const MissRates rates = miss_rates(std::vector{judged_host("0", {}, {})});
  EXPECT_EQ(rates.vanished.vehicles, 0);
  EXPECT_EQ(rates.vanished.share.low, 0);
  EXPECT_EQ(rates.vanished.share.high, 1);
  EXPECT_EQ(miss_rates({}).iou70.vehicles, 0);
}

TEST(Hiding, InThePictureThereAreNoMetres) {
  Frame frame;
  Label label;
  label.type = "Car";
  label.box.bev = kParked;
  label.left = 100, label.top = 100, label.right = 200, label.bottom = 150;
  frame.labels = {label};
  EvaluationSettings settings;
  settings.matching = kInPicture;
  const Detection on{{}, 3, {100, 100, 200, 150}}, half{{}, 3, {100, 100, 160, 150}};
  const auto outcome = judge({"0", 0}, frame, {on}, {half}, settings);
  EXPECT_TRUE(std::isinf(outcome.clean_distance));
  const Evaluation made = summarize({outcome});
  EXPECT_FALSE(made.hiding.distance1m || made.hiding.distance2m);
  EXPECT_EQ(made.hiding.iou70.share.value, 1);  // IoU 0.6
  EXPECT_EQ(made.hiding.iou50.share.value, 0);
  const auto json = to_json(made);
  EXPECT_TRUE(json.at("hidden").at("distance1m").is_null());
  EXPECT_FALSE(json.at("outcomes").at(0).contains("clean_distance"));
  const auto net = fields_json(gain_over_control(made.hosts, made.hosts));
  EXPECT_TRUE(net.at("distance2m").is_null());
  EXPECT_EQ(net.at("iou70").at("value"), 0);
}

TEST(Hiding, NetIsPairedOverTheSameHosts) {
  // Both meshes succeed in the same half of the frames; the learned one hides one more vehicle in each frame.
  const Detection on{kParked, 3}, ghost{{40, 5, 4, 2, 0}, 3};
  std::vector<HostOutcome> learned, control;
  for (int frame = 0; frame < 40; ++frame)
    for (int host = 0; host < 5; ++host) {
      const bool hard = frame % 2 == 0;
      const auto with = [&](bool hidden) {
        HostOutcome made =
            judged_host(std::to_string(frame), {on}, hidden ? std::vector{ghost} : std::vector{on});
        made.id.label = host;
        return made;
      };
      learned.push_back(with(host < (hard ? 4 : 1)));
      control.push_back(with(host < (hard ? 3 : 0)));
    }
  const GainOverControl net = gain_over_control(learned, control);
  EXPECT_NEAR(net.vanished.value, 0.2, 1e-12);
  // The difference is the same in every frame: pairing leaves only the allowance for one unseen flip …
  EXPECT_NEAR(net.vanished.low, 0.2, 0.015);
  const Interval alone = miss_rates(learned).vanished.share;
  EXPECT_GT(alone.high - alone.low, 0.15);  // … although either share alone is uncertain
  EXPECT_NEAR(net.false_positive.value, 0.2, 1e-12);
  EXPECT_NEAR(net.asr.value, 0.2, 1e-12);
  EXPECT_NEAR(net.distance2m->value, 0.2, 1e-12);
  // The control twice, as two meshes: its share stays the same, and so does the difference.
  std::vector<HostOutcome> twice = control;
  for (HostOutcome host : control) host.mesh = 1, twice.push_back(host);
  EXPECT_NEAR(gain_over_control(learned, twice).vanished.value, 0.2, 1e-12);
  EXPECT_EQ(miss_rates(twice).vanished.vehicles, 200);
}

}  // namespace

// The reliance gate is measured once per data set and detector.

namespace {

using test::Eyes;
using test::Planted;

/// A test with its own cache folder.
class CachedReliance : public testing::Test {
 protected:
  void SetUp() override {
    test::write_planted(data_.path());
    setenv("MIRAGE_CACHE", cache_.path().c_str(), 1);
    for (const Eyes eyes : {Eyes::sees, Eyes::sees}) detectors_.push_back(std::make_unique<Planted>(eyes));
  }
  void TearDown() override { setenv("MIRAGE_CACHE", "off", 1); }
  Reliance ask(const std::string& identity) {
    FrameSource source;
    source.data = data_.path();
    return cached_reliance(detectors_, identity, source);
  }
  /// Number of passes through the detectors since the last call.
  int passes() {
    int sum = 0;
    for (const auto& detector : detectors_) sum += std::exchange(static_cast<Planted&>(*detector).passes, 0);
    return sum;
  }
  test::TemporaryFolder data_, cache_;
  DetectorPool detectors_;
};

TEST_F(CachedReliance, IsMeasuredOnceForADetectorAndItsData) {
  const nlohmann::json first = to_json(ask("planted 1"));
  EXPECT_EQ(passes(), 4 * test::kPlaces);
  EXPECT_NEAR(first.at("drop").get<double>(), 1, 1e-12);
  EXPECT_EQ(to_json(ask("planted 1")), first);
  EXPECT_EQ(passes(), 0);
  ask("planted 2");  // another detector
  EXPECT_GT(passes(), 0);
  ask("");  // a detector without a version: its answers are not stored
  EXPECT_GT(passes(), 0);
  Frame other = test::planted_frame(3);  // another frame
  other.sweep.push_back({20, 3, -1, 0});
  write_frame(data_.path(), other);
  ask("planted 1");
  EXPECT_GT(passes(), 0);
  write_file(data_ / "training/track_2/00000a.txt", "7\n");  // track identities decide on the clusters
  EXPECT_EQ(ask("planted 1").clusters.by, "vehicle");
  EXPECT_GT(passes(), 0);
}

TEST_F(CachedReliance, ADamagedEntryIsMeasuredAgain) {
  const nlohmann::json first = to_json(ask("planted 1"));
  passes();
  for (const auto& entry : std::filesystem::recursive_directory_iterator(cache_.path()))
    if (entry.is_regular_file()) write_file(entry.path(), "no entry");
  EXPECT_EQ(to_json(ask("planted 1")), first);
  EXPECT_GT(passes(), 0);
}

TEST_F(CachedReliance, ADetectorWithoutACameraIsNotRun) {
  detectors_.clear();
  detectors_.push_back(std::make_unique<Planted>(Eyes::ignores, "lidar"));
  EXPECT_FALSE(ask("planted 1").reads_picture);
  EXPECT_EQ(passes(), 0);
}

}  // namespace
}  // namespace mirage
