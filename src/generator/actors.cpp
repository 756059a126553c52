// Which vehicles there are: body styles of the car family by share, vans and trucks.
#include <algorithm>
#include <array>
#include <cmath>

#include "base/sizes.h"
#include "generator/car_body.h"
#include "generator/looks/american_parts.h"
#include "generator/parts.h"
#include "geometry/box.h"
#include "geometry/mesh.h"

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

// Cars and light trucks in the United States; "van" stands for minivans.
constexpr std::array<StyleShare, 7> kAmericanMix = {{{BodyStyle::suv, 0.36},
                                                     {BodyStyle::saloon, 0.27},
                                                     {BodyStyle::pickup, 0.16},
                                                     {BodyStyle::hatchback, 0.08},
                                                     {BodyStyle::van, 0.06},
                                                     {BodyStyle::coupe, 0.04},
                                                     {BodyStyle::estate, 0.03}}};

/// The car of that shape; `shrunk`: its length and width, since boxes are drawn around points.
Actor finish(BodyStyle style, BodyShape s, CarTrim trim, const Vec2d& shrunk, RandomStream& random) {
  trim.bed = style == BodyStyle::pickup;
  s.side_glass_end_u = std::min(0.935, std::lerp(s.roof_rear_u, s.window_foot_u, 0.5));
  s.length *= shrunk.x(), s.width *= shrunk.y();
  Actor car = assemble(s, "Car", trim, random);
  car.kind = name_of(style);
  add_roof_load(car, s, random);
  return car;
}

// An ellipsoid between two points.
void add_limb(Mesh& mesh, const Vec3d& a, const Vec3d& b, double radius) {
  const Vec3d axis = b - a;
  append(mesh, ellipsoid({radius, radius, 0.55 * axis.norm()}),
         Transform(Eigen::Translation3d(0.5 * (a + b)) *
                   Eigen::Quaterniond::FromTwoVectors(Vec3d::UnitZ(), axis.normalized())));
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
  actor.add(legs, plain(random.uniform() < 0.5 ? Vec3f(0.02f, 0.03f, 0.07f) : random_cloth(random), 0.3f),
            true);
  actor.add(torso, plain(random_cloth(random), 0.35f), true);
  actor.add(skin, plain(dark * Vec3f(0.45f, 0.28f, 0.2f), 0.4f), true);
  actor.add(hair, plain(Vec3f(0.05f, 0.035f, 0.02f), 0.2f), true);
}

// Things that only a picture tells from cars.

constexpr double kHem = 0.42;  // of the height: from here down to the ground a cover hangs straight

/// A cover that the camera sees instead of a surface; the LiDAR still meets the surface below.
Material veiled(const Material& below, Material cover) {
  cover.veiled = true;
  cover.gloss = below.gloss, cover.transparency = below.transparency, cover.lidar = below.lidar;
  return cover;
}

/// A surface for the camera alone.
Surface seen_only(Mesh mesh, Material cover) {
  cover.veiled = true, cover.transparency = 1;
  return surface(std::move(mesh), cover);
}

/// The cover's lower part, down to the ground, with what is between the wheels.
Mesh hem(const Mesh& body, double height) {
  Mesh mesh;
  std::vector<Vec2d> low;
  for (const Vec3d& v : body.vertices)
    if (v.z() <= kHem * height) low.push_back(v.head<2>());
  const std::vector<Vec2d> plan = convex_hull(std::move(low));
  for (std::size_t i = 0; i < plan.size(); ++i) {
    const Vec2d a = 1.012 * plan[i], b = 1.012 * plan[(i + 1) % plan.size()];
    const double foot = 0.005, high = kHem * height;
    add_quad(mesh, {a.x(), a.y(), foot}, {b.x(), b.y(), foot}, {b.x(), b.y(), high}, {a.x(), a.y(), high});
  }
  return mesh;
}

/// Leaves over a surface, `count` of them, evenly by area.
void strew(Mesh& leaves, const Mesh& mesh, int count, RandomStream& random) {
  std::vector<double> until;
  double sum = 0;
  for (const Vec3d& n : face_normals(mesh)) until.push_back(sum += n.norm());
  for (int i = 0; i < count; ++i) {
    const auto at = std::lower_bound(until.begin(), until.end(), random.uniform() * sum);
    const Face& f = mesh.faces[std::min<std::size_t>(as_size(at - until.begin()), until.size() - 1)];
    double b1 = random.uniform(), b2 = random.uniform();
    if (b1 + b2 > 1) b1 = 1 - b1, b2 = 1 - b2;
    const auto [v0, v1, v2] = mesh.corners(f);
    const Vec3d p = (1 - b1 - b2) * v0 + b1 * v1 + b2 * v2;
    add_leaves(leaves, p, {0.05, 0.05, 0.05}, 1, 0.07, random);
  }
}

