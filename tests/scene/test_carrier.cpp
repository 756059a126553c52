#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "scene/carrier.h"
#include "support/files.h"

namespace mirage {
namespace {

TEST(BoxRoofFinder, StandsOnTheTopFaceBehindTheCentreAlongTheHeading) {
  Label label;
  label.type = "Car";
  label.box = {{20, -4, 4, 1.8, 0.7}, -1.7, 1.5};
  const Carrier carrier = BoxRoofFinder().find({}, label);
  const Transform& pose = carrier.velo_from_roof;
  EXPECT_TRUE(carrier.from_box);
  EXPECT_TRUE((pose.linear() * Vec3d::UnitX()).isApprox(Vec3d(std::cos(0.7), std::sin(0.7), 0), 1e-12));
  EXPECT_TRUE((pose.linear() * Vec3d::UnitZ()).isApprox(Vec3d::UnitZ(), 1e-12));
  EXPECT_NEAR(pose.linear().determinant(), 1, 1e-12);
  const Vec3d p_box = velo_from_box(label.box).inverse() * pose.translation();
  EXPECT_NEAR(p_box.z(), 1.5, 1e-12);
  EXPECT_NEAR(p_box.y(), 0, 1e-12);
  EXPECT_LT(p_box.x(), 0);
  EXPECT_GT(p_box.x(), -0.15 * 4);
  EXPECT_TRUE(contains(label.box, pose.translation(), 1e-9));
}

std::string normal(const std::string& text) {
  PlaceChoice place;
  set_from_text(text, place);
  return text_of(place);
}

TEST(Place, HasOneTextHoweverItIsSpelt) {
  EXPECT_EQ(normal("roof"), "roof");
  for (const char* text : {"2,0,0.5,90", "+2.0,-0,5e-1,450", "2.00,0,.5,-270"})
    EXPECT_EQ(normal(text), "2,0,0.5,90") << text;
  for (const char* text : {"world:1,2,3,180", "world:1,2,3,-180", "world:1,2,3,540"})
    EXPECT_EQ(normal(text), "world:1,2,3,180") << text;
  EXPECT_EQ(normal("0,0,0,360.1"), normal("0,0,0,0.1"));
  EXPECT_NE(normal("1,2,3,4"), normal("world:1,2,3,4"));
  for (const char* text : {"-1.25,0.3,1e-3,-179.9", "world:999.5,0,-1.7,0"})
    EXPECT_EQ(normal(normal(text)), normal(text)) << text;
}

TEST(Place, OtherTextsAreRefusedInALineThatSaysWhatToUse) {
  for (const char* text :
       {"", "thatched", "roof,", "1,2,3", "1,2,3,4,5", "1,2,3,x", "world:", "world:roof", "1001,0,0,0",
        "nan,0,0,0", "0,0,inf,0", "0,0,0,inf", "0,0,0,nan", "velo:1,2,3,4"}) {
    const std::string said = test::error_text<FieldError>([&] { normal(text); });
    EXPECT_THAT(said, testing::StartsWith("placement: ")) << text;
    EXPECT_EQ(said.find('\n'), std::string::npos) << text;
  }
}

}  // namespace
}  // namespace mirage
