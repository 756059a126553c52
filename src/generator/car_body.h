// Car bodies lofted from cross-sections along the length.
#pragma once

#include "generator/parts.h"

namespace mirage::generator {

/// Side profile and plan of a body. `u` runs from the front (0) to the rear (1); heights are shares of h.
struct BodyShape {
  double length = 4, width = 1.7, height = 1.5;                   // m
  double nose = 0.47, bonnet = 0.52, cowl_u = 0.26, cowl = 0.65;  // bonnet: height just behind the nose
  double roof_front_u = 0.44, roof_peak_u = 0.56, roof_rear_u = 0.86, roof_rear = 0.95;
  double window_foot_u = 0.97, window_foot = 0.66;  // lower end of the rear window
  double tail = 0.62;                               // top of the rear panel
  double clearance = 0.12, belt_front = 0.60, belt_rear = 0.64;
  double front_axle_u = 0.19, rear_axle_u = 0.80, wheel_radius = 0.31;  // m
  double tumblehome = 0.17, nose_round = 0.30, tail_round = 0.16;
  double side_glass_end_u = 0.90;  // rear end of the side windows
  bool rear_glass = true;
};

/// A closed hull sorted by material, before lights and wheels are added.
struct Hull {
  Mesh paint, glass, trim;  ///< trim: dark plastic, pillars, underbody
  Mesh all;                 ///< the same faces in one closed mesh
};

/// The closed hull of such a body (m).
Hull loft(const BodyShape& shape);

/// Height of the highest vertex within 6 cm along and 14 cm across of a place; 0 without one.
double top_at(const Mesh& hull, double x, double y);

/// A patch that lies `lift` metres over the hull: a grid over the rectangle [low, high] in (y, z) seen from
/// the front (axis 0, side +1) or rear (axis 0, side −1), or in (x, z) seen from the left or right (axis 1).
/// Cells that miss the hull are left out.
Mesh patch(const Mesh& hull, int axis, int side, const Vec2d& low, const Vec2d& high, double lift,
           int columns = 4, int rows = 3);

}  // namespace mirage::generator
