// Boxes in a picture: upright rectangles with IoU.
#pragma once

#include "geometry/box.h"

namespace mirage {

/// Pixels in KITTI's convention: the centre of the upper left pixel is (0, 0).
struct PictureBox {
  double left = 0, top = 0, right = 0, bottom = 0;
};

/// Pixels²; 0 for a box whose sides are in the wrong order.
double area(const PictureBox& box);
/// Pixels² that both boxes cover.
double intersection_area(const PictureBox& a, const PictureBox& b);
/// Intersection over union in [0, 1]; 0 if either box has no area.
double iou(const PictureBox& a, const PictureBox& b);
/// The box for code that compares rectangles of any plane: x and y are its centre's column and row, length
/// and width its extents along them (pixels), yaw is 0. iou() of two such is that of the boxes.
BevBox rectangle(const PictureBox& box);
/// The box of such a rectangle.
PictureBox picture_box(const BevBox& rectangle);
/// The smallest box that holds both.
PictureBox joined(const PictureBox& a, const PictureBox& b);
/// What of the box lies within a picture of width × height pixels; a box beyond it becomes one of no area.
PictureBox within(const PictureBox& box, int width, int height);

}  // namespace mirage
