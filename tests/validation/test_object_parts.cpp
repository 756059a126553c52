// Shape, texture and size alone: the cases, the table, and what follows, from made-up evaluations.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/files.h"
#include "support/files.h"
#include "validation/paper/case_list.h"
#include "validation/paper/findings.h"
#include "validation/paper/reproduce.h"
#include "validation/paper_program.h"

namespace mirage::paper {
namespace {

using mirage::test::MadeUp;
using mirage::test::Program;
using mirage::test::settings_in;
using mirage::test::TemporaryFolder;
using mirage::test::vanishing;
using testing::HasSubstr;

const Finding& finding_of(const ReproduceResult& result, const std::string& name) {
  for (const Finding& finding : result.findings)
    if (finding.name == name) return finding;
  throw std::out_of_range(name);
}

/// What the check about the place says.
const Check& check_of(const Finding& finding, const std::string& place) {
  for (const Check& check : finding.checks)
    if (check.rig == place) return check;
  throw std::out_of_range(place);
}

TEST(ObjectParts, EachPartIsLearnedAloneThroughEachSensorThatItReaches) {
  const Experiments list = experiments(settings_in("/out", "parts"));
  ASSERT_EQ(list.tables.size(), 1u);
  EXPECT_EQ(list.tables[0].rows.size(), 10u);
  for (const char* target : {"image", "lidar", "both"})
    for (const char* parts : {"", "shape", "texture", "size"}) {
      // Through LiDAR no gradient reaches the texture, and what is learned is the shape.
      if (target == std::string("lidar") &&
          (parts == std::string("shape") || parts == std::string("texture")))
        continue;
      const std::string run = run_name("kitti64", "fusion", target, {.parts = parts});
      const Case& attack = list.at("runs/" + run);
      EXPECT_EQ(attack.setting("target"), target);
      EXPECT_EQ(attack.setting("parts"), parts) << run;
      EXPECT_THAT(list.at("evaluations/" + run).setting("baseline"), HasSubstr("sized"));
    }
}

TEST(ObjectParts, TheWholeObjectsRunsAreThoseOfTheFirstTable) {
  const Experiments first = experiments(settings_in("/out", "table1")),
                    parts = experiments(settings_in("/out", "parts"));
  for (const char* target : {"image", "lidar", "both"}) {
    const Case& one = parts.at(std::string("runs/kitti64-fusion-") + target);
    EXPECT_EQ(first.at(one.name).settings, one.settings) << one.name;
  }
}

TEST(ObjectParts, PlantedCausesAreTold) {
  TemporaryFolder folder;
  Program program;
  // Through the image all of it is texture; through LiDAR all of it is size; through both each part adds.
  const MadeUp none = vanishing(0);
  for (const auto& [arm, hidden] : std::vector<std::pair<std::string, int>>{{"image", 4},
                                                                            {"image-shape", 0},
                                                                            {"image-texture", 4},
                                                                            {"image-size", 0},
                                                                            {"lidar", 3},
                                                                            {"lidar-size", 3},
                                                                            {"both", 5},
                                                                            {"both-shape", 3},
                                                                            {"both-texture", 2},
                                                                            {"both-size", 1}})
    program.planted["kitti64-fusion-" + arm] = {vanishing(hidden), none};
  const ReproduceResult result = reproduce(settings_in(folder.path(), "parts"), std::ref(program));
  const std::string image = "KITTI rig, through the image", lidar = "KITTI rig, through LiDAR",
                    both = "KITTI rig, through both sensors";
  EXPECT_EQ(check_of(finding_of(result, "parts-alone"), image + ", texture").verdict, Verdict::holds);
  EXPECT_EQ(check_of(finding_of(result, "parts-alone"), image + ", shape").verdict, Verdict::open);
  EXPECT_EQ(check_of(finding_of(result, "parts-shape"), image).verdict, Verdict::open);
  EXPECT_EQ(check_of(finding_of(result, "parts-texture"), image).verdict, Verdict::holds);
  EXPECT_EQ(check_of(finding_of(result, "parts-size"), image).verdict, Verdict::holds);
  EXPECT_EQ(check_of(finding_of(result, "parts-size"), lidar).verdict, Verdict::open);
  for (const char* name : {"parts-shape", "parts-texture", "parts-size"})
    EXPECT_EQ(check_of(finding_of(result, name), both).verdict, Verdict::holds) << name;
  EXPECT_THAT(read_file(folder / "parts.md"), HasSubstr("| texture alone, image |"));
  for (const Arm& arm : result.arms)
    if (arm.name == "kitti64-fusion-both-size") {
      EXPECT_EQ(arm.parts, "size");
    }
}

TEST(ObjectParts, ADetectorWithoutEyesSaysNothingAboutItsImage) {
  TemporaryFolder folder;
  Program program;
  program.uses_picture = false;
  const ReproduceResult result = reproduce(settings_in(folder.path(), "parts"), std::ref(program));
  EXPECT_EQ(check_of(finding_of(result, "parts-size"), "KITTI rig, through the image").sentence,
            "this detector does not use its picture: nothing follows about images");
  EXPECT_NE(check_of(finding_of(result, "parts-size"), "KITTI rig, through LiDAR").verdict, Verdict::holds);
  EXPECT_THAT(check_of(finding_of(result, "parts-size"), "KITTI rig, through LiDAR").sentence,
              HasSubstr("the whole object"));
}

}  // namespace
}  // namespace mirage::paper
