// Oriented boxes: BEV rectangles with exact IoU, and upright 3-D boxes.
#pragma once

#include <array>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "base/types.h"

namespace mirage {

/// BEV box in `velo`: centre (x, y) m, length along the heading, width across, yaw counter-clockwise from +x.
struct BevBox {
  double x = 0, y = 0, length = 0, width = 0, yaw = 0;
};

/// Upright 3-D box: a BEV box with the z of its bottom and its height (metres, `velo`).
struct Box3 {
  BevBox bev;
  double bottom = 0, height = 0;
};

/// Whether both boxes have the same centre and heading, bit for bit. No two labels of a frame do.
inline bool in_one_place(const BevBox& a, const BevBox& b) {
  return a.x == b.x && a.y == b.y && a.yaw == b.yaw;
}

/// Corners counter-clockwise, first = front left.
std::array<Vec2d, 4> corners(const BevBox& box);
/// Distance from the origin to the box's centre, m.
inline double horizontal_distance(const BevBox& box) {
  return std::hypot(box.x, box.y);
}
/// Distance between the two centres, m.
inline double horizontal_distance(const BevBox& a, const BevBox& b) {
  return std::hypot(a.x - b.x, a.y - b.y);
}
/// Eight corners: the four bottom ones in `corners` order, then the four top ones.
std::array<Vec3d, 8> corners(const Box3& box);
/// Exact area of the intersection of two rectangles (Sutherland–Hodgman clipping of convex polygons); 0 if a
/// side of either is not positive.
double intersection_area(const BevBox& a, const BevBox& b);
/// Intersection over union in [0, 1]; 0 if a side of either box is not positive.
double iou(const BevBox& a, const BevBox& b);
/// Volume IoU in [0, 1]; 0 if a side or the height of either box is not positive.
double iou(const Box3& a, const Box3& b);
/// Whether the point lies inside the box grown by `margin` on every side.
bool contains(const Box3& box, const Vec3d& p_velo, double margin = 0);
/// The interval of t ≥ 0 in which the ray origin + t · direction is in the box from `low` to `high`; empty if
/// first > second. Kay and Kajiya's slabs (1986).
std::pair<double, double> ray_within(const Vec3d& origin, const Vec3d& direction, const Vec3d& low,
                                     const Vec3d& high);
/// velo_from_box: origin at the centre of the bottom face, x along the heading, z up.
Transform velo_from_box(const Box3& box);

/// Corners of the convex hull of points in a plane, counter-clockwise from the leftmost (Andrew, Information
/// Processing Letters 9, 1979). A point on a side is not a corner.
std::vector<Vec2d> convex_hull(std::vector<Vec2d> places);

// Boxes in a picture: upright rectangles with IoU.

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
/// The box for code that compares rectangles of any plane: x, y are its centre's column and row, length,
/// width its extents along them (pixels), yaw is 0. iou() gives the same value in both forms.
BevBox rectangle(const PictureBox& box);
/// The inverse of rectangle().
PictureBox picture_box(const BevBox& rectangle);
/// The smallest box that holds both.
PictureBox united(const PictureBox& a, const PictureBox& b);
/// The box clipped to a picture of width × height pixels; a box outside it gets no area.
PictureBox within(const PictureBox& box, int width, int height);

// BEV rectangles around LiDAR returns: a unit at the origin sees at most two sides of an object.

/// An interval along one axis of a rectangle.
struct SeenSide {
  double low = 0, high = 0;
  /// Its length.
  double size() const { return high - low; }
  /// Lengthened to at least `least`, away from the unit at 0: the near end is the one that it sees.
  SeenSide grown(double least) const { return size() >= least ? *this : sized(least); }
  /// Set to `length`; the end nearer to the unit stays.
  SeenSide sized(double length) const {
    return std::abs(low) <= std::abs(high) ? SeenSide{low, low + length} : SeenSide{high - length, high};
  }
};

/// A rectangle in axes that are turned by `yaw` around the unit.
struct SeenRectangle {
  double yaw = 0;  ///< rad, in [0, π/2)
  SeenSide along, across;
  /// The same rectangle as a BEV box; its length is along `yaw`.
  BevBox box() const;
};

/// The rectangle around points (m) whose sides lie closest to them, over headings 2° apart. The closeness
/// criterion of Zhang, Xu, Dolan, Litkouhi: "Efficient L-Shape Fitting for Vehicle Detection Using Laser
/// Scanners", IV 2017. Needs at least one point.
SeenRectangle closest_rectangle(const std::vector<Vec2d>& places);

/// The box of a car whose visible part is that rectangle: extended away from the unit to at least KITTI's
/// mean car. Nullopt if the size is not a car's.
std::optional<BevBox> car_seen_as(const SeenRectangle& seen);

}  // namespace mirage
