// Which vehicles there are: body styles of the car family by share, vans and trucks.
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "generator/car_assembly.h"
#include "generator/car_family.h"
#include "generator/looks/american_parts.h"
#include "geometry/shapes.h"

namespace mirage::generator {
namespace {

struct StyleShare {
  BodyStyle style;
  double share;
};

// Cars in German streets, by registrations of about 2010; the style "van" stands for compact people carriers.
constexpr std::array<StyleShare, 7> kEuropeanMix = {{{BodyStyle::hatchback, 0.44},
                                                     {BodyStyle::estate, 0.17},
                                                     {BodyStyle::saloon, 0.13},
                                                     {BodyStyle::van, 0.10},
                                                     {BodyStyle::suv, 0.09},
                                                     {BodyStyle::coupe, 0.05},
                                                     {BodyStyle::pickup, 0.02}}};

// What draw_body leaves to the look of a car.
void set_glass(BodyShape& s) {
  s.side_glass_end_u = std::min(0.935, std::lerp(s.roof_rear_u, s.window_foot_u, 0.5));
}

// Cars and light trucks in the United States; "van" stands for minivans.
constexpr std::array<StyleShare, 7> kAmericanMix = {{{BodyStyle::suv, 0.36},
                                                     {BodyStyle::saloon, 0.27},
                                                     {BodyStyle::pickup, 0.16},
                                                     {BodyStyle::hatchback, 0.08},
                                                     {BodyStyle::van, 0.06},
                                                     {BodyStyle::coupe, 0.04},
                                                     {BodyStyle::estate, 0.03}}};

BodyStyle draw_style(const std::array<StyleShare, 7>& mix, RandomStream& random) {
  double pick = random.uniform();
  BodyStyle style = mix.front().style;
  for (const StyleShare& s : mix) {
    style = s.style;
    if ((pick -= s.share) < 0) break;
  }
  return style;
}

}  // namespace

Actor make_car(RandomStream& random) {
  const BodyStyle style = draw_style(kEuropeanMix, random);
  BodyShape s = draw_body(style, random);
  CarTrim trim;
  trim.split_lamps = random.uniform() < 0.4, trim.bright_rails = random.uniform() < 0.5;
  const double rails = random.uniform();
  if (style == BodyStyle::van) {
    s.length = random.uniform(4.0, 4.7), s.width = random.uniform(1.69, 1.86),
    s.height = random.uniform(1.58, 1.76);
    s.wheel_radius = std::min(s.wheel_radius, 0.33);
  }
  if (style == BodyStyle::estate || style == BodyStyle::suv) trim.rails = rails < 0.6;
  if (style == BodyStyle::pickup) trim.bed = true;
  set_glass(s);
  // The family's ranges are makers' figures of the cars on sale today. KITTI's streets are of 2011, and its
  // boxes are drawn around the points: mean 3.88 x 1.63 x 1.53 m.
  s.length *= 0.925, s.width *= 0.945;
  Actor car = assemble(s, "Car", {s.length, s.width, s.height}, trim, random);
  car.kind = name_of(style);
  add_roof_load(car, s, random);
  return car;
}

Actor american::make_car(RandomStream& random) {
  const BodyStyle style = draw_style(kAmericanMix, random);
  BodyShape s = draw_body(style, random);
  CarTrim trim;
  trim.american = true;
  trim.split_lamps = random.uniform() < 0.3, trim.bright_rails = random.uniform() < 0.4;
  const double rails = random.uniform(), large = random.uniform(0.25, 1.0);
  // Of each style the larger ones.
  if (style == BodyStyle::van)
    s.length = std::lerp(4.8, 5.25, large), s.width = 1.98, s.height = std::lerp(1.70, 1.82, large);
  if (style == BodyStyle::suv) s.length = std::lerp(4.3, 5.25, large), s.width = std::lerp(1.80, 2.03, large);
  if (style == BodyStyle::pickup)
    s.length = std::lerp(5.2, 5.95, large), s.width = std::lerp(1.87, 2.05, large);
  if (style == BodyStyle::saloon)
    s.length = std::lerp(4.5, 5.05, large), s.width = std::lerp(1.76, 1.90, large);
  if (style == BodyStyle::estate || style == BodyStyle::suv) trim.rails = rails < 0.7;
  if (style == BodyStyle::pickup) trim.bed = true;
  set_glass(s);
  s.length *= 0.97, s.width *= 0.97;  // boxes are drawn around the points
  Actor car = assemble(s, "Car", {s.length, s.width, s.height}, trim, random);
  car.kind = name_of(style);
  add_roof_load(car, s, random);
  return car;
}

Actor american::make_school_bus(RandomStream& random) {
  Actor bus;
  bus.type = "Misc";
  const double l = random.uniform(9.5, 11.5), w = 2.42, h = 3.05, hood = 1.3, floor = 0.75;
  Mesh body, roof, glass, stripes, dark, wheels, lamps;
  add_box(body, {-0.5 * l, -0.5 * w, floor - 0.25}, {0.5 * l - hood, 0.5 * w, h - 0.15});
  add_box(body, {0.5 * l - hood, -0.45 * w, floor - 0.2}, {0.5 * l, 0.45 * w, 1.55});
  add_box(roof, {-0.5 * l + 0.1, -0.42 * w, h - 0.15}, {0.5 * l - hood - 0.1, 0.42 * w, h});
  const double back = -0.5 * l - 0.01, face = 0.5 * l - hood + 0.01;
  for (int side : {1, -1}) {
    const double y = side * (0.5 * w + 0.01);
    for (double x = -0.5 * l + 0.4; x < 0.5 * l - hood - 0.8; x += 0.85)
      add_quad(glass, {x, y, 1.75}, {x + 0.68, y, 1.75}, {x + 0.68, y, 2.5}, {x, y, 2.5});
    for (double z : {1.0, 1.45, 2.6})
      add_quad(stripes, {-0.5 * l, y, z}, {0.5 * l - hood, y, z}, {0.5 * l - hood, y, z + 0.07},
               {-0.5 * l, y, z + 0.07});
    for (double x : {-0.5 * l + 2.6, 0.5 * l - 0.75})
      append(wheels, cylinder(0.48, 0.26, 18),
             Transform(Eigen::Translation3d(x, side * (0.5 * w - 0.24), 0.48) *
                       Eigen::AngleAxisd(-side * 0.5 * std::numbers::pi, Vec3d::UnitX())));
    for (double x : {back, face})  // warning lamps at the upper corners
      add_box(lamps, {x - 0.02, side * 0.36 * w - 0.12, 2.68}, {x + 0.02, side * 0.36 * w + 0.12, 2.86});
    add_box(lamps, {back - 0.02, side * 0.42 * w - 0.1, 1.05}, {back, side * 0.42 * w + 0.1, 1.3});
  }
  add_quad(glass, {face, -0.44 * w, 1.6}, {face, 0.44 * w, 1.6}, {face, 0.44 * w, 2.6},
           {face, -0.44 * w, 2.6});
  for (int side : {1, -1}) {
    const double y = side * 0.26 * w;
    add_quad(glass, {back, y - 0.42, 1.75}, {back, y + 0.42, 1.75}, {back, y + 0.42, 2.5},
             {back, y - 0.42, 2.5});
  }
  add_box(dark, {-0.5 * l, -0.46 * w, 0.42}, {0.5 * l - 0.05, 0.46 * w, floor - 0.2});
  add_box(dark, {0.5 * l - 0.02, -0.4 * w, 0.85}, {0.5 * l + 0.02, 0.4 * w, 1.4});
  const Material yellow = plain(Vec3f(0.62f, 0.30f, 0.01f), 0.5f, 0.03f);
  bus.surfaces = {surface(body, yellow),
                  surface(roof, yellow),
                  surface(glass, plain(Vec3f::Constant(0.02f), 0.1f, 0.08f)),
                  surface(stripes, dark_plastic()),
                  surface(dark, dark_plastic()),
                  surface(wheels, tyre_rubber()),
                  surface(lamps, plain(Vec3f(0.45f, 0.02f, 0.015f), 1.f, 0.05f))};
  fit_label_box(bus);
  return bus;
}

Actor make_van(RandomStream& random) {
  BodyShape s = draw_body(BodyStyle::van, random);
  const bool large = random.uniform() < 0.5;
  s.length = large ? random.uniform(4.8, 5.8) : random.uniform(4.2, 4.8), s.width = random.uniform(1.75, 2.0);
  s.height = large ? random.uniform(2.0, 2.5) : random.uniform(1.8, 2.0);
  s.tail_round = std::min(s.tail_round, 0.06), s.tumblehome = std::min(s.tumblehome, 0.11);
  s.side_glass_end_u = random.uniform() < 0.5 ? 0.42 : 0.92, s.rear_glass = random.uniform() < 0.7;
  return assemble(s, "Van", {s.length, s.width, s.height}, {}, random);
}

Actor make_truck(RandomStream& random) {
  Actor truck;
  truck.type = "Truck";
  const double l = random.uniform(6.5, 10), w = random.uniform(2.3, 2.55), h = random.uniform(3.0, 3.8);
  const double cab = 2.0;
  Mesh cargo, cabin, glass, dark, wheels;
  add_box(cargo, {-0.5 * l, -0.5 * w, 1.0}, {0.5 * l - cab - 0.15, 0.5 * w, h});
  add_box(cabin, {0.5 * l - cab, -0.48 * w, 0.55}, {0.5 * l, 0.48 * w, 0.82 * h});
  add_quad(glass, {0.5 * l + 0.01, -0.42 * w, 0.48 * h}, {0.5 * l + 0.01, 0.42 * w, 0.48 * h},
           {0.5 * l + 0.01, 0.42 * w, 0.74 * h}, {0.5 * l + 0.01, -0.42 * w, 0.74 * h});
  add_box(dark, {-0.5 * l, -0.4 * w, 0.6}, {0.5 * l - 0.1, 0.4 * w, 1.0});
  for (double x : {-0.3 * l, -0.3 * l + 1.1, 0.5 * l - 1.2})
    for (int side : {1, -1})
      append(wheels, cylinder(0.48, 0.28, 18),
             Transform(Eigen::Translation3d(x, side * 0.48 * w, 0.48) *
                       Eigen::AngleAxisd(side * 0.5 * std::numbers::pi, Vec3d::UnitX())));
  const Material white = plain(Vec3f::Constant(static_cast<float>(random.uniform(0.3, 0.75))), 0.5f, 0.01f);
  truck.surfaces = {surface(cargo, random.uniform() < 0.6 ? white : paint_of(random)),
                    surface(cabin, paint_of(random)),
                    surface(glass, plain(Vec3f::Constant(0.02f), 0.1f, 0.08f)), surface(dark, dark_plastic()),
                    surface(wheels, tyre_rubber())};
  fit_label_box(truck);
  return truck;
}

}  // namespace mirage::generator
