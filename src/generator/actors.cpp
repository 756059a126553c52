// Which vehicles there are: body styles of the car family by share, vans and trucks.
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "generator/car_assembly.h"
#include "generator/car_family.h"
#include "generator/looks/american_parts.h"
#include "generator/parts.h"
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

// Everything that is not a vehicle: people, plants, street furniture and car-sized clutter.

Vec3f random_cloth(RandomStream& random) {
  const float tone = static_cast<float>(random.uniform(0.015, 0.5));
  const float blue = static_cast<float>(random.uniform(0.5, 1.3)),
              green = static_cast<float>(random.uniform(0.5, 1.1)),
              red = static_cast<float>(random.uniform(0.5, 1.2));
  return (tone * Vec3f(red, green, blue)).cwiseMin(0.8f);
}

Material green(RandomStream& random) {
  Material m;
  m.pattern = Pattern::foliage;
  const auto u = [&](double a, double b) { return static_cast<float>(random.uniform(a, b)); };
  const float blue = u(0.01, 0.025), green = u(0.045, 0.10), red = u(0.025, 0.06);
  m.albedo = Vec3f(red, green, blue);
  const bool dry = random.uniform() < 0.15;
  const float blue2 = dry ? 0.02f : u(0.015, 0.035), green2 = dry ? u(0.09, 0.13) : u(0.08, 0.14);
  m.second = Vec3f(dry ? u(0.15, 0.25) : u(0.05, 0.11), green2, blue2);
  m.variant = random.next_u32();
  m.lidar = 0.35f;
  return m;
}

namespace {

// An ellipsoid between two points.
void add_limb(Mesh& mesh, const Vec3d& a, const Vec3d& b, double radius) {
  const Vec3d axis = b - a;
  Transform t = Transform::Identity();
  t.linear() = Eigen::Quaterniond::FromTwoVectors(Vec3d::UnitZ(), axis.normalized()).toRotationMatrix();
  t.translation() = 0.5 * (a + b);
  append(mesh, ellipsoid({radius, radius, 0.55 * axis.norm()}), t);
}

void add_person(Actor& actor, double h, double lean, double hip, RandomStream& random) {
  Mesh legs, torso, skin, hair;
  const double stride = random.uniform(-0.28, 0.28);
  for (int side : {1, -1}) {
    const Vec3d knee(side * stride * 0.6 + 0.06, side * 0.09, 0.28 * h),
        foot(side * stride, side * 0.09, 0.03);
    add_limb(legs, {0, side * 0.08, hip}, knee + Vec3d(0, 0, hip - 0.52 * h), 0.085);
    add_limb(legs, knee + Vec3d(0, 0, hip - 0.52 * h), foot, 0.06);
    const Vec3d shoulder(lean, side * 0.20, hip + 0.29 * h),
        hand(lean - side * stride * 0.7 + 1.2 * lean, side * 0.25, hip + 0.02 * h);
    add_limb(torso, shoulder, hand, 0.05);
  }
  add_limb(torso, {0, 0, hip - 0.02}, {lean, 0, hip + 0.33 * h}, 0.19);
  append(skin, ellipsoid({0.10, 0.085, 0.125}), at(lean * 1.15, 0, hip + 0.41 * h));
  append(hair, ellipsoid({0.105, 0.09, 0.09}), at(lean * 1.15 - 0.02, 0, hip + 0.44 * h));
  const float dark = static_cast<float>(random.uniform(0.2, 1.0));
  actor.surfaces.push_back(surface(
      legs, plain(random.uniform() < 0.5 ? Vec3f(0.02f, 0.03f, 0.07f) : random_cloth(random), 0.3f), true));
  actor.surfaces.push_back(surface(torso, plain(random_cloth(random), 0.35f), true));
  actor.surfaces.push_back(surface(skin, plain(dark * Vec3f(0.45f, 0.28f, 0.2f), 0.4f), true));
  actor.surfaces.push_back(surface(hair, plain(Vec3f(0.05f, 0.035f, 0.02f), 0.2f), true));
}

}  // namespace

Actor make_pedestrian(RandomStream& random) {
  Actor actor;
  actor.type = "Pedestrian";
  const double h = random.uniform(1.55, 1.9);
  add_person(actor, h, random.uniform(-0.02, 0.06), 0.52 * h, random);
  fit_label_box(actor);
  return actor;
}

