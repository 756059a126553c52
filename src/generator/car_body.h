// Car bodies lofted from cross-sections along the length.
#pragma once

#include <array>
#include <string_view>
#include <vector>

#include "base/random.h"
#include "generator/parts.h"
#include "geometry/mesh.h"
#include "scene/shape/shape_model.h"

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

  /// m forward of the middle.
  double x_at(double u) const { return length * (0.5 - u); }
};

/// A closed hull sorted by material, before lights and wheels are added.
struct Hull {
  Mesh paint, glass, trim;  ///< trim: dark plastic, pillars, underbody
  Mesh all;                 ///< the same faces in one closed mesh
};

/// The closed hull of a body (m).
Hull loft(const BodyShape& shape);

/// Height of the highest vertex within 6 cm along and 14 cm across of a place; 0 without one.
double top_at(const Mesh& hull, double x, double y);

/// A patch that lies `lift` metres over the hull: a grid over the rectangle [low, high] in (y, z) seen from
/// the front (axis 0, side +1) or rear (axis 0, side −1), or in (x, z) seen from the left or right (axis 1).
/// Cells that miss the hull are left out.
Mesh patch(const Mesh& hull, int axis, int side, const Vec2d& low, const Vec2d& high, double lift,
           int columns = 4, int rows = 3);

// Puts a car together: the lofted body with wheels, lamps, plates, glass, seats and mirrors.

/// The parts of a car beyond the shape of its body.
struct CarTrim {
  bool rails = false, bright_rails = false;  ///< on the roof
  bool bed = false;                          ///< a pick-up's, behind the rear window
  bool split_lamps = false;                  ///< rear lamps with a clear band across
  bool american = false;                     ///< short, high plates without a band; no amber at the rear
};

/// The whole is stretched to a label box of the shape's length, width and height.
Actor assemble(const BodyShape& shape, const std::string& type, const CarTrim& trim, RandomStream& random);

/// Puts something on the roof of one car in ten: a box, a ladder, skis, a taxi sign, rolled carpets, timber.
/// Its surfaces come last and each stands out of the label box, which stays the car's own. `car`: assembled
/// from `shape`.
void add_roof_load(Actor& car, const BodyShape& shape, RandomStream& random);

Material paint_of(RandomStream& random);                                     ///< of a body
inline const Material kTyre = plain(Vec3f::Constant(0.02f), 0.08f);          ///< rubber
inline const Material kTrim = plain(Vec3f::Constant(0.018f), 0.12f, 0.01f);  ///< dark plastic of bumpers

}  // namespace mirage::generator

// The car family that the shape manifold is learnt from: seven body styles, each with ranges of its
// proportions, lofted to closed meshes with wheels.

namespace mirage {

/// Bodies of passenger cars.
enum class BodyStyle { hatchback, saloon, estate, suv, van, pickup, coupe };
/// All of them.
inline constexpr std::array<BodyStyle, 7> kBodyStyles = {
    BodyStyle::hatchback, BodyStyle::saloon, BodyStyle::estate, BodyStyle::suv,
    BodyStyle::van,       BodyStyle::pickup, BodyStyle::coupe};
/// "hatchback", …
std::string_view name_of(BodyStyle style);

/// Draws a body of the style: every measure uniform in the style's range (car_body.cpp has the table, with
/// wheelbase and overhangs as shares of the length). A pick-up's bed is covered: lofts have no hollows.
generator::BodyShape draw_body(BodyStyle style, RandomStream& random);

/// The body with its four wheels, in the vehicle's frame (x forward, y left, z up, origin on the ground under
/// the middle of its bounding box, m). Five closed, outward-wound parts that overlap: inside where the
/// winding number is above 1/2.
Mesh car_mesh(const generator::BodyShape& body);

/// `each` vehicles of every style, to learn a shape model from (scene/shape/shape_model.h).
std::vector<ShapeSample> family_samples(int each, std::uint64_t seed);

}  // namespace mirage