Material tarpaulin(RandomStream& random) {
  const Vec3f colors[8] = {{0.03f, 0.09f, 0.04f}, {0.03f, 0.08f, 0.30f}, {0.25f, 0.26f, 0.27f},
                           {0.10f, 0.10f, 0.06f}, {0.50f, 0.17f, 0.02f}, {0.45f, 0.40f, 0.30f},
                           {0.60f, 0.60f, 0.58f}, {0.05f, 0.05f, 0.055f}};
  const float tone = static_cast<float>(random.uniform(0.7, 1.3));
  Material m = plain(tone * colors[random.below(8)], 0);
  m.pattern = Pattern::cloth, m.variant = random.next_u32();
  return m;
}

Material goods(RandomStream& random) {
  // Cardboard, straw, wrapped pallets, timber, brick, plastic crates: what it is, and what shows between.
  const Vec3f colors[7][2] = {
      {{0.36f, 0.24f, 0.13f}, {0.10f, 0.06f, 0.03f}}, {{0.30f, 0.21f, 0.12f}, {0.45f, 0.38f, 0.25f}},
      {{0.42f, 0.32f, 0.11f}, {0.14f, 0.10f, 0.03f}}, {{0.55f, 0.56f, 0.58f}, {0.22f, 0.22f, 0.23f}},
      {{0.34f, 0.23f, 0.13f}, {0.05f, 0.03f, 0.02f}}, {{0.30f, 0.11f, 0.07f}, {0.36f, 0.35f, 0.33f}},
      {{0.05f, 0.12f, 0.30f}, {0.01f, 0.02f, 0.06f}}};
  const Vec3f* pick = colors[random.below(7)];
  const float tone = static_cast<float>(random.uniform(0.75, 1.25));
  Material m = plain(tone * pick[0], 0);
  m.second = tone * pick[1];
  m.pattern = Pattern::stack, m.variant = random.next_u32();
  return m;
}

Actor bin(const Vec3d& size, RandomStream& random) {
  Actor actor;
  const double l = 0.5 * size.x(), w = 0.5 * size.y(), h = size.z(), in = random.uniform(0.75, 0.95);
  Mesh tub, ribs, lid;
  const double low = 0.12, rim = random.uniform(0.75, 0.95) * h;
  const auto corner = [&](int k, double z, double k_in) {
    return Vec3d((k == 0 || k == 3 ? 1 : -1) * l * k_in, (k < 2 ? 1 : -1) * w * k_in, z);
  };
  for (int k = 0; k < 4; ++k)
    add_quad(tub, corner(k, low, in), corner((k + 1) % 4, low, in), corner((k + 1) % 4, rim, 1),
             corner(k, rim, 1));
  add_quad(tub, corner(0, low, in), corner(1, low, in), corner(2, low, in), corner(3, low, in));
  for (double x = -0.75 * l; x < 0.8 * l; x += 0.5)
    for (double side : {-1.0, 1.0})
      add_box(ribs, {x - 0.04, side * w * 0.5 * (1 + in) - 0.05, low},
              {x + 0.04, side * w * 0.5 * (1 + in) + 0.05, rim});
  add_box(lid, {-l, -w, rim}, {l, w, rim + 0.04});
  add_box(lid, {-0.8 * l, -0.7 * w, rim}, {0.8 * l, 0.7 * w, h});
  const Vec3f colors[6] = {{0.02f, 0.10f, 0.05f}, {0.03f, 0.08f, 0.28f}, {0.25f, 0.26f, 0.26f},
                           {0.50f, 0.33f, 0.03f}, {0.25f, 0.09f, 0.03f}, {0.05f, 0.05f, 0.05f}};
  const Material tint = plain(colors[random.below(6)], 0), steel = veiled(paint_of(random), tint);
  Material top = steel;
  top.albedo = random.uniform() < 0.5 ? Vec3f(0.7f * steel.albedo) : Vec3f(0.12f, 0.10f, 0.08f);
  actor.surfaces = {surface(tub, steel), surface(ribs, steel), surface(lid, top)};
  return actor;
}