Actor make_cyclist(RandomStream& random) {
  Actor actor;
  actor.type = "Cyclist";
  const double lean = random.uniform(0.15, 0.3), height = random.uniform(1.6, 1.85);
  add_person(actor, height, lean, 0.95, random);
  Mesh bicycle;
  const double r = 0.34;
  const auto bar = [&](const Vec3d& a, const Vec3d& b, double radius) { add_limb(bicycle, a, b, radius); };
  for (double x : {-0.55, 0.55})
    for (int i = 0; i < 18; ++i) {
      const double a = 2 * std::numbers::pi * i / 18, b = 2 * std::numbers::pi * (i + 1) / 18;
      bar({x + r * std::cos(a), 0, r + r * std::sin(a)}, {x + r * std::cos(b), 0, r + r * std::sin(b)},
          0.022);
    }
  bar({-0.55, 0, r}, {-0.1, 0, 0.3}, 0.02), bar({-0.1, 0, 0.3}, {0.42, 0, 0.85}, 0.025),
      bar({-0.15, 0, 0.9}, {0.42, 0, 0.85}, 0.02);
  bar({-0.15, 0, 0.92}, {-0.1, 0, 0.3}, 0.02), bar({0.42, 0, 1.0}, {0.55, 0, r}, 0.02),
      bar({0.4, -0.25, 1.02}, {0.4, 0.25, 1.02}, 0.018);
  actor.surfaces.push_back(surface(bicycle, plain(Vec3f::Constant(0.05f), 0.2f)));
  fit_label_box(actor);
  return actor;
}

Actor make_clutter(RandomStream& random) {
  Actor actor;
  const auto u = [&](double a, double b) { return random.uniform(a, b); };
  const auto tone = [&](double a, double b) {
    return Vec3f::Constant(static_cast<float>(random.uniform(a, b)));
  };
  Mesh a, b;
  switch (random.below(9)) {
    case 0: {  // wheeled bins, a few in a row
      const int count = 1 + random.below(4);
      for (int i = 0; i < count; ++i) {
        add_box(a, {-0.3, 0.7 * i - 0.28, 0.08}, {0.3, 0.7 * i + 0.28, 1.0});
        add_box(b, {-0.34, 0.7 * i - 0.31, 1.0}, {0.34, 0.7 * i + 0.31, 1.07});
      }
      const Vec3f color = random.uniform() < 0.5 ? tone(0.02, 0.1) : Vec3f(0.02f, 0.09f, 0.04f);
      actor.surfaces = {surface(a, plain(color, 0.2f)),
                        surface(b, plain(random.uniform() < 0.4 ? Vec3f(0.5f, 0.35f, 0.02f) : color, 0.3f))};
      break;
    }
    case 1: {  // container or skip, of a car's size or larger
      const double l = u(2.2, 6), w = u(1.6, 2.5), h = u(1.2, 2.6);
      add_box(a, {-0.5 * l, -0.5 * w, 0.1}, {0.5 * l, 0.5 * w, h});
      actor.surfaces = {
          surface(a, plain(random.uniform() < 0.5 ? tone(0.3, 0.75) : random_cloth(random), 0.4f))};
      break;
    }
    case 2: {  // kiosk or bus shelter
      const double l = u(2, 4.5), w = u(1.4, 2.2), h = u(2.2, 2.8);
      add_box(a, {-0.5 * l, -0.5 * w, h - 0.15}, {0.5 * l, 0.5 * w, h});
      for (double x : {-0.48 * l, 0.48 * l})
        for (double y : {-0.45 * w, 0.45 * w}) add_box(a, {x - 0.04, y - 0.04, 0}, {x + 0.04, y + 0.04, h});
      add_quad(b, {-0.48 * l, -0.45 * w, 0.2}, {0.48 * l, -0.45 * w, 0.2}, {0.48 * l, -0.45 * w, h - 0.2},
               {-0.48 * l, -0.45 * w, h - 0.2});
      Material pane = plain(tone(0.05, 0.4), 0.3f, 0.05f);
      if (random.uniform() < 0.5) pane.transparency = 0.7f;
      actor.surfaces = {surface(a, plain(tone(0.05, 0.4), 0.3f)), surface(b, pane)};
      break;
    }
    case 3:
    case 4: {  // clipped hedge or shrub block
      const double l = u(2, 7), w = u(0.6, 1.8), h = u(0.7, 1.9);
      add_box(a, {-0.46 * l, -0.42 * w, 0}, {0.46 * l, 0.42 * w, 0.93 * h});
      for (int i = 0; i < static_cast<int>(l * 200); ++i) {
        double z = u(0.02, 1) * h, y = (random.uniform() < 0.5 ? 0.5 : -0.5) * w;
        y *= u(0.8, 1.05);
        const double x = u(-0.5, 0.5) * l;
        if (random.uniform() < 0.3) z = h * u(0.92, 1.04), y = u(-0.5, 0.5) * w;
        add_leaves(b, {x, y, z}, {0.05, 0.05, 0.05}, 1, 0.08, random);
      }
      const Material m = green(random);
      Material core = m;
      core.albedo *= 0.4f, core.second *= 0.4f;
      actor.surfaces = {surface(a, core), surface(b, m)};
      break;
    }
    case 5: {  // bush
      const double r_z = u(0.5, 1.2), r_y = u(0.5, 1.6), r_x = u(0.5, 1.6);
      const Vec3d r(r_x, r_y, r_z);
      add_leaves(b, {0, 0, 0.8 * r.z()}, r, static_cast<int>(900 * r.x() * r.y() + 400), 0.09, random);
      actor.surfaces = {surface(b, green(random))};
      break;
    }
    case 6: {  // switch cabinet, advertising pillar
      if (random.uniform() < 0.5) {
        add_box(a, {-0.25, -0.6, 0}, {0.25, u(0.3, 0.9), u(1.0, 1.6)});
        actor.surfaces = {surface(a, plain(tone(0.25, 0.5), 0.4f))};
      } else {
        const double tall = u(2.4, 3.2), radius = u(0.5, 0.7);
        append(a, cylinder(radius, tall, 20), Transform::Identity());
        Material m = plain(tone(0.3, 0.6), 0.4f);
        m.second = random_cloth(random), m.variant = random.next_u32();
        actor.surfaces = {surface(a, m)};
      }
      break;
    }
    case 7: {  // stack of boards or stones, low wall
      const double l = u(1.5, 5), w = u(0.3, 1.4), h = u(0.4, 1.4);
      add_box(a, {-0.5 * l, -0.5 * w, 0}, {0.5 * l, 0.5 * w, h});
      Material m = plain(Vec3f(0.25f, 0.2f, 0.15f), 0.35f);
      if (random.uniform() < 0.6)
        m.pattern = Pattern::brick, m.albedo = Vec3f(0.3f, 0.11f, 0.07f), m.second = Vec3f::Constant(0.35f);
      m.variant = random.next_u32();
      actor.surfaces = {surface(a, m)};
      break;
    }
    default: {  // trailer: a box on wheels without cab, windows or lamps
      const double l = u(2, 4), w = u(1.3, 1.8), h = u(0.9, 2.0);
      add_box(a, {-0.5 * l, -0.5 * w, 0.5}, {0.5 * l, 0.5 * w, h});
      add_box(b, {0.5 * l, -0.04, 0.45}, {0.5 * l + 1.2, 0.04, 0.53});
      for (int side : {1, -1})
        append(b, cylinder(0.3, 0.16, 14),
               Transform(Eigen::Translation3d(0, side * 0.55 * w, 0.3) *
                         Eigen::AngleAxisd(side * 0.5 * std::numbers::pi, Vec3d::UnitX())));
      actor.surfaces = {
          surface(a, plain(random.uniform() < 0.5 ? tone(0.1, 0.6) : random_cloth(random), 0.4f)),
          surface(b, plain(tone(0.02, 0.05), 0.1f))};
    }
  }
  fit_label_box(actor);
  return actor;
}

