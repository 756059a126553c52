// `mirage score` and `mirage compare --adaptive` as a user meets them: from scratch, again, and a board.
#include <regex>

#include "program.h"

namespace mirage {
namespace {

using testing::HasSubstr;

class Decisions : public test::Program {
 protected:
  void SetUp() override {
    MIRAGE_NEED_FUSION();
    environment_ = "MIRAGE_CACHE=" + at("cache");
  }
  /// Without the day and time.
  std::string page(const std::string& name) const {
    return std::regex_replace(text(name), std::regex("\\d{4}-\\d\\d-\\d\\dT[\\d:]+Z"), "");
  }
};

TEST_F(Decisions, AScoreFromNothingIsTheSameTwiceAndGoesOnABoard) {
  const std::string score =
      "score --detector lidar --certify --frames 3 --learn-frames 2 --iterations 2 --out " + at("score");
  ASSERT_EQ(mirage(score), 0) << said();
  EXPECT_THAT(said(), testing::AllOf(HasSubstr("Grade D"), HasSubstr("loads that people carry"),
                                     HasSubstr("20–40 m"), HasSubstr("no picture")));
  const nlohmann::json first = json("score/result.json"), &told = first.at("score");
  EXPECT_EQ(told.at("grade"), "D");
  EXPECT_EQ(told.at("frames"), 3);
  EXPECT_EQ(told.at("learned").at(0).at("steps"), 2);
  ASSERT_EQ(told.at("rows").size(), 5u);
  EXPECT_EQ(told.at("rows").at(1).at("objects").size(), 5u);
  EXPECT_EQ(told.at("rows").at(3).at("objects").size(), 6u);
  EXPECT_EQ(told.at("rows").at(4).at("level"), "learned");
  EXPECT_THAT(said(), HasSubstr("use of the sweep"));
  EXPECT_TRUE(told.at("uses").contains("points"));
  const nlohmann::json &certified = told.at("certified").at(0), &all = certified.at("bands").at(0);
  EXPECT_GE(certified.at("adversaries"), 2);
  EXPECT_EQ(all.at("hosts"), told.at("hosts"));
  EXPECT_GE(all.at("known50").at("attacked").at("value"), all.at("known50").at("certified").at("value"));
  EXPECT_TRUE(all.at("lattice50").contains("certified"));
  EXPECT_EQ(first.at("provenance").at("settings").at("iterations"), 2);
  const std::string sheet = page("score/score.html");
  EXPECT_THAT(sheet, HasSubstr("Grade D"));

  ASSERT_EQ(mirage(score), 0) << said();
  const nlohmann::json again = json("score/result.json");
  EXPECT_EQ(again.at("score"), told);
  EXPECT_EQ(again.at("provenance").at("identity"), first.at("provenance").at("identity"));
  EXPECT_EQ(page("score/score.html"), sheet);

  ASSERT_EQ(mirage("score --board " + at("score") + " " + at("score/result.json") + " --out " + at("board")),
            0)
      << said();
  EXPECT_EQ(json("board/result.json").at("board").size(), 2u);
  EXPECT_THAT(page("board/board.html"), HasSubstr("2 scores"));
  EXPECT_EQ(mirage("score --board " + at("score") + " --out " + at("score")), 2);
  EXPECT_THAT(said(), HasSubstr("--out"));
  EXPECT_EQ(mirage("score --board " + at("score/judged") + " --out " + at("board")), 2);

  // Any detector can be certified, with the masks that hold a roof or with all masks.
  const std::string certify =
      "certify --sizes 0.8 --objects 0 --lattice --farthest 20 --mesh zoo --frames 1 --data " +
      at("score/judged") + " --out " + at("certify");
  ASSERT_EQ(mirage(certify + " --detector lidar"), 0) << said();
  EXPECT_THAT(said(), HasSubstr("L = 0.8 m, lattice"));
  ASSERT_EQ(mirage(certify + " --detector lidar --whole-lattice"), 0) << said();
  EXPECT_THAT(said(), HasSubstr("of the whole lattice"));

  // Only known objects: no grade, and no training frames.
  ASSERT_EQ(
      mirage("score --detector lidar --no-adaptive --data " + at("score/judged") + " --out " + at("known")),
      0)
      << said();
  EXPECT_THAT(said(), HasSubstr("No grade"));
  EXPECT_TRUE(json("known/result.json").at("score").at("grade").is_null());
  EXPECT_FALSE(exists("known/learn"));
  EXPECT_EQ(mirage("score --detector lidar --frames 2 --out " + at("score")), 2);
  EXPECT_THAT(said(), testing::AllOf(HasSubstr("--frames: 2"), HasSubstr("holds 3")));
}

TEST_F(Decisions, EachDetectorIsComparedUnderItsOwnObject) {
  ASSERT_TRUE(std::filesystem::exists(frames_)) << "ctest makes them (frames.generated)";
  for (const char* detector : {"lidar", "fusion"})
    ASSERT_EQ(mirage(std::string("attack --quiet --iterations 2 --detector ") + detector + " --data " +
                     frames_ + " --out " + at(detector)),
              0)
        << said();
  const std::string compare = "compare --detectors lidar fusion --runs " + at("lidar") + " " + at("fusion") +
                              " --data " + frames_ + " --out " + at("compare");
  ASSERT_EQ(mirage(compare + " --adaptive"), 0) << said();
  EXPECT_THAT(said(), HasSubstr("own"));
  const nlohmann::json result = json("compare/result.json").at("compare");
  EXPECT_EQ(result.at("objects").size(), 2u);
  EXPECT_GT(result.at("own").at("vehicles"), 0);
  // Only frames in neither run's training set.
  EXPECT_EQ(result.at("hosts"), json("lidar/run.json").at("test").size());
  EXPECT_THAT(page("compare/compare.html"), HasSubstr("each under its own object"));
  EXPECT_EQ(mirage("compare --detectors lidar fusion --adaptive --runs " + at("lidar") + " --data " +
                   frames_ + " --out " + at("compare")),
            2);
}

}  // namespace
}  // namespace mirage
