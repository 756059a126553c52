// Evaluation of outcomes with known shares.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "attack/evaluation.h"
#include "attack/host_outcome.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "base/sizes.h"
#include "support/files.h"
#include "support/insertion_world.h"

namespace mirage {
namespace {

using test::TemporaryFolder;

HostOutcome outcome(const std::string& frame, bool hidden, bool false_positive, double range = 10) {
  HostOutcome host;
  host.id = {frame, 0};
  host.range = range;
  host.kind = "Car";
  host.detected = true;
  host.hidden = hidden;
  host.false_positive = false_positive;
  host.clean_iou = 0.8, host.attacked_iou = hidden ? 0.0 : 0.8;
  return host;
}

const StratumSuccess& part(const Evaluation& evaluation, const std::string& name) {
  for (const StratumSuccess& p : evaluation.strata)
    if (p.name == name) return p;
  throw std::runtime_error("no part " + name);
}

TEST(EvaluationStrata, CountByRangeOcclusionTruncationAndKind) {
  std::vector<HostOutcome> hosts = {outcome("0", true, false, 14.9), outcome("0", false, true, 15),
                                    outcome("1", false, false, 29), outcome("2", true, true, 50),
                                    outcome("3", true, false, 60)};
  hosts[1].occluded = 2;
  hosts[1].truncated = 0.15;
  hosts[2].truncated = 0.2;
  hosts[2].kind = "estate";
  hosts[4].detected = hosts[4].hidden = false;
  const Evaluation all = summarize(hosts);
  EXPECT_EQ(all.rates.vehicles, 4);
  EXPECT_DOUBLE_EQ(all.rates.fn_asr.value, 0.5);
  EXPECT_DOUBLE_EQ(all.rates.asr.value, 0.75);
  EXPECT_EQ(part(all, "0-15 m").rates.vehicles, 1);
  EXPECT_EQ(part(all, "0-15 m").rates.fn_asr.value, 1);
  EXPECT_EQ(part(all, "0-15 m").rates.fp_asr.value, 0);
  EXPECT_EQ(part(all, "15-30 m").rates.vehicles, 2);
  EXPECT_EQ(part(all, "15-30 m").rates.asr.value, 0.5);
  EXPECT_EQ(part(all, "30-50 m").hosts, 0);
  EXPECT_EQ(part(all, "30-50 m").rates.asr.high, 1);  // no information: the interval is [0, 1]
  EXPECT_EQ(part(all, "50+ m").hosts, 2);
  EXPECT_EQ(part(all, "50+ m").rates.vehicles, 1);
  EXPECT_EQ(part(all, "largely occluded").rates.fp_asr.value, 1);
  EXPECT_EQ(part(all, "fully visible").rates.vehicles, 3);
  EXPECT_EQ(part(all, "cut off (> 0.15)").rates.vehicles, 1);
  EXPECT_EQ(part(all, "whole (≤ 0.15)").rates.vehicles, 3);
  EXPECT_EQ(part(all, "Car").rates.vehicles, 3);
  EXPECT_EQ(part(all, "estate").rates.asr.value, 0);
  EXPECT_EQ(part(all, "15-30 m").seen.attacked.value, 1);
  EXPECT_EQ(part(all, "50+ m").seen.attacked.value, 0);
  EXPECT_EQ(part(all, "50+ m").seen.clean.value, 1);  // over all hosts, whatever their IoU
  // Two frames leave a wide interval, one frame the whole of it.
  EXPECT_LT(part(all, "15-30 m").rates.asr.low, 0.01);
  EXPECT_GT(part(all, "15-30 m").rates.asr.high, 0.99);
  EXPECT_EQ(part(all, "0-15 m").rates.fn_asr.low, 0);
  EXPECT_EQ(part(all, "0-15 m").rates.fn_asr.high, 1);
  const auto json = to_json(all).at("strata");
  ASSERT_EQ(json.size(), all.strata.size());
  EXPECT_EQ(json.at(0).at("by"), "range");
  EXPECT_EQ(json.at(0).at("fn_asr").at("value"), 1);
}

TEST(EvaluationStrata, PartsAddUpToTheWhole) {
  std::vector<HostOutcome> hosts;
  for (int i = 0; i < 60; ++i) {
    hosts.push_back(outcome(std::to_string(i / 3), i % 3 == 0, i % 5 == 0, 1.3 * i));
    hosts.back().occluded = i % 4;
    hosts.back().truncated = 0.01 * i;
    hosts.back().detected = i % 7 != 0;
  }
  const Evaluation all = summarize(hosts);
  std::map<std::string, std::pair<int, double>> by;
  for (const StratumSuccess& p : all.strata) {
    by[p.by].first += p.rates.vehicles;
    by[p.by].second += p.rates.vehicles * p.rates.asr.value;
  }
  EXPECT_EQ(by.size(), 4u);
  for (const auto& [name, sum] : by) {
    EXPECT_EQ(sum.first, all.rates.vehicles) << name;
    EXPECT_NEAR(sum.second, all.rates.vehicles * all.rates.asr.value, 1e-9) << name;
  }
}

TEST(Evaluation, SeveralMeshesArePooledAndTheirClustersAreFrames) {
  // Mesh 0 hides 2 of 4 vehicles, mesh 1 one of them, mesh 2 none: 3 of 12.
  std::vector<HostOutcome> hosts, first;
  for (int mesh = 0; mesh < 3; ++mesh)
    for (int i = 0; i < 4; ++i) {
      hosts.push_back(outcome(std::to_string(i), i + mesh < 2, false));
      hosts.back().mesh = mesh;
      hosts.back().from_box = i == 0;
      if (mesh == 0) first.push_back(hosts.back());
    }
  const Evaluation pooled = summarize(hosts, 3);
  EXPECT_EQ(pooled.rates.vehicles, 4);
  EXPECT_DOUBLE_EQ(pooled.rates.fn_asr.value, 0.25);
  EXPECT_EQ(pooled.rooftops.from_box, 1);
  EXPECT_EQ(pooled.rooftops.fitted, 3);
  EXPECT_EQ(part(pooled, "0-15 m").hosts, 4);
  const auto json = to_json(pooled);
  EXPECT_EQ(json.at("hosts"), 4);
  EXPECT_EQ(json.at("outcomes").size(), 12u);
  EXPECT_EQ(json.at("outcomes").at(11).at("mesh"), 2);
  EXPECT_FALSE(to_json(summarize(first)).at("outcomes").at(0).contains("mesh"));
  // Three copies of a mesh carry as much information as one.
  std::vector<HostOutcome> repeated;
  for (int mesh = 0; mesh < 3; ++mesh)
    for (HostOutcome host : first) {
      host.mesh = mesh;
      repeated.push_back(host);
    }
  const Evaluation once = summarize(first), thrice = summarize(repeated, 3);
  EXPECT_DOUBLE_EQ(once.rates.asr.low, thrice.rates.asr.low);
  EXPECT_DOUBLE_EQ(once.rates.asr.high, thrice.rates.asr.high);
  EXPECT_DOUBLE_EQ(once.recall_attacked[10].low, thrice.recall_attacked[10].low);
}

TEST(Evaluation, OneVehicleInManyFramesIsOneCluster) {
  // Forty frames: four vehicles, ten frames each, one of them always hidden.
  std::vector<HostOutcome> hosts;
  for (int i = 0; i < 40; ++i) hosts.push_back(outcome(std::to_string(i), i < 10, false));
  const Evaluation by_frame = summarize(hosts);
  EXPECT_EQ(by_frame.clusters.by, "frame");
  EXPECT_EQ(by_frame.clusters.count, 40);
  for (int i = 0; i < 40; ++i) hosts[as_size(i)].track = i / 10;
  const Evaluation by_vehicle = summarize(hosts);
  EXPECT_EQ(by_vehicle.clusters.by, "vehicle");
  EXPECT_EQ(by_vehicle.clusters.count, 4);
  EXPECT_DOUBLE_EQ(by_vehicle.rates.asr.value, by_frame.rates.asr.value);
  EXPECT_LT(by_vehicle.rates.asr.low, 0.05);
  EXPECT_GT(by_frame.rates.asr.low, 0.1);
  EXPECT_GT(by_vehicle.rates.asr.high, by_frame.rates.asr.high);
  const auto json = to_json(by_vehicle);
  EXPECT_EQ(json.at("clusters").at("count"), 4);
  EXPECT_EQ(json.at("outcomes").at(39).at("track"), 3);
  EXPECT_FALSE(to_json(by_frame).at("outcomes").at(0).contains("track"));
}

TEST(Evaluation, RecallHasIntervals) {
  std::vector<HostOutcome> hosts;
  for (int i = 0; i < 40; ++i) hosts.push_back(outcome(std::to_string(i), i < 10, false));
  const Evaluation all = summarize(hosts);
  ASSERT_EQ(all.recall_attacked.size(), 21u);
  EXPECT_EQ(all.recall_clean[14].value, 1);  // IoU 0.7 ≤ 0.8
  EXPECT_EQ(all.recall_clean[14].high, 1);
  EXPECT_GT(all.recall_clean[14].low, 0.85);
  EXPECT_EQ(all.recall_attacked[14].value, 0.75);
  ClusteredShare found;
  for (int i = 0; i < 40; ++i) found.add(std::to_string(i), i >= 10);
  EXPECT_DOUBLE_EQ(all.recall_attacked[14].low, found.interval().low);
  EXPECT_EQ(all.recall_attacked[17].value, 0);  // IoU 0.85
  const auto json = to_json(all).at("recall_iou");
  for (const char* key :
       {"iou", "clean", "attacked", "clean_low", "clean_high", "attacked_low", "attacked_high"})
    EXPECT_EQ(json.at(key).size(), 21u) << key;
  EXPECT_EQ(json.at("attacked").at(14), 0.75);
}

TEST(FalsePositives, DistributionsHaveKnownBinsAndQuantiles) {
  const Distribution d = distribution({0, 4.9, 5, 12, 1000}, {0, 5, 10, 15});
  EXPECT_THAT(d.counts, testing::ElementsAre(2, 1, 2));
  EXPECT_EQ(d.median, 5);
  EXPECT_EQ(d.p90, 1000);
  const Distribution none = distribution({}, {0, 1});
  EXPECT_THAT(none.counts, testing::ElementsAre(0));
  EXPECT_EQ(none.median, std::nullopt);
}

Frame frame_with_host() {
  Frame frame;
  frame.id = "000000";
  Label host;
  host.type = "Car";
  host.box.bev = {6, 8, 4, 1.6, 0};
  host.occluded = 1;
  host.truncated = 0.3;
  Label other = host;
  other.type = "Van";
  other.box.bev.x = 30;
  frame.labels = {host, other};
  return frame;
}

TEST(FalsePositives, EveryNewBoxHasItsDistances) {
  const Frame frame = frame_with_host();
  EvaluationSettings settings;
  const Detection found{{6, 8, 4, 1.6, 0}, 2}, near_box{{9, 12, 4, 1.6, 0}, 0},
      far_box{{36, 48, 4, 1.6, 0}, 1}, known{{15, -9, 4, 1.6, 0}, 1}, real{{30, 8, 4, 1.6, 0}, 1};
  HostOutcome host =
      judge({"000000", 0}, frame, {found, known}, {found, far_box, near_box, known, real}, settings);
  EXPECT_TRUE(host.detected);
  EXPECT_FALSE(host.hidden);
  EXPECT_EQ(host.occluded, 1);
  EXPECT_EQ(host.truncated, 0.3);
  EXPECT_EQ(host.kind, "Car");
  ASSERT_EQ(host.new_boxes.size(), 2u);
  EXPECT_NEAR(host.new_boxes[0].distance, 50, 1e-12);
  EXPECT_NEAR(host.new_boxes[0].range, 60, 1e-12);
  EXPECT_NEAR(host.new_boxes[1].distance, 5, 1e-12);
  EXPECT_EQ(host.new_boxes[1].score, 0.5);
  EXPECT_EQ(host.false_positive_distance, host.new_boxes[0].distance);

  HostOutcome unseen = host;
  unseen.detected = false;  // FP ASR does not count an undetected host
  const auto json = false_positives_json({host, unseen});
  EXPECT_EQ(json.at("vehicles"), 1);
  EXPECT_EQ(json.at("boxes"), 2);
  EXPECT_EQ(json.at("distance_from_host").at("median"), host.new_boxes[1].distance);
  EXPECT_EQ(json.at("distance_from_host").at("p90"), host.new_boxes[0].distance);
  EXPECT_EQ(json.at("distance_from_sensor").at("counts").at(12), 1);  // 60-65 m
  EXPECT_EQ(json.at("score").at("counts").at(5), 1);
  EXPECT_EQ(json.at("list").size(), 2u);
  EXPECT_TRUE(false_positives_json({}).at("score").at("median").is_null());
}

TEST(Judge, AGrownBoxHasItsOwnSuccess) {
  const Frame frame = frame_with_host();
  const BevBox& car = frame.labels[0].box.bev;
  const EvaluationSettings settings;
  const Box3 grown{{car.x - 1, car.y, car.length + 2, car.width, 0}, 0, 1.5};
  const Detection on_car{car, 2}, on_both{grown.bev, 2};
  const auto hidden = [&](const Detection& attacked, const std::optional<Box3>& box) {
    const HostOutcome one = judge({"000000", 0}, frame, {on_car}, {attacked}, settings, {{}, {}, box});
    EXPECT_TRUE(one.detected);  // without the object the labelled box is the truth
    return one.hidden;
  };
  EXPECT_FALSE(hidden(on_car, {}));
  EXPECT_TRUE(hidden(on_both, {}));  // IoU 2/3
  EXPECT_TRUE(hidden(on_car, grown));
  EXPECT_FALSE(hidden(on_both, grown));
  // A detection of the object alone is a new box beside the label's, but part of the grown box.
  const Detection rear{{car.x - 2, car.y, 3, car.width, 0}, 2};
  const Detection elsewhere{{car.x, car.y - 3, 4, 1.6, 0}, 2};
  for (const bool part : {false, true}) {
    const HostOutcome one = judge({"000000", 0}, frame, {elsewhere}, {rear}, settings,
                                  {{}, {}, part ? std::optional(grown) : std::nullopt});
    EXPECT_EQ(one.false_positive, !part);
  }
}

TEST(Judge, ANeighbourIsJudgedInTheHostsPlace) {
  const Frame frame = frame_with_host();
  const Detection host{frame.labels[0].box.bev, 2}, other{frame.labels[1].box.bev, 2};
  EvaluationSettings settings;
  const HostOutcome outcome = judge({"000000", 0}, frame, {host, other}, {host}, settings, {.victim = 1});
  EXPECT_TRUE(outcome.detected);
  EXPECT_TRUE(outcome.hidden);
  EXPECT_EQ(outcome.id.label, 0);
  EXPECT_EQ(outcome.victim, 1);
  EXPECT_EQ(outcome.kind, "Van");
  EXPECT_NEAR(outcome.range, std::hypot(30, 8), 1e-12);
  EXPECT_FALSE(judge({"000000", 0}, frame, {host, other}, {other}, settings, {.victim = 1}).hidden);
  const auto json = outcomes_json({outcome}, 1);
  EXPECT_EQ(json.at(0).at("victim"), 1);
  EXPECT_EQ(json.at(0).at("label"), 0);
}

TEST(Judge, TheObjectItselfIsJudgedByItsOwnBox) {
  const Frame frame = frame_with_host();
  Label own, plain;
  own.type = plain.type = "Misc";
  own.box = {{12, -3, 0.8, 0.6, 0}, 0, 0.5};
  plain.box = {{12, -3, 1, 1, 0}, 0, 1};
  const EvaluationLabels boxes{.own = own, .plain = plain};
  const Detection host{frame.labels[0].box.bev, 2}, thing{plain.box.bev, 2}, part{{12, -3, 0.3, 0.6, 0}, 2};
  const auto one = [&](const Detection& attacked) {
    return judge({"000000", 0}, frame, {host, thing}, {host, attacked}, EvaluationSettings(), boxes);
  };
  const HostOutcome seen = one(part), unseen = one(host);
  EXPECT_EQ(seen.kind, "object");
  EXPECT_NEAR(seen.range, std::hypot(12, 3), 1e-12);
  EXPECT_NEAR(seen.clean_iou, 1, 1e-12);
  EXPECT_NEAR(seen.attacked_iou, 0.375, 1e-12);
  EXPECT_FALSE(seen.false_positive);
  EXPECT_TRUE(kMissCriteria[0].finds(seen, true));
  EXPECT_TRUE(kMissCriteria[0].finds(seen, false));
  EXPECT_FALSE(kMissCriteria[0].finds(unseen, false));
  // A box on the object is no false positive, even if the clean pass finds nothing there.
  EXPECT_FALSE(judge({"000000", 0}, frame, {}, {thing}, EvaluationSettings(), boxes).false_positive);
  EXPECT_TRUE(judge({"000000", 0}, frame, {}, {thing}, EvaluationSettings()).false_positive);
}

TEST(Judge, AnObjectsCleanFrameHasAPlainOneInIt) {
  test::World world = test::make_world(1);
  EXPECT_FALSE(labelled_boxes(world.placement, {}, world.prepared.frame.calibration, {}).own);
  world.placement.victim = Victim::object;
  world.placement.volume = Vec3d(1, 0.8, 0.6);
  const Mesh placed = place(world.adversary, world.placement).mesh;
  const EvaluationLabels boxes =
      labelled_boxes(world.placement, placed, world.prepared.frame.calibration, {});
  ASSERT_TRUE(boxes.own && boxes.plain);
  const Vec3d size = bounds(plain_object(world.placement).mesh).sizes();
  EXPECT_LT((size - world.placement.volume).norm(), 1e-12);
  EXPECT_LT(boxes.own->box.height, boxes.plain->box.height + 1);
  EXPECT_NE(boxes.own->box.bev.length, boxes.plain->box.bev.length);
}

TEST(Judge, TheObjectCountsWithItsCarrierAlone) {
  test::World world = test::make_world(1);
  const PictureBox seen{1, 2, 3, 4};
  const auto labelled_boxes = [&](const Placement& placement, const PictureBox& object) {
    return mirage::labelled_boxes(placement, {}, world.prepared.frame.calibration, object);
  };
  EXPECT_TRUE(labelled_boxes(world.placement, seen).object);
  world.placement.neighbour = 1;
  EXPECT_FALSE(labelled_boxes(world.placement, seen).object);
  world.placement.neighbour.reset();
  world.placement.support = Support::free;
  world.placement.grows_box = true;
  EXPECT_FALSE(labelled_boxes(world.placement, seen).object);
}

TEST(FalsePositives, AKindIsTheDataSetsWhereItTells) {
  EvaluationSettings settings;
  settings.kinds = {{"000000_0", "estate"}};
  EXPECT_EQ(judge({"000000", 0}, frame_with_host(), {}, {}, settings).kind, "estate");
  EXPECT_EQ(judge({"000000", 1}, frame_with_host(), {}, {}, settings).kind, "Van");
}

TEST(VehicleKinds, RecordedSetsTellNone) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1);
  EXPECT_TRUE(vehicle_kinds(folder / "data", {{"000000", 0}}).empty());
}

}  // namespace

