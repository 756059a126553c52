// `mirage compare` as a release gate, and contradictory lists and options.
#include "program.h"

namespace mirage {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class CompareGate : public test::Program {
 protected:
  void SetUp() override { environment_ = "MIRAGE_CACHE=" + at("cache"); }
  const std::string compare_ = "compare --quiet --mesh " MIRAGE_SOURCE
                               "/scenes/objects/ellipsoid.glb --data " +
                               frames_ + " --out " + at("compare");
};

TEST_F(CompareGate, FailsWhereTheSecondDetectorFindsNothing) {
  MIRAGE_NEED_FUSION();
  EXPECT_EQ(mirage(compare_ + " --detectors lidar --defense none ceiling:0.01 --fail-above 0"), 1) << said();
  EXPECT_THAT(said(), AllOf(HasSubstr("--fail-above: both detectors find 0 of"), HasSubstr("mirage detect")));
  const nlohmann::json result = json("compare/result.json").at("compare");
  EXPECT_GT(result.at("found").at(0), 0);
  EXPECT_EQ(result.at("found").at(1), 0);
}

TEST_F(CompareGate, RefusesADetectorAgainstItself) {
  MIRAGE_NEED_FUSION();
  for (const char* detectors : {"lidar", "lidar lidar", "lidar --defense none none"})
    EXPECT_THAT(refused(compare_ + " --detectors " + detectors), HasSubstr("is compared with itself"));
}

TEST_F(CompareGate, ACertificateIsOfRunsOnRoofs) {
  MIRAGE_NEED_FUSION();
  ASSERT_EQ(mirage("attack --quiet --iterations 1 --batch 2 --detector lidar --place 0,0,2,0 --data " +
                   frames_ + " --out " + at("run")),
            0)
      << said();
  EXPECT_THAT(refused("certify --detector lidar --data " + frames_ + " --run " + at("run") + " --out " +
                      at("certify")),
              AllOf(HasSubstr("--run"), HasSubstr("0,0,2,0"), HasSubstr("about roofs")));
}

TEST_F(CompareGate, WhatIsGivenTwiceIsNamedByItsOption) {
  EXPECT_THAT(refused("attack --iterations 5 --iterations 6 --data " + frames_ + " --out " + at("run")),
              HasSubstr("--iterations: is given more than once; give it once"));
  EXPECT_THAT(refused("attack --data"), HasSubstr("--data: needs a value"));
  EXPECT_THAT(refused("evaluate --run " + at("none") + " --expect worst:4 --out " + at("evaluate")),
              HasSubstr("--expect: worst:4"));
  EXPECT_THAT(refused("attack --expect none,all --data " + frames_ + " --out " + at("run")),
              HasSubstr("--expect: none,all"));
  EXPECT_THAT(refused("certify --sizes 0.8,0.8 --data " + frames_ + " --out " + at("certify")),
              HasSubstr("--sizes: 0.8: is given twice"));
}

}  // namespace
}  // namespace mirage
