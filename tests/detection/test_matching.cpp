// How boxes are compared, against cases worked out by hand.
#include <gtest/gtest.h>

#include "base/error.h"
#include "detection/average_precision.h"

namespace mirage {
namespace {

ObjectBoxes boxes(double x, double y, double bottom, const PictureBox& picture = {}) {
  return {Box3{{x, y, 4, 2, 0}, bottom, 2}, picture};
}

TEST(Matching, OverlapIsThatOfItsKind) {
  const ObjectBoxes a = boxes(10, 0, 0, {0, 0, 100, 50}), b = boxes(12, 0, 1, {50, 0, 150, 50});
  EXPECT_NEAR(kFromAbove.overlap(a, b), 1.0 / 3, 1e-12);
  EXPECT_NEAR(kInSpace.overlap(a, b), 4.0 / 28, 1e-12);
  EXPECT_NEAR(kInPicture.overlap(a, b), 1.0 / 3, 1e-12);
  EXPECT_NEAR(kByCentre.overlap(a, b), 0.5, 1e-12);  // 2 m
  EXPECT_EQ(kByCentre.overlap(a, boxes(14, 0, 0)), 0);
  EXPECT_EQ(kByCentre.overlap(a, boxes(30, 0, 0)), 0);
  EXPECT_DOUBLE_EQ(kFromAbove.distance(a, b), 2);
  EXPECT_DOUBLE_EQ(kInPicture.distance(a, b), 50);
  EXPECT_DOUBLE_EQ(kFromAbove.area(a), 8);
  EXPECT_DOUBLE_EQ(kInPicture.area(a), 5000);
  EXPECT_NEAR(kFromAbove.intersection(a, b), 4, 1e-12);
  EXPECT_NEAR(kInPicture.intersection(a, b), 2500, 1e-9);
}

TEST(Matching, BoxesOfTwoCamerasNeverMeet) {
  ObjectBoxes a = boxes(10, 0, 0, {0, 0, 100, 50}), b = a;
  b.camera = 2;
  EXPECT_EQ(kInPicture.overlap(a, b), 0);
  EXPECT_EQ(kInPicture.intersection(a, b), 0);
  EXPECT_DOUBLE_EQ(kFromAbove.overlap(a, b), 1);
}

TEST(Matching, NamesItselfAsTheOptionHasIt) {
  EXPECT_EQ(kFromAbove.name(), "bev");
  EXPECT_EQ(kInSpace.name(), "3d");
  EXPECT_EQ(kInPicture.name(), "picture");
  EXPECT_EQ(kByCentre.name(), "centre");
  EXPECT_EQ(std::string(words_of(MatchBy())[0]), "own");
}

TEST(Matching, DecidesWhatIsSuppressedAndWhatIsAHit) {
  Detection low({10, 0, 4, 2, 0}, 3), high = low;
  low.box.height = high.box.height = 1.5;
  high.box.bottom = 2, high.logit = 2;  // one over the other
  EXPECT_EQ(suppress({low, high}, kFromAbove).size(), 1u);
  EXPECT_EQ(suppress({low, high}, kInSpace).size(), 2u);
  Detection other = low;
  other.type = 1;
  EXPECT_EQ(suppress({low, other}, kFromAbove).size(), 2u);  // of another class
  Detection flat = low;
  flat.box.height = 0;
  EXPECT_THROW(suppress({flat}, kInSpace), InputError);

  // Turned by 90°: IoU 1/3 from above, and the centre where it was.
  const Detection turned({10, 0, 2, 4, 0}, 3);
  TruthBoxes truth;
  truth.boxes = {BevBox{10, 0, 4, 2, 0}};
  const auto ap = [&](Matching matching) {
    return average_precision(std::vector{ScoredFrame{{turned}, truth, 0, matching}}, 0.5).average_precision;
  };
  EXPECT_EQ(ap(kFromAbove), 0);
  EXPECT_DOUBLE_EQ(ap(kByCentre), 1);
}

}  // namespace
}  // namespace mirage