// Hosts of an evaluation in its file, and back.

namespace {

constexpr int kMeshes = 2;

/// A host with no field at its default, under two meshes, and a host without any known value.
std::vector<HostOutcome> outcomes(Matching matching) {
  HostOutcome host;
  host.id = {"000012", 3};
  host.matching = matching;
  host.track = 40;
  host.from_box = false;
  host.range = 12.5;
  host.occluded = 2;
  host.truncated = 0.25;
  host.kind = "hatchback";
  host.clean_iou = 0.9, host.attacked_iou = 0.2;
  host.clean_score = 0.8, host.attacked_score = 0.4;
  if (!matching.in_picture()) host.clean_distance = 0.1;
  host.detected = host.hidden = host.false_positive = true;
  host.false_positive_distance = 30;
  host.new_boxes = {{{}, 0.5, 30, 20}, {{}, 0.6, 4, 10}};
  HostOutcome other = host, plain;
  other.mesh = 1;
  other.new_boxes.pop_back();
  plain.matching = matching;
  plain.id = {"000013", 0};
  return {host, plain, other};
}

nlohmann::json file_of(const std::vector<HostOutcome>& hosts) {
  return {{"outcomes", outcomes_json(hosts, kMeshes)}, {"false_positives", false_positives_json(hosts)}};
}

TEST(EvaluationOutcomes, AreReadAsTheyWereWritten) {
  for (const Matching matching : {kFromAbove, kInPicture}) {
    const nlohmann::json written = file_of(outcomes(matching));
    const std::vector<HostOutcome> read = read_outcomes({"result.json", written, "fix"});
    ASSERT_EQ(read.size(), 3u);
    EXPECT_EQ(outcomes_json(read, kMeshes), written.at("outcomes"));
    EXPECT_EQ(read[0].matching.in_picture(), matching.in_picture());
    ASSERT_EQ(read[0].new_boxes.size(), 2u);
    EXPECT_EQ(read[0].new_boxes[1].distance, 4);
    EXPECT_TRUE(read[1].new_boxes.empty());
    EXPECT_EQ(read[1].track, -1);
    EXPECT_EQ(read[2].new_boxes.size(), 1u);
  }
}

TEST(EvaluationOutcomes, ADamagedFileIsNamedByItsField) {
  const nlohmann::json written = file_of(outcomes(kFromAbove));
  const auto error = [](const nlohmann::json& file) {
    return test::error_text<InputError>([&] { read_outcomes({"result.json", file, "fix"}); });
  };
  nlohmann::json file = written;
  file["outcomes"][1].erase("hidden");
  EXPECT_THAT(error(file), testing::HasSubstr("outcomes[1].hidden"));
  file = written;
  file["outcomes"][0]["label"] = -1;
  EXPECT_THAT(error(file), testing::HasSubstr("outcomes[0].label"));
  file = written;
  file["false_positives"]["list"][2]["distance_from_host"] = nullptr;
  EXPECT_THAT(error(file), testing::HasSubstr("false_positives.list[2].distance_from_host"));
  file["false_positives"] = 3;
  EXPECT_THAT(error(file), testing::HasSubstr("false_positives"));
}

}  // namespace
}  // namespace mirage
