// Cars, vans and trucks: a lofted body with wheels, lamps, plates, seats and mirrors.
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "geometry/shapes.h"
#include "scene/generator/car_body.h"

namespace mirage::generator {
namespace {

struct Paint {
  Vec3f color;
  float lidar;
  double share;
};

// What is parked in a central European street: mostly silver, grey, black and white, some blue, red, green.
const std::array<Paint, 14> kPaints = {{
    {{0.42f, 0.43f, 0.44f}, 0.42f, 0.16},     // silver
    {{0.28f, 0.29f, 0.30f}, 0.36f, 0.08},     // light grey
    {{0.10f, 0.105f, 0.115f}, 0.25f, 0.10},   // dark grey
    {{0.012f, 0.012f, 0.013f}, 0.10f, 0.21},  // black
    {{0.70f, 0.70f, 0.68f}, 0.60f, 0.11},     // white
    {{0.015f, 0.035f, 0.13f}, 0.22f, 0.09},   // dark blue
    {{0.05f, 0.12f, 0.34f}, 0.30f, 0.05},     // blue
    {{0.36f, 0.02f, 0.018f}, 0.40f, 0.06},    // red
    {{0.16f, 0.012f, 0.02f}, 0.25f, 0.03},    // dark red
    {{0.015f, 0.07f, 0.04f}, 0.22f, 0.03},    // green
    {{0.30f, 0.26f, 0.18f}, 0.40f, 0.03},     // beige
    {{0.10f, 0.06f, 0.03f}, 0.25f, 0.01},     // brown
    {{0.60f, 0.45f, 0.04f}, 0.50f, 0.01},     // yellow
    {{0.18f, 0.30f, 0.38f}, 0.38f, 0.03},     // light blue
}};

Material paint_of(RandomStream& random) {
  double sum = 0, pick = random.uniform();
  for (const Paint& p : kPaints) sum += p.share;
  pick *= sum;
  const Paint* chosen = &kPaints.back();
  for (const Paint& p : kPaints) {
    if ((pick -= p.share) < 0) {
      chosen = &p;
      break;
    }
  }
  Material m = plain(chosen->color * static_cast<float>(random.uniform(0.8, 1.15)),
                     0.24f * chosen->lidar * static_cast<float>(std::exp(random.uniform(-1.2, 1.2))), 0.045f);
  if (random.uniform() < 0.25) m.gloss = 0.02f;  // dusty
  return m;
}

Material window(RandomStream& random) {
  Material m = plain(Vec3f::Constant(0.01f), 0.25f, 0.05f);
  m.transparency = static_cast<float>(random.uniform(0.3, 0.65));
  return m;
}

const Material kTyre = plain(Vec3f::Constant(0.02f), 0.08f);
const Material kArch = plain(Vec3f::Constant(0.006f), 0.05f);
const Material kTrim = plain(Vec3f::Constant(0.018f), 0.12f, 0.01f);
const Material kPlate = plain(Vec3f(0.6f, 0.6f, 0.58f), 1.6f);

void add_wheel(Actor& car, const Hull& hull, double x, double radius, bool alloy) {
  for (int side : {1, -1}) {
    // The body's outermost point over the wheel.
    double y = 0;
    for (const Vec3d& v : hull.all.vertices)
      if (std::abs(v.x() - x) < radius && v.z() < 3.2 * radius) y = std::max(y, side * v.y());
    const Eigen::AngleAxisd turn(side > 0 ? -0.5 * std::numbers::pi : 0.5 * std::numbers::pi, Vec3d::UnitX());
    const auto place = [&](double outwards, double z) {
      return Transform(Eigen::Translation3d(x, side * (y + outwards), z) * turn);
    };
    // A dark opening that stands a little over the side, cut at the sill.
    Mesh arch;
    const double r = 1.15 * radius;
    for (int i = 0; i < 14; ++i) {
      const double a = std::numbers::pi * (-0.06 + 1.12 * i / 14),
                   b = std::numbers::pi * (-0.06 + 1.12 * (i + 1) / 14);
      const double yo = side * (y + 0.002);
      add_quad(arch, {x, yo, radius}, {x + r * std::cos(a), yo, radius + r * std::sin(a)},
               {x + r * std::cos(b), yo, radius + r * std::sin(b)}, {x, yo, radius});
    }
    // add_quad made one empty triangle a step: drop it.
    std::vector<Face> kept;
    for (std::size_t f = 0; f < arch.faces.size(); f += 2) kept.push_back(arch.faces[f]);
    arch.faces = kept;
    car.surfaces.push_back(surface(arch, kArch));
    Mesh tyre;
    append(tyre, cylinder(radius, 0.2, 22), place(0.006 - 0.2, radius));
    car.surfaces.push_back(surface(tyre, kTyre));
    Mesh rim;
    const double hub = radius * 0.66;
    if (alloy) {
      for (int s = 0; s < 5; ++s) {
        const double a = 2 * std::numbers::pi * s / 5 + 0.3, w = 0.26;
        const double yo = side * (y + 0.009);
        const auto on = [&](double angle, double rr) {
          return Vec3d(x + rr * std::cos(angle), yo, radius + rr * std::sin(angle));
        };
        add_quad(rim, on(a - 0.6, 0.2 * hub), on(a - w, hub), on(a + w, hub), on(a + 0.6, 0.2 * hub));
      }
      for (int s = 0; s < 20; ++s) {
        const double a = 2 * std::numbers::pi * s / 20, b = 2 * std::numbers::pi * (s + 1) / 20,
                     yo = side * (y + 0.009);
        const auto on = [&](double angle, double rr) {
          return Vec3d(x + rr * std::cos(angle), yo, radius + rr * std::sin(angle));
        };
        add_quad(rim, on(a, 0.9 * hub), on(a, 1.05 * hub), on(b, 1.05 * hub), on(b, 0.9 * hub));
      }
      append(rim, cylinder(0.22 * hub, 0.01, 10), place(0.0, radius));
    } else {
      append(rim, cylinder(hub, 0.012, 20), place(-0.003, radius));
    }
    Material metal = plain(Vec3f::Constant(alloy ? 0.42f : 0.22f), 0.45f, 0.1f);
    car.surfaces.push_back(surface(rim, metal));
  }
}

void add_patch(Actor& car, const Hull& hull, int axis, int side, Vec2d low, Vec2d high, double lift,
               const Material& material, int columns = 4, int rows = 3) {
  Mesh mesh = patch(hull.all, axis, side, low, high, lift, columns, rows);
  if (!mesh.faces.empty()) car.surfaces.push_back(surface(std::move(mesh), material));
}

void add_front(Actor& car, const Hull& hull, const BodyShape& s, RandomStream& random) {
  const double w = 0.5 * s.width, h = s.height;
  const double inner = w * random.uniform(0.42, 0.58), low = h * (s.nose - random.uniform(0.13, 0.17));
  const double high = h * (s.nose - 0.015), outer = w * 0.90;
  Material lamp =
      plain(Vec3f(0.30f, 0.31f, 0.33f) * static_cast<float>(random.uniform(0.6, 1.3)), 0.4f, 0.12f);
  if (random.uniform() < 0.12) lamp.emission = Vec3f::Constant(2.5f);
  for (int side : {1, -1}) {
    const double a = side > 0 ? inner : -outer, b = side > 0 ? outer : -inner;
    add_patch(car, hull, 0, 1, {a, low}, {b, high}, 0.008, lamp);
  }
  Material grille = plain(Vec3f::Constant(0.02f), 0.1f, 0.02f);
  grille.pattern = Pattern::grille;
  const double g = inner * random.uniform(0.5, 0.95);
  add_patch(car, hull, 0, 1, {-g, low + 0.02}, {g, high - 0.01}, 0.006, grille);
  const double intake = w * random.uniform(0.45, 0.75), z = h * (s.clearance + 0.07);
  add_patch(car, hull, 0, 1, {-intake, z}, {intake, z + h * random.uniform(0.05, 0.11)}, 0.006, grille);
  const double plate = h * (s.nose - random.uniform(0.19, 0.22));
  add_patch(car, hull, 0, 1, {-0.26, plate - 0.055}, {0.26, plate + 0.055}, 0.012, kPlate, 2, 1);
}

void add_rear(Actor& car, const Hull& hull, const BodyShape& s, RandomStream& random) {
  const double w = 0.5 * s.width, h = s.height;
  Material lamp = plain(Vec3f(0.42f, 0.012f, 0.012f), 1.2f, 0.06f);
  if (random.uniform() < 0.15) lamp.emission = Vec3f(1.6f, 0.06f, 0.04f);
  const bool upright = random.uniform() < 0.45;
  const double top = h * (s.tail - 0.03), low = top - h * (upright ? 0.22 : random.uniform(0.09, 0.13));
  const double inner = w * (upright ? 0.74 : random.uniform(0.5, 0.62));
  for (int side : {1, -1}) {
    const double a = side > 0 ? inner : -0.92 * w, b = side > 0 ? 0.92 * w : -inner;
    add_patch(car, hull, 0, -1, {a, low}, {b, top}, 0.008, lamp);
  }
  const bool high_plate = random.uniform() < 0.6;
  const double plate = high_plate ? h * (s.tail - random.uniform(0.13, 0.17)) : h * (s.clearance + 0.17);
  add_patch(car, hull, 0, -1, {-0.26, plate - 0.06}, {0.26, plate + 0.06}, 0.012, kPlate, 2, 1);
  add_patch(car, hull, 0, -1, {-0.34, plate + 0.07}, {0.34, plate + 0.10}, 0.01, kTrim, 2, 1);
  const double z = h * (s.clearance + 0.065);
  add_patch(car, hull, 0, -1, {-0.78 * w, z}, {0.78 * w, z + 0.06 * h}, 0.006, kTrim);
}

void add_sides(Actor& car, const Hull& hull, const BodyShape& s, RandomStream& random) {
  const double h = s.height, l = s.length;
  const auto x_of = [&](double u) { return l * (0.5 - u); };
  const double b_post = std::lerp(s.roof_front_u, s.roof_rear_u, 0.34);
  const bool strip = random.uniform() < 0.4;
  for (int side : {1, -1}) {
    for (double u : {b_post + 0.07, std::min(b_post + 0.27, s.rear_axle_u + 0.01)})
      add_patch(car, hull, 1, side, {x_of(u) - 0.09, h * s.belt_front - 0.11},
                {x_of(u) + 0.09, h * s.belt_front - 0.075}, 0.02,
                random.uniform() < 0.5 ? kTrim : plain(Vec3f::Constant(0.3f), 0.3f, 0.05f), 1, 1);
    // Shut lines of the doors.
    for (double u : {s.cowl_u + 0.05, b_post, std::min(b_post + 0.21, s.rear_axle_u - 0.03)})
      add_patch(car, hull, 1, side, {x_of(u) - 0.005, h * (s.clearance + 0.06)},
                {x_of(u) + 0.005, h * s.belt_front - 0.02}, 0.003, kArch, 1, 5);
    if (strip)
      add_patch(car, hull, 1, side, {x_of(s.rear_axle_u - 0.09), h * 0.33},
                {x_of(s.front_axle_u + 0.09), h * 0.36}, 0.012, kTrim, 8, 1);
  }
}

void add_seats(Actor& car, const BodyShape& s) {
  Mesh seats;
  const double w = 0.5 * s.width, h = s.height;
  const auto x_of = [&](double u) { return s.length * (0.5 - u); };
  const double front = x_of(std::lerp(s.roof_front_u, s.roof_rear_u, 0.30)),
               rear = x_of(std::lerp(s.roof_front_u, s.roof_rear_u, 0.80));
  for (int side : {1, -1}) {
    const double y = side * 0.42 * w;
    add_box(seats, {front - 0.12, y - 0.24, 0.3 * h}, {front + 0.08, y + 0.24, 0.70 * h});
    add_box(seats, {front - 0.10, y - 0.13, 0.70 * h}, {front, y + 0.13, 0.84 * h});
    add_box(seats, {rear - 0.05, y - 0.13, 0.66 * h}, {rear + 0.05, y + 0.13, 0.78 * h});
  }
  add_box(seats, {rear - 0.10, -0.75 * w, 0.3 * h}, {rear + 0.10, 0.75 * w, 0.67 * h});
  add_box(seats, {rear, -0.8 * w, 0.22 * h}, {x_of(s.cowl_u + 0.02), 0.8 * w, 0.34 * h});
  add_box(seats, {x_of(s.cowl_u + 0.12), -0.75 * w, 0.34 * h},
          {x_of(s.cowl_u + 0.03), 0.75 * w, 0.63 * h});  // dashboard
  car.surfaces.push_back(surface(seats, plain(Vec3f::Constant(0.03f), 0.15f)));
}

Actor assemble(const BodyShape& s, const std::string& type, const Vec3d& size, RandomStream& random) {
  Actor car;
  car.type = type;
  const Hull hull = loft(s);
  const Material paint = paint_of(random);
  car.surfaces.push_back(surface(hull.paint, paint, true));
  car.surfaces.push_back(surface(hull.glass, window(random), true));
  car.surfaces.push_back(surface(hull.trim, kTrim, true));
  const auto x_of = [&](double u) { return s.length * (0.5 - u); };
  const bool alloy = random.uniform() < 0.6;
  add_wheel(car, hull, x_of(s.front_axle_u), s.wheel_radius, alloy);
  add_wheel(car, hull, x_of(s.rear_axle_u), s.wheel_radius, alloy);
  add_front(car, hull, s, random);
  add_rear(car, hull, s, random);
  add_sides(car, hull, s, random);
  add_seats(car, s);
  fit_label_box(car);
  Mesh mirrors;
  for (int side : {1, -1}) {
    const double x = x_of(s.cowl_u + 0.06), y = side * 0.50 * s.width;
    const double z = s.height * (s.belt_front + 0.05);
    append(mirrors, ellipsoid({0.07, 0.10, 0.075}), at(x, y + side * 0.06, z));
  }
  car.surfaces.push_back(surface(mirrors, random.uniform() < 0.5 ? kTrim : paint));
  stretch(car, size);
  return car;
}

}  // namespace

Actor make_car(RandomStream& random) {
  BodyShape s;
  Vec3d size;  // KITTI's labels: mean 3.88 × 1.63 × 1.53 m
  const double style = random.uniform();
  const auto vary = [&](double mean, double sigma) {
    return mean + sigma * std::clamp(random.normal(), -2.0, 2.0);
  };
  if (style < 0.22) {  // small car
    size = {vary(3.55, 0.14), vary(1.58, 0.04), vary(1.48, 0.05)};
    s.cowl_u = vary(0.215, 0.015), s.roof_front_u = vary(0.40, 0.015), s.roof_rear_u = vary(0.89, 0.015);
    s.window_foot_u = 0.978, s.window_foot = 0.63, s.tail = 0.60, s.front_axle_u = 0.175,
    s.rear_axle_u = 0.845;
    s.side_glass_end_u = 0.90, s.wheel_radius = 0.285;
  } else if (style < 0.55) {  // compact hatchback
    size = {vary(4.0, 0.16), vary(1.66, 0.05), vary(1.48, 0.05)};
    s.cowl_u = vary(0.25, 0.012), s.roof_front_u = vary(0.42, 0.015), s.roof_rear_u = vary(0.865, 0.02);
    s.window_foot_u = 0.968, s.window_foot = 0.645, s.tail = 0.62, s.front_axle_u = 0.19,
    s.rear_axle_u = 0.82;
    s.side_glass_end_u = 0.895;
  } else if (style < 0.72) {  // saloon
    size = {vary(4.45, 0.22), vary(1.71, 0.05), vary(1.44, 0.04)};
    s.cowl_u = vary(0.265, 0.012), s.roof_front_u = vary(0.415, 0.012), s.roof_peak_u = 0.53,
    s.roof_rear_u = vary(0.70, 0.02);
    s.roof_rear = 0.955, s.window_foot_u = vary(0.84, 0.015), s.window_foot = 0.685, s.tail = 0.655,
    s.tail_round = 0.20;
    s.front_axle_u = 0.185, s.rear_axle_u = 0.785, s.side_glass_end_u = 0.80, s.belt_rear = 0.655,
    s.wheel_radius = 0.32;
  } else if (style < 0.86) {  // estate
    size = {vary(4.45, 0.18), vary(1.70, 0.05), vary(1.49, 0.05)};
    s.cowl_u = vary(0.255, 0.012), s.roof_front_u = vary(0.41, 0.012), s.roof_rear_u = vary(0.915, 0.015),
    s.roof_rear = 0.94;
    s.window_foot_u = 0.978, s.window_foot = 0.65, s.tail = 0.62, s.front_axle_u = 0.18,
    s.rear_axle_u = 0.785;
    s.side_glass_end_u = 0.935, s.wheel_radius = 0.32;
  } else if (style < 0.94) {  // compact people carrier
    size = {vary(4.15, 0.2), vary(1.70, 0.05), vary(1.64, 0.05)};
    s.nose = 0.45, s.bonnet = 0.51, s.cowl_u = vary(0.205, 0.012), s.cowl = 0.62,
    s.roof_front_u = vary(0.385, 0.012);
    s.roof_rear_u = vary(0.90, 0.015), s.window_foot_u = 0.972, s.window_foot = 0.58, s.tail = 0.56;
    s.belt_front = 0.565, s.belt_rear = 0.60, s.side_glass_end_u = 0.915, s.rear_axle_u = 0.815;
  } else {  // off-road style
    size = {vary(4.4, 0.2), vary(1.80, 0.05), vary(1.72, 0.06)};
    s.nose = 0.54, s.bonnet = 0.575, s.cowl_u = vary(0.25, 0.012), s.cowl = 0.66,
    s.roof_front_u = vary(0.39, 0.012);
    s.roof_rear_u = vary(0.925, 0.015), s.window_foot_u = 0.975, s.window_foot = 0.64, s.tail = 0.62,
    s.clearance = 0.16;
    s.belt_front = 0.625, s.belt_rear = 0.65, s.side_glass_end_u = 0.93, s.wheel_radius = 0.37,
    s.tumblehome = 0.13;
  }
  s.nose_round = vary(0.28, 0.05), s.tail_round = std::max(0.06, s.tail_round + 0.04 * random.normal());
  s.tumblehome += 0.015 * random.normal();
  // The styles above are makers' figures; KITTI's boxes are drawn around the points, a little smaller.
  size = size.cwiseProduct(Vec3d(0.955, 0.98, 1.005));
  s.length = size.x(), s.width = size.y(), s.height = size.z();
  return assemble(s, "Car", size, random);
}

Actor make_van(RandomStream& random) {
  BodyShape s;
  const bool large = random.uniform() < 0.5;
  const Vec3d size(large ? random.uniform(4.8, 5.8) : random.uniform(4.2, 4.8), random.uniform(1.75, 2.0),
                   large ? random.uniform(2.0, 2.5) : random.uniform(1.8, 2.0));
  s.nose = 0.40, s.bonnet = 0.46, s.cowl_u = random.uniform(0.13, 0.18), s.cowl = 0.55,
  s.roof_front_u = random.uniform(0.27, 0.31);
  s.roof_peak_u = 0.5, s.roof_rear_u = 0.965, s.roof_rear = 0.98, s.window_foot_u = 0.985,
  s.window_foot = 0.55, s.tail = 0.52;
  s.clearance = 0.10, s.belt_front = 0.51, s.belt_rear = 0.54, s.front_axle_u = 0.17, s.rear_axle_u = 0.80;
  s.tumblehome = 0.09, s.nose_round = 0.22, s.tail_round = 0.05, s.wheel_radius = 0.33;
  s.side_glass_end_u = random.uniform() < 0.5 ? 0.42 : 0.92, s.rear_glass = random.uniform() < 0.7;
  s.length = size.x(), s.width = size.y(), s.height = size.z();
  return assemble(s, "Van", size, random);
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
                    surface(glass, plain(Vec3f::Constant(0.02f), 0.1f, 0.08f)), surface(dark, kTrim),
                    surface(wheels, kTyre)};
  fit_label_box(truck);
  return truck;
}

}  // namespace mirage::generator
