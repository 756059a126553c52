// The list of experiments, its tables, and the verdicts on the paper's findings.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <set>

#include "base/error.h"
#include "base/files.h"
#include "support/files.h"
#include "validation/paper/reproduce.h"
#include "validation/paper_fixture.h"

namespace mirage::paper {
namespace {

using mirage::test::PaperProgram;
using mirage::test::settings_in;
using mirage::test::TemporaryFolder;
using nlohmann::json;
using testing::HasSubstr;

TEST(PaperExperiments, EveryTableHasItsCases) {
  ReproduceSettings settings = settings_in("/out");
  settings.real = "/real";
  const Experiments all = experiments(settings);
  std::set<std::string> names, tables;
  std::set<std::string> before;
  for (const Case& one : all.cases) {
    EXPECT_TRUE(names.insert(one.name).second) << one.name;
    for (const auto& [setting, need] : one.needs)
      EXPECT_TRUE(before.contains(need)) << one.name << " before " << need;
    before.insert(one.name);
    EXPECT_FALSE(one.settings.empty());
  }
  for (const Table& table : all.tables) {
    EXPECT_TRUE(tables.insert(table.name).second);
    EXPECT_FALSE(table.rows.empty());
    for (const Row& row : table.rows) {
      EXPECT_EQ(all.at(row.evaluation).kind, Case::Kind::evaluate) << row.label;
      if (row.detection.empty()) continue;
      EXPECT_EQ(all.at(row.detection).kind, Case::Kind::detect);
    }
    for (const Row& row : table.rows) {
      for (const auto& [key, value] : row.paper) EXPECT_TRUE(value > 0 && value < 100) << key;
    }
  }
  EXPECT_EQ(tables, (std::set<std::string>{"table1", "table2", "table3", "table4", "fig3", "fig4", "real",
                                           "parts", "fusions", "fusions-real", "fusions-xenith"}));
}

TEST(PaperExperiments, FoldersAreTheDocumentedOnes) {
  const Experiments all = experiments(settings_in("/out"));
  for (const char* name :
       {"data/kitti64", "data/xenith", "runs/kitti64-fusion-both", "runs/xenith-lidar-lidar",
        "runs/kitti64-fusion-both-size0.2", "runs/kitti64-fusion-both-size1.0",
        "runs/kitti64-fusion-both-jpeg50", "runs/kitti64-fusion-both-consistency",
        "runs/kitti64-fusion-both-adversarial-shadows", "runs/kitti64-fusion-both-depth-gate",
        "runs/kitti64-fusion-both-ceiling1.6", "evaluations/kitti64-fusion-image",
        "evaluations/xenith-fusion-both--on--kitti64-fusion-both", "detect/kitti64-fusion-denoising"})
    EXPECT_NO_THROW(all.at(name)) << name;
  EXPECT_THROW(all.at("runs/kitti64-fusion-both-size0.8"), InputError);  // the plain run
  EXPECT_EQ(all.at("runs/kitti64-fusion-both-solid").setting("free"), "false");
  EXPECT_EQ(all.at("runs/kitti64-fusion-both").setting("free"), "true");
}

TEST(PaperExperiments, GivenDataAreNotGenerated) {
  ReproduceSettings settings = settings_in("/out", "table1");
  settings.kitti64 = "/data/k";
  const Experiments list = experiments(settings);
  for (const Case& one : list.cases) EXPECT_NE(one.kind, Case::Kind::generate);
  EXPECT_EQ(list.at("runs/kitti64-fusion-both").setting("data"), "/data/k");
}

TEST(PaperExperiments, JudgedOnFramesMadeForThat) {
  ReproduceSettings settings = settings_in("/out");
  settings.judge_frames = 200;
  settings.seeds = 2;
  const Experiments list = experiments(settings);
  EXPECT_EQ(list.at("data/xenith-judge").setting("frames"), "200");
  EXPECT_NE(list.at("data/kitti64-judge").setting("seed"), list.at("data/kitti64").setting("seed"));
  for (const char* name : {"evaluations/kitti64-fusion-both", "evaluations/kitti64-fusion-both+1",
                           "evaluations/xenith-fusion-both--on--kitti64-fusion-both",
                           "evaluations/kitti64-fusion-both--on--kitti64-lidar-lidar"}) {
    const Case& judging = list.at(name);
    EXPECT_EQ(judging.settings_in("/out").at("data"), "/out/data/kitti64-judge") << name;
    EXPECT_FALSE(judging.settings_in("/out").contains("hosts_of")) << name;  // all vehicles, not a run's
  }
  EXPECT_EQ(list.at("evaluations/xenith-fusion-both--on--kitti64-fusion-both").setting("detector"), "fusion");
  EXPECT_EQ(list.at("evaluations/kitti64-fusion-both--on--kitti64-lidar-lidar").setting("detector"), "lidar");
  EXPECT_EQ(list.at("runs/kitti64-fusion-both").settings_in("/out").at("data"), "/out/data/kitti64");
}

TEST(PaperExperiments, SomeRowsAndWhatTheyNeed) {
  ReproduceSettings settings = settings_in("/out");
  settings.only = {"kitti64-fusion-both", "kitti64-fusion-both-adversarial-shadows"};
  settings.seeds = 2;
  const Experiments some = experiments(settings);
  std::set<std::string> names;
  for (const Case& one : some.cases) names.insert(one.name);
  EXPECT_THAT(names, testing::ElementsAre(
                         "data/kitti64", "detect/kitti64-fusion", "detect/kitti64-fusion-adversarial-shadows",
                         "evaluations/kitti64-fusion-both", "evaluations/kitti64-fusion-both+1",
                         "evaluations/kitti64-fusion-both-adversarial-shadows",
                         "evaluations/kitti64-fusion-both-adversarial-shadows+1", "runs/kitti64-fusion-both",
                         "runs/kitti64-fusion-both+1", "runs/kitti64-fusion-both-adversarial-shadows",
                         "runs/kitti64-fusion-both-adversarial-shadows+1"));
  for (const Table& table : some.tables) EXPECT_FALSE(table.rows.empty()) << table.name;
  settings.only = {"kitti64-fusion-prayer"};
  EXPECT_THAT(test::error_text<InputError>([&] { experiments(settings); }),
              testing::AllOf(HasSubstr("only: kitti64-fusion-prayer"), HasSubstr("OUT/evaluations")));
}

TEST(PaperExperiments, AnotherWordIsAnInputError) {
  EXPECT_THAT(test::error_text<InputError>([] { experiments(settings_in("/out", "table9")); }),
              testing::AllOf(HasSubstr("table9"), HasSubstr("table4")));
}

TEST(PaperExperiments, QuickChangesOnlyWhatWasNotAsked) {
  ReproduceSettings settings = settings_in("/out");
  settings.iterations = ReproduceSettings().iterations;  // set by the user, to the default value
  make_quick(settings, true, false);
  EXPECT_EQ(settings.iterations, ReproduceSettings().iterations);
  EXPECT_LT(settings.frames, ReproduceSettings().frames);
}

TEST(PaperExperiments, QuickKeepsSomeRowsOfEveryTable) {
  ReproduceSettings settings = settings_in("/out", "all");
  const Experiments whole = experiments(settings);
  make_quick(settings);
  const Experiments quick = experiments(settings);
  EXPECT_LT(quick.cases.size(), whole.cases.size() / 3);
  ASSERT_EQ(quick.tables.size(), whole.tables.size());
  for (std::size_t i = 0; i < quick.tables.size(); ++i)
    EXPECT_GE(quick.tables[i].rows.size(), 2u) << quick.tables[i].name;
}

TEST(PaperTables, RowsComeFromTheOutcomes) {
  TemporaryFolder folder;
  PaperProgram program;
  const json result = reproduce(settings_in(folder.path(), "table1"), std::ref(program));
  const json& table = result.at("tables").at(0);
  EXPECT_EQ(table.at("name"), "table1");
  const json& both = table.at("rows").at(4);
  EXPECT_EQ(both.at("label"), "fusion, both");
  EXPECT_EQ(both.at("vehicles"), 200);
  EXPECT_EQ(both.at("frames"), 40);
  // 3 of 5 hidden, among them the one with a false positive, in three frames of four.
  EXPECT_NEAR(both.at("values").at("fn_asr").at("value").get<double>(), 0.45, 1e-12);
  EXPECT_NEAR(both.at("values").at("fp_asr").at("value").get<double>(), 0.15, 1e-12);
  EXPECT_NEAR(both.at("values").at("asr").at("value").get<double>(), 0.45, 1e-12);
  EXPECT_LT(both.at("values").at("asr").at("low").get<double>(), 0.45);
  EXPECT_GT(both.at("values").at("asr").at("high").get<double>(), 0.45);
  EXPECT_NEAR(both.at("paper").at("asr").get<double>(), 0.3468, 1e-12);
  EXPECT_EQ(both.at("false_positive_distances").size(), 30u);
  EXPECT_EQ(both.at("false_positives_of"), 200);
  EXPECT_NEAR(table.at("rows").at(1).at("values").at("asr").at("value").get<double>(), 0.15, 1e-12);
  double seconds = 0;  // of the attack and its evaluation, without the data
  for (const char* step : {"runs/kitti64-fusion-both", "evaluations/kitti64-fusion-both"})
    seconds += result.at("steps").at(step).at("seconds").get<double>();
  EXPECT_GT(seconds, 0);
  EXPECT_NEAR(both.at("minutes").get<double>(), seconds / 60, 1e-12);
  const std::string text = read_file(folder / "table1.md");
  // The made-up detector still has a box on each hidden vehicle: IoU 0.3.
  EXPECT_THAT(
      text, testing::ContainsRegex("\\| fusion, both \\| 0.0 \\([^|]*\\| 0.0 \\([^|]* to [^|]*\\| 45.0 \\("));
  EXPECT_EQ(both.at("values").at("vanished").at("value"), 0);
  EXPECT_EQ(both.at("values").at("net_vanished").at("value"), 0);
  const json& sized = table.at("rows").at(6);
  EXPECT_EQ(sized.at("label"), "fusion, random mesh of its size");
  EXPECT_NEAR(sized.at("values").at("asr").at("value").get<double>(), 0.15, 1e-12);
  EXPECT_FALSE(sized.at("values").contains("net_vanished"));
  EXPECT_THAT(text, HasSubstr("| 34.68 |"));
  const json written = read_json(folder / "reproduce.json");
  for (const char* part : {"what", "settings", "tables", "arms", "findings", "reliance", "steps"})
    EXPECT_EQ(written.at(part), json::parse(result.dump()).at(part)) << part;
  EXPECT_EQ(written.size(), 7u);
}

TEST(PaperExperiments, EverySeedIsAnAttackOfItsOwn) {
  ReproduceSettings settings = settings_in("out", "table1");
  const Experiments once = experiments(settings);
  settings.seeds = 3;
  settings.seed = 10;
  const Experiments three = experiments(settings);
  const auto attacks_in = [](const Experiments& list) {
    return std::count_if(list.cases.begin(), list.cases.end(),
                         [](const Case& one) { return one.kind == Case::Kind::attack; });
  };
  EXPECT_EQ(attacks_in(three), 3 * attacks_in(once));
  const Case& attack = three.at("runs/kitti64-fusion-both+2");
  EXPECT_EQ(attack.setting("seed"), "12");
  EXPECT_EQ(attack.needs, three.at("runs/kitti64-fusion-both").needs);  // data are generated once
  const Case& judged = three.at("evaluations/kitti64-fusion-both+2");
  EXPECT_EQ(judged.settings_in("out").at("run"), "out/runs/kitti64-fusion-both+2");
  EXPECT_FALSE(judged.settings.contains("pictures"));
  EXPECT_THAT(judged.needs, testing::ElementsAre(testing::Pair("run", attack.name)));
}

TEST(PaperTables, IntervalsKnowHowMuchRunsDiffer) {
  const auto asr = [](int seeds, int worse_by_seed) {
    TemporaryFolder folder;
    PaperProgram program;
    program.worse_by_seed = worse_by_seed;
    ReproduceSettings settings = settings_in(folder.path(), "table1");
    settings.seeds = seeds;
    const json result = reproduce(settings, std::ref(program));
    const json& row = result.at("tables").at(0).at("rows").at(4);
    EXPECT_EQ(row.at("label"), "fusion, both");
    EXPECT_EQ(row.at("vehicles"), 200);  // the same vehicles in every run
    EXPECT_EQ(row.at("hosts"), 200);
    EXPECT_EQ(row.at("runs"), seeds);
    if (seeds > 1) {
      EXPECT_THAT(read_file(folder / "table1.md"), HasSubstr("200 in 40 frames, 3 runs"));
    }
    const json& share = row.at("values").at("asr");
    return Interval{share.at("value"), share.at("low"), share.at("high")};
  };
  const Interval once = asr(1, 0), equal = asr(3, 0), different = asr(3, 1);
  const auto width = [](const Interval& share) { return share.high - share.low; };
  EXPECT_NEAR(equal.value, once.value, 1e-12);
  EXPECT_NEAR(width(equal), width(once), 0.05);  // three equal runs are not more vehicles
  EXPECT_NEAR(different.value, 0.3, 1e-12);      // 3, 2 and 1 of 5, in three frames of four
  EXPECT_GT(width(different), width(once) + 0.05);
}

TEST(PaperTables, ARepetitionThatFailsIsLeftOut) {
  TemporaryFolder folder;
  PaperProgram program;
  program.broken = "runs/kitti64-fusion-both+1";
  ReproduceSettings settings = settings_in(folder.path(), "table1");
  settings.seeds = 3;
  const json result = reproduce(settings, std::ref(program));
  EXPECT_EQ(result.at("tables").at(0).at("rows").at(4).at("runs"), 2);
  EXPECT_EQ(result.at("tables").at(0).at("rows").at(3).at("runs"), 3);
  for (const json& arm : result.at("arms"))
    if (arm.at("name") == "kitti64-fusion-both" && arm.at("mesh") == "learned") {
      EXPECT_EQ(arm.at("seeds"), (json{0, 2})) << "each with the others' same seed";
    }
}

TEST(PaperTables, SayWhereTheDetectorDoesNotUseItsPicture) {
  TemporaryFolder folder;
  PaperProgram program;
  program.uses_picture = false;
  const json result = reproduce(settings_in(folder.path(), "table4"), std::ref(program));
  const auto note = [&](std::size_t row) {
    return result.at("tables").at(0).at("rows").at(row).value("note", "");
  };
  EXPECT_EQ(note(0), "");  // no defence at all
  EXPECT_THAT(note(1), HasSubstr("does not use its picture"));
  EXPECT_EQ(note(2), "");  // the sweep's bodies are not about the image
  EXPECT_EQ(note(3), "");  // nor are random meshes
  EXPECT_THAT(note(4), HasSubstr("does not use its picture"));
  EXPECT_EQ(note(5), "");  // nor is adversarial training
  EXPECT_EQ(note(6), "");  // nor are both
  EXPECT_THAT(note(7), HasSubstr("does not use its picture"));
  EXPECT_EQ(note(10), "");  // nor is a ceiling
  EXPECT_THAT(read_file(folder / "table4.md"), HasSubstr("so this says nothing about images"));
  const json& reliance = result.at("reliance");
  ASSERT_FALSE(reliance.empty());
  EXPECT_EQ(reliance.at(0).at("uses_picture"), false);
  EXPECT_THAT(reliance.at(0).at("case").get<std::string>(), testing::StartsWith("kitti64-fusion-both"));
  EXPECT_THAT(read_file(folder / "reproduce.md"),
              HasSubstr("80.0 % with another frame's: 0.0 (-1.0 to +1.0) points"));
  int told = 0, open = 0;
  // Findings without the image: adversarial training, roof objects, shadows, ceilings, size and distance.
  const std::set<std::string> others = {"adversarial", "roof-objects", "shadows", "adversarial+shadows",
                                        "ceiling:1.4", "ceiling",      "far",     "fusions-net"};
  for (const json& finding : result.at("findings"))
    for (const json& check : finding.at("checks")) {
      const bool other =
          others.contains(finding.at("name")) || check.at("rig") == "KITTI rig, adversarial training";
      const std::string sentence = check.at("sentence");
      EXPECT_EQ(sentence.starts_with("this detector does not use its picture"), !other)
          << finding.at("name") << ": " << sentence;
      ++(other ? told : open);
    }
  EXPECT_EQ(told, 9);
  EXPECT_EQ(open, 6);  // JPEG, denoising twice, the depth gate, pictures left out, consistency
}

TEST(PaperTables, RecallCurvesFallWithIoU) {
  TemporaryFolder folder;
  PaperProgram program;
  const json result = reproduce(settings_in(folder.path(), "fig3"), std::ref(program));
  for (const json& row : result.at("tables").at(0).at("rows")) {
    const auto recall = row.at("curve").at("recall").get<std::vector<double>>();
    ASSERT_EQ(recall.size(), 21u);
    EXPECT_TRUE(std::is_sorted(recall.rbegin(), recall.rend())) << row.at("label");
    EXPECT_EQ(row.at("values").at("recall70").at("value"), recall[14]);
    EXPECT_LE(row.at("curve").at("low")[14], recall[14]);
    EXPECT_GE(row.at("curve").at("high")[14], recall[14]);
  }
}

TEST(PaperResults, AnIntervalWithoutEndIsReadAsItWasWritten) {
  TemporaryFolder folder;
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  write_json(
      folder / "result.json",
      {{"ap50", 0.9}, {"ap70", 0.8}, {"ap70_interval", to_json(Interval{0.8, -kInfinity, kInfinity})}});
  const json detection = read_detection(folder / "result.json");
  EXPECT_EQ(detection.at("ap50"), (json{{"value", 0.9}}));
  EXPECT_EQ(detection.at("ap70"), (json{{"value", 0.8}, {"low", nullptr}, {"high", nullptr}}));
}

}  // namespace
}  // namespace mirage::paper
