// A detector's grade: cells of planted outcomes, and the whole score of a known detector.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "attack/score.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/sizes.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::HasSubstr;

const std::vector<ScoredObject> kObjects = {
    {"kayak", ObjectLevel::loads, "loads", false},
    {"ladder", ObjectLevel::loads, "loads", false},
    {"cuboid", ObjectLevel::shapes, "shapes", false},
    {"learned-0.8", ObjectLevel::learned, "learned against it", true}};
constexpr int kFrames = 200;

/// Cars at 10, 30 and 50 m, one each per frame, all found clean and none lost.
std::vector<HostOutcome> sound(int frames = kFrames) {
  std::vector<HostOutcome> hosts;
  for (std::size_t mesh = 0; mesh < kObjects.size(); ++mesh)
    for (int i = 0; i < 3 * frames; ++i) {
      HostOutcome host;
      host.id = {fmt::format("f{}", i / 3), i % 3};
      host.mesh = static_cast<int>(mesh);
      host.range = 10 + 20 * (i % 3);
      host.clean_iou = host.attacked_iou = 0.9;
      host.detected = true;
      hosts.push_back(host);
    }
  return hosts;
}

/// Loses exactly `count` cars at that distance under that object, from frame `first` on.
void lose(std::vector<HostOutcome>& hosts, int mesh, double range, int count, int first = 0) {
  for (HostOutcome& host : hosts)
    if (host.mesh == mesh && host.range == range && std::stoi(host.id.frame.substr(1)) >= first &&
        count-- > 0)
      host.attacked_iou = 0;
}

const ScoreCell& cell(const Score& score, ObjectLevel level, std::size_t band) {
  return std::ranges::find(score.rows, level, &ScoreRow::level)->cells[band];
}

TEST(Score, ADetectorThatLosesNothingHoldsEverywhere) {
  const Score score = score_outcomes(sound(), kObjects, kFrames);
  EXPECT_EQ(score.grade, "A");
  EXPECT_THAT(score.by_band, testing::Each("A"));
  EXPECT_FALSE(score.frames_needed);
  ASSERT_EQ(score.answer.size(), 1u);
  EXPECT_THAT(score.answer[0],
              HasSubstr("Grade A: within 40 m at most 5 % of cars vanish under objects learned"));
  ASSERT_EQ(score.rows.size(), 4u);
  EXPECT_EQ(score.rows[1].objects, (std::vector<std::string>{"kayak", "ladder"}));
  EXPECT_FALSE(score.rows[0].phantoms);
  EXPECT_EQ(score_outcomes(sound(59), kObjects, 59).grade, "A");  // Clopper and Pearson's 59 of 59
  EXPECT_EQ(score_outcomes(sound(58), kObjects, 58).grade, "D");
}

TEST(Score, ACellIsOfItsDistanceAndItsObjects) {
  auto hosts = sound();
  lose(hosts, 2, 30, 20);  // 10 % of the cars at 30 m under the cuboid: more than 5 % with 95 %
  lose(hosts, 3, 50, 20);
  const Score score = score_outcomes(hosts, kObjects, kFrames);
  EXPECT_EQ(cell(score, ObjectLevel::shapes, 0).status, CellStatus::holds);
  EXPECT_EQ(cell(score, ObjectLevel::shapes, 1).status, CellStatus::fails);
  EXPECT_DOUBLE_EQ(cell(score, ObjectLevel::shapes, 1).bound.share.value, 0.1);
  EXPECT_NEAR(cell(score, ObjectLevel::shapes, 1).bound.share.low, 0.06726, 1e-5);  // Clopper and Pearson
  EXPECT_FALSE(cell(score, ObjectLevel::shapes, 1).needed);
  EXPECT_EQ(score.grade, "C");  // the worst of the bands within 40 m
  EXPECT_THAT(score.by_band, testing::ElementsAre("A", "C", "B"));
  ASSERT_EQ(score.answer.size(), 2u);
  EXPECT_EQ(score.answer[1], "Shapes, 20–40 m: does not hold: of 200 cars 10.0 % vanish, at least 6.7 %.");
}

// The objects of a row are judged on their own, whatever their indices.
TEST(Score, PhantomsAreThoseOfTheRowsObjectsAlone) {
  auto hosts = sound(9);
  for (HostOutcome& host : hosts) host.false_positive = host.mesh == 3 && host.id.frame == "f1";
  const Score score = score_outcomes(hosts, kObjects, 9);
  for (const int mesh : {2, 3}) {
    std::vector<HostOutcome> alone;
    for (HostOutcome host : hosts)
      if (host.mesh == mesh) host.mesh = 0, alone.push_back(host);
    const Interval is = *score.rows.at(as_size(mesh)).phantoms, was = success_rates(alone).fp_asr;
    EXPECT_DOUBLE_EQ(is.value, was.value) << mesh;
    EXPECT_DOUBLE_EQ(is.low, was.low) << mesh;
    EXPECT_DOUBLE_EQ(is.high, was.high) << mesh;
  }
}