Actor shed(const Vec3d& size, RandomStream& random) {
  Actor actor;
  const double l = 0.5 * size.x(), w = 0.5 * size.y(), h = size.z() * random.uniform(1.0, 1.35),
               wall = 0.72 * h;
  Mesh walls, roof, door;
  add_box(walls, {-l, -w, 0}, {l, w, wall});
  for (double x : {-l, l}) add_quad(walls, {x, -w, wall}, {x, w, wall}, {x, 0, h}, {x, 0, h});
  for (double side : {-1.0, 1.0})
    add_quad(roof, {-l - 0.1, side * (w + 0.08), wall - 0.04}, {l + 0.1, side * (w + 0.08), wall - 0.04},
             {l + 0.1, 0, h}, {-l - 0.1, 0, h});
  const double x = random.uniform(-0.5, 0.5) * l;
  for (double side : {-1.0, 1.0})
    add_box(door, {x - 0.35, side * w - 0.01, 0.05}, {x + 0.35, side * w + 0.01, 0.95 * wall});
  Material boards = plain(Vec3f(0.28f, 0.18f, 0.10f) * static_cast<float>(random.uniform(0.4, 1.6)), 0);
  boards.pattern = random.uniform() < 0.6 ? Pattern::bark : Pattern::brick;
  boards.second = Vec3f::Constant(0.35f), boards.variant = random.next_u32();
  const Material below = paint_of(random);
  actor.surfaces = {
      surface(walls, veiled(below, boards)), surface(door, veiled(below, plain(0.5f * boards.albedo, 0))),
      surface(roof,
              veiled(below,
                     plain(random.uniform() < 0.5 ? Vec3f(0.2f, 0.07f, 0.04f) : Vec3f::Constant(0.06f), 0)))};
  return actor;
}

/// On its trailer, decked or covered.
Actor boat(const Vec3d& size, RandomStream& random) {
  Actor actor;
  constexpr int stations = 14, ring = 6;
  const double l = size.x(), w = 0.5 * size.y(), h = size.z();
  Mesh hull, deck, trailer;
  const auto point = [&](int k, int i) -> Vec3d {  // i: from the keel up to the deck's ridge
    const double u = static_cast<double>(k) / stations, plan = w * (1 - 0.97 * std::pow(u, 3.2)),
                 rise = 0.25 * std::pow(u, 3);
    const double y[ring] = {0, 0.62, 0.92, 1, 0.6, 0}, z[ring] = {0.26, 0.36, 0.58, 0.72, 0.9, 1};
    return {l * (u - 0.5 + (i > 1 ? 0.04 * u : 0)), plan * y[i], h * std::min(1.0, z[i] + rise * (1 - z[i]))};
  };
  for (int k = 0; k < stations; ++k)
    for (int i = 0; i + 1 < ring; ++i)
      for (int side : {-1, 1}) {
        const Vec3d mirror(1, side, 1);
        const Vec3d a = point(k, i).cwiseProduct(mirror), b = point(k + 1, i).cwiseProduct(mirror),
                    c = point(k + 1, i + 1).cwiseProduct(mirror), d = point(k, i + 1).cwiseProduct(mirror);
        Mesh& part = i < 3 ? hull : deck;
        if (side < 0)
          add_quad(part, a, b, c, d);
        else
          add_quad(part, a, d, c, b);
      }
  for (int i = 0; i + 1 < ring; ++i) {  // transom
    const Vec3d a = point(0, i), b = point(0, i + 1), m(1, -1, 1);
    add_quad(hull, a, a.cwiseProduct(m), b.cwiseProduct(m), b);
  }
  add_box(trailer, {-0.45 * l, -0.03, 0.22}, {0.5 * l + 0.4, 0.03, 0.3});
  for (int side : {-1, 1}) add_wheel(trailer, {-0.12 * l, side * 0.8 * w, 0.26}, 0.26, 0.15, 14, side);
  const Material below = paint_of(random);
  const Vec3f colors[4] = {
      {0.65f, 0.65f, 0.62f}, {0.03f, 0.06f, 0.2f}, {0.3f, 0.05f, 0.03f}, {0.3f, 0.2f, 0.1f}};
  actor.surfaces = {surface(hull, veiled(below, plain(colors[random.below(4)], 0))),
                    surface(deck, veiled(below, tarpaulin(random))),
                    surface(trailer, plain(Vec3f::Constant(0.05f), 0.1f))};
  return actor;
}

Actor size_matched_distractor(const Vec3d& size, RandomStream& random) {
  const int pick = random.below(3);
  Actor actor = pick == 0 ? bin(size, random) : pick == 1 ? shed(size, random) : boat(size, random);
  fit_label_box(actor);
  return actor;
}

}  // namespace