Actor make_tree(RandomStream& random, double detail) {
  Actor tree;
  const double h = random.uniform(5, 13), trunk = random.uniform(1.6, 3.2), r = random.uniform(0.1, 0.28);
  Mesh wood, leaves, cores;
  append(wood, cylinder(r, trunk + 0.4 * (h - trunk), 10, 0.5 * r), Transform::Identity());
  const int clusters = 5 + random.below(5);
  const double reach = random.uniform(0.25, 0.38) * h;
  const int count = static_cast<int>(2.5 * detail * random.uniform(160, 260));
  for (int i = 0; i < clusters; ++i) {
    const double a = random.uniform(0, 2 * std::numbers::pi), d = reach * random.uniform(0, 0.75);
    const Vec3d c(d * std::cos(a), d * std::sin(a), random.uniform(trunk + 0.18 * (h - trunk), 0.88 * h));
    append(wood, cylinder(0.35 * r, (c - Vec3d(0, 0, trunk * 0.9)).norm(), 5, 0.02),
           Transform(Eigen::Translation3d(0, 0, trunk * 0.9) *
                     Eigen::Quaterniond::FromTwoVectors(Vec3d::UnitZ(), c - Vec3d(0, 0, trunk * 0.9))));
    const Vec3d radii(0.55 * reach, 0.55 * reach, 0.2 * (h - trunk) + 0.3);
    add_leaves(leaves, c, radii, count, 0.18 / std::sqrt(std::max(0.3, detail)), random);
    append(cores, ellipsoid(0.55 * radii), at(c.x(), c.y(), c.z()));
  }
  Material bark = plain(Vec3f(0.09f, 0.075f, 0.06f) * static_cast<float>(random.uniform(0.6, 1.6)), 0.3f);
  bark.pattern = Pattern::bark, bark.variant = random.next_u32();
  const Material leaf = green(random);
  // The shade inside the crown: little of the sky shows through a broad-leaved tree.
  Material shade = leaf;
  shade.albedo *= 0.35f, shade.second *= 0.35f;
  tree.surfaces = {surface(wood, bark), surface(leaves, leaf), surface(cores, shade)};
  return tree;
}

}  // namespace mirage::generator