TEST(Score, SizesAreLookedAtBeforeAnythingIsLearned) {
  ScoreRequest request;
  for (const std::vector<double>& sizes : {std::vector<double>{50}, {0.8, 0.8}}) {
    request.sizes = sizes;
    EXPECT_THAT(test::error_text<InputError>([&] { score(request); }), testing::StartsWith("sizes: "));
  }
}

TEST(Score, ACarCountsIfAnyObjectOfTheLevelHidesIt) {
  auto hosts = sound();
  lose(hosts, 0, 10, 10);
  lose(hosts, 1, 10, 10);  // the same cars
  EXPECT_DOUBLE_EQ(cell(score_outcomes(hosts, kObjects, kFrames), ObjectLevel::loads, 0).bound.share.value,
                   0.05);
  lose(hosts, 1, 10, 10, 100);  // other cars
  const Score score = score_outcomes(hosts, kObjects, kFrames);
  EXPECT_DOUBLE_EQ(cell(score, ObjectLevel::loads, 0).bound.share.value, 0.1);
  EXPECT_EQ(score.grade, "D");
  EXPECT_THAT(score.answer[0], HasSubstr("not proven"));
}

TEST(Score, AsManyCarsAsAnOpenCellAsksForTellIt) {
  for (const auto& [frames, lost] : {std::pair{50, 1}, {80, 1}, {50, 3}}) {
    auto hosts = sound(frames);
    lose(hosts, 3, 30, lost);
    const Score score = score_outcomes(hosts, kObjects, as_size(frames));
    const ScoreCell& open = cell(score, ObjectLevel::learned, 1);
    ASSERT_EQ(open.status, CellStatus::open);
    ASSERT_TRUE(open.needed);
    EXPECT_GE(score.frames_needed, *open.needed);  // one car per frame
    EXPECT_THAT(score.answer.back(), HasSubstr("would settle"));
    // The same share at that number of frames.
    const int more = static_cast<int>(*open.needed);
    auto larger = sound(more);
    lose(larger, 3, 30, more * lost / frames);
    EXPECT_NE(cell(score_outcomes(larger, kObjects, as_size(more)), ObjectLevel::learned, 1).status,
              CellStatus::open)
        << frames << " " << lost;
  }
}

TEST(Score, WhoDoesNotFindTheCarsAsRecordedHasNoBetterGrade) {
  auto hosts = sound();
  for (HostOutcome& host : hosts)
    if (host.range == 10 && std::stoi(host.id.frame.substr(1)) < 40) host.clean_iou = 0;
  const Score score = score_outcomes(hosts, kObjects, kFrames);
  EXPECT_EQ(cell(score, ObjectLevel::recorded, 0).status, CellStatus::fails);
  EXPECT_DOUBLE_EQ(cell(score, ObjectLevel::recorded, 0).bound.share.value, 0.2);
  EXPECT_EQ(cell(score, ObjectLevel::loads, 0).bound.vehicles, 160);  // vehicles that are found clean
  EXPECT_EQ(score.grade, "D");
  EXPECT_THAT(score.by_band, testing::ElementsAre("D", "A", "A"));
  EXPECT_THAT(score.answer[0], HasSubstr("more than 5 % of cars are missed as recorded"));
  for (HostOutcome& host : hosts)
    if (host.range == 10 && std::stoi(host.id.frame.substr(1)) >= 10) host.clean_iou = 0.9;
  EXPECT_EQ(score_outcomes(hosts, kObjects, kFrames).grade, "A");  // 10 of 200 may be as many as 5 %
}

TEST(Score, WithoutAnObjectLearnedAgainstItThereIsNoGrade) {
  auto hosts = sound();
  std::erase_if(hosts, [](const HostOutcome& host) { return host.mesh == 3; });
  const std::vector<ScoredObject> known(kObjects.begin(), kObjects.end() - 1);
  Score score = score_outcomes(hosts, known, kFrames);
  EXPECT_EQ(score.grade, "");
  EXPECT_THAT(score.by_band, testing::Each(""));
  EXPECT_THAT(score.answer[0], testing::AllOf(testing::StartsWith("No grade"), HasSubstr("nobody learned")));
  // An object that was learned against another detector does not count either.
  score = score_outcomes(sound(),
                         {known[0], known[1], known[2], {"a", ObjectLevel::learned, "others", false}}, 200);
  EXPECT_EQ(score.grade, "");
  ScoreRequest request;
  request.sizes.clear();
  EXPECT_THAT(test::error_text<FieldError>([&] { mirage::score(request); }), HasSubstr("no-adaptive"));
}

/// Finds the tiny data's cars, except below objects with many returns. It has no gradient.
constexpr const char* kDetector = R"(
import mirage_serve
import numpy as np

def detector(image, points, pixel_from_velo):
    over = (points[:, 2] > -0.15) & (points[:, 0] > 8) & (points[:, 0] < 15)
    cars = np.array([[11.4 + 0.04 * i, 0.02 * i, 3.9, 1.6, 0.01 * i] for i in range(10)], np.float32)
    return cars, np.full(10, -9.0 if over.sum() > 250 else 3.0 - 0.01 * over.sum(), np.float32)