Actor make_car(RandomStream& random) {
  const BodyStyle style = by_share(kEuropeanMix, random.uniform()).style;
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
  // The family's ranges are makers' figures of the cars on sale today. KITTI's streets are of 2011, and its
  // boxes are drawn around the points: mean 3.88 x 1.63 x 1.53 m.
  return finish(style, s, trim, {0.925, 0.945}, random);
}

Actor american::make_car(RandomStream& random) {
  const BodyStyle style = by_share(kAmericanMix, random.uniform()).style;
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
  return finish(style, s, trim, {0.97, 0.97}, random);
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
      add_wheel(wheels, {x, side * (0.5 * w - 0.24), 0.48}, 0.48, 0.26, 18, -side);
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
                  surface(stripes, kTrim),
                  surface(dark, kTrim),
                  surface(wheels, kTyre),
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
  return assemble(s, "Van", {}, random);
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
    for (int side : {1, -1}) add_wheel(wheels, {x, side * 0.48 * w, 0.48}, 0.48, 0.28, 18, side);
  const Material white = plain(Vec3f::Constant(static_cast<float>(random.uniform(0.3, 0.75))), 0.5f, 0.01f);
  truck.surfaces = {surface(cargo, random.uniform() < 0.6 ? white : paint_of(random)),
                    surface(cabin, paint_of(random)),
                    surface(glass, plain(Vec3f::Constant(0.02f), 0.1f, 0.08f)), surface(dark, kTrim),
                    surface(wheels, kTyre)};
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
      const double a = 2 * kPi * i / 18, b = 2 * kPi * (i + 1) / 18;
      bar({x + r * std::cos(a), 0, r + r * std::sin(a)}, {x + r * std::cos(b), 0, r + r * std::sin(b)},
          0.022);
    }
  bar({-0.55, 0, r}, {-0.1, 0, 0.3}, 0.02), bar({-0.1, 0, 0.3}, {0.42, 0, 0.85}, 0.025),
      bar({-0.15, 0, 0.9}, {0.42, 0, 0.85}, 0.02);
  bar({-0.15, 0, 0.92}, {-0.1, 0, 0.3}, 0.02), bar({0.42, 0, 1.0}, {0.55, 0, r}, 0.02),
      bar({0.4, -0.25, 1.02}, {0.4, 0.25, 1.02}, 0.018);
  actor.add(bicycle, plain(Vec3f::Constant(0.05f), 0.2f));
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
        a = cylinder(radius, tall, 20);
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
      for (int side : {1, -1}) add_wheel(b, {0, side * 0.55 * w, 0.3}, 0.3, 0.16, 14, side);
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
  Mesh wood = cylinder(r, trunk + 0.4 * (h - trunk), 10, 0.5 * r), leaves, cores;
  const int clusters = 5 + random.below(5);
  const double reach = random.uniform(0.25, 0.38) * h;
  const int count = static_cast<int>(2.5 * detail * random.uniform(160, 260));
  for (int i = 0; i < clusters; ++i) {
    const double a = random.uniform(0, 2 * kPi), d = reach * random.uniform(0, 0.75);
    const Vec3d c(d * std::cos(a), d * std::sin(a), random.uniform(trunk + 0.18 * (h - trunk), 0.88 * h));
    add_rod(wood, {0, 0, trunk * 0.9}, c, 0.35 * r, 5, 0.02);
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

Actor make_look_alike(Actor car, RandomStream& random) {
  const double pick = random.uniform();
  if (pick < 0.2) {
    car = size_matched_distractor(car.size, random);
  } else {
    const bool hedge = pick < 0.45;
    const Material cover = hedge ? green(random) : pick < 0.72 ? tarpaulin(random) : goods(random);
    const Mesh lower = hem(car.surfaces.front().mesh, car.size.z());
    if (hedge) {
      Mesh leaves;
      strew(leaves, lower, 300, random);
      strew(leaves, car.surfaces[0].mesh, 500, random);  // paint, then glass
      strew(leaves, car.surfaces[1].mesh, 200, random);
      Material shade = cover;  // between the leaves
      shade.albedo *= 0.6f, shade.second *= 0.6f;
      for (Surface& s : car.surfaces) s.material = veiled(s.material, shade);
      car.surfaces.push_back(seen_only(lower, shade));
      car.surfaces.push_back(seen_only(std::move(leaves), cover));
    } else {
      for (Surface& s : car.surfaces) s.material = veiled(s.material, cover);
      car.surfaces.push_back(seen_only(lower, cover));
    }
  }
  car.type = "Misc";
  car.kind = "look-alike";
  return car;
}

}  // namespace mirage::generator
