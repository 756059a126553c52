#include <gtest/gtest.h>

#include "geometry/picture_box.h"

namespace mirage {
namespace {

TEST(PictureBox, OverlapByHand) {
  const PictureBox box{10, 20, 30, 30};
  EXPECT_DOUBLE_EQ(area(box), 200);
  EXPECT_DOUBLE_EQ(iou(box, box), 1);
  EXPECT_DOUBLE_EQ(intersection_area(box, {25, 15, 50, 25}), 25);
  EXPECT_DOUBLE_EQ(iou(box, {20, 20, 40, 30}), 1.0 / 3);
  EXPECT_DOUBLE_EQ(iou({20, 20, 40, 30}, box), 1.0 / 3);
  EXPECT_DOUBLE_EQ(iou(box, {15, 22, 20, 27}), 25.0 / 200);  // inside
  EXPECT_EQ(iou(box, {30, 20, 40, 30}), 0);                  // edge to edge
  EXPECT_EQ(iou(box, {40, 20, 50, 30}), 0);
  EXPECT_EQ(iou(box, {12, 25, 12, 28}), 0);        // no area
  EXPECT_EQ(area(PictureBox{30, 30, 10, 20}), 0);  // sides in the wrong order
  EXPECT_EQ(iou(box, {30, 30, 10, 20}), 0);
}

TEST(PictureBox, ItsRectangleOverlapsAsItDoes) {
  const PictureBox a{10, 20, 30, 30};
  for (const PictureBox& b :
       {PictureBox{20, 20, 40, 30}, PictureBox{15, 22, 20, 27}, PictureBox{5, 25, 28, 90},
        PictureBox{30, 20, 40, 30}, PictureBox{900, 20, 1200, 30}})
    EXPECT_NEAR(iou(rectangle(a), rectangle(b)), iou(a, b), 1e-12);
  EXPECT_EQ(rectangle(a).x, 20);
  EXPECT_EQ(rectangle(a).y, 25);
  EXPECT_EQ(rectangle(a).length, 20);
  EXPECT_EQ(rectangle(a).width, 10);
  EXPECT_EQ(picture_box(rectangle(a)).right, 30);
  EXPECT_EQ(picture_box(rectangle(a)).bottom, 30);
}

TEST(PictureBox, JoinedHoldsBoth) {
  const PictureBox both = joined({10, 20, 30, 40}, {25, 5, 50, 30});
  EXPECT_EQ(both.left, 10);
  EXPECT_EQ(both.top, 5);
  EXPECT_EQ(both.right, 50);
  EXPECT_EQ(both.bottom, 40);
}

TEST(PictureBox, EndsAtThePicturesBorder) {
  const PictureBox cut = within({-26, 192, 379, 375.5}, 1242, 375);
  EXPECT_EQ(cut.left, 0);
  EXPECT_EQ(cut.top, 192);
  EXPECT_EQ(cut.right, 379);
  EXPECT_EQ(cut.bottom, 374);
  EXPECT_EQ(area(within({-30, 10, -5, 20}, 100, 50)), 0);
  EXPECT_EQ(area(within({110, 60, 140, 80}, 100, 50)), 0);
}

}  // namespace
}  // namespace mirage