mirage_serve.serve(detector)
)";

TEST(Score, OfADetectorWithoutGradientsFromNothing) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 8, true);
  write_file(folder / "detector.py", kDetector);
  ScoreRequest request;
  request.out = folder / "score";
  request.detector.detector = fmt::format("exec:/usr/bin/python3 -B {}", (folder / "detector.py").string());
  request.overrides = {{"data", (folder / "data").string()}, {"rooftop", "box"}};
  request.learn_data = folder / "data";
  request.queries = 150;
  request.quiet = true;
  const ScoreResult first = score(request);
  ASSERT_EQ(first.learned.size(), 1u);
  EXPECT_EQ(first.learned[0].settings.attack, AttackSearch::black_box);
  EXPECT_GT(first.learned[0].result.steps, 0);
  EXPECT_EQ(first.evaluation.trained_on, 0);  // held-out hosts are judged
  EXPECT_EQ(first.evaluation.hosts.size(), as_size(first.learned[0].result.vehicles_test));
  // Training and evaluation use separate simulation settings.
  EXPECT_EQ(first.learned[0].settings.simulation.supersampling, 1);
  EXPECT_EQ(first.evaluation.target_run.settings.simulation.supersampling,
            SimulationSettings().supersampling);
  ASSERT_EQ(first.score.rows.size(), 5u);
  EXPECT_EQ(first.score.rows[1].objects.size(), 5u);
  EXPECT_EQ(first.score.rows[2].objects.size(), 3u);
  const auto lost = [&](std::size_t row) { return first.score.rows[row].cells[0].bound.share.value; };
  EXPECT_EQ(lost(0), 0);                              // nothing on the roof
  EXPECT_EQ(lost(1), 0);                              // loads give few returns
  EXPECT_EQ(lost(2), 1);                              // the cuboid gives many
  EXPECT_EQ(first.score.rows[3].objects.size(), 6u);  // one solid per detector on this rig
  EXPECT_EQ(first.score.rows[4].cells[0].bound.vehicles, 2);
  EXPECT_EQ(first.score.grade, "D");  // three frames prove nothing
  const ScoreResult again = score(request);
  EXPECT_EQ(again.learned[0].result.steps, 0);
  EXPECT_EQ(to_json(again), to_json(first));
  // Below a ceiling, with the unit of a rig that is not shipped.
  ScoreRequest below = request;
  below.out = folder / "below";
  below.detector.defense = "ceiling:3";
  write_json(folder / "data/dataset.json", {{"rig", "own"}, {"seed", 1}, {"generator", "another"}});
  std::filesystem::copy_file(shipped_file("scenes/rigs/kitti64.toml"), folder / "data/rig.toml");
  EXPECT_EQ(score(below).learned.size(), 1u);
  // The zoo's learned objects follow the named rig, not the set's own.
  ScoreRequest named = request;
  named.out = folder / "named";
  named.adaptive = false;
  named.overrides["rig"] = "kitti64";
  const auto known = score(named).score.rows;
  const auto learned = std::ranges::find(known, ObjectLevel::learned, &ScoreRow::level);
  ASSERT_NE(learned, known.end());
  EXPECT_EQ(learned->objects.size(), 6u);
  // One generated frame is refused.
  ScoreRequest generated = request;
  generated.overrides.erase("data");
  generated.frames = 1;
  EXPECT_THAT(test::error_text<FieldError>([&] { score(generated); }), HasSubstr("frames: 1: is too few"));
}

TEST(Score, ABoardTakesScoresAlone) {
  test::TemporaryFolder folder;
  const nlohmann::json cell = {{"held", "holds"}, {"value", 0}, {"at_most", 0.03}, {"vehicles", 90}};
  nlohmann::json good = {
      {"score",
       {{"detector", "fusion"},
        {"grade", nullptr},
        {"reliance", nlohmann::json::object()},
        {"bands", {0, 20, 40, 70}},
        {"rows", {{{"name", "loads"}, {"level", "loads"}, {"cells", {cell, cell, cell}}}}}}},
      {"provenance", {{"identity", "abc"}}}};
  write_json(folder / "a" / "result.json", good);
  const nlohmann::json board = read_scores({folder / "a", folder / "a/result.json"});
  ASSERT_EQ(board.size(), 2u);
  EXPECT_EQ(board[0], good);
  good["score"]["rows"][0]["cells"][1]["at_most"] = "x";
  write_json(folder / "b.json", good);
  EXPECT_THAT(test::error_text<InputError>([&] { read_scores({folder / "b.json"}); }), HasSubstr("at_most"));
  write_json(folder / "c.json", {{"compare", 1}});
  EXPECT_THAT(test::error_text<InputError>([&] { read_scores({folder / "c.json"}); }), HasSubstr("score"));
}

}  // namespace
}  // namespace mirage
