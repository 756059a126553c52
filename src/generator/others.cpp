// Everything that is not a vehicle: people, plants, street furniture and car-sized clutter.
#include <algorithm>
#include <cmath>
#include <numbers>

#include "generator/parts.h"
#include "geometry/shapes.h"

namespace mirage::generator {

Vec3f random_cloth(RandomStream& random) {
  const float tone = static_cast<float>(random.uniform(0.015, 0.5));
  return Vec3f(tone * static_cast<float>(random.uniform(0.5, 1.2)),
               tone * static_cast<float>(random.uniform(0.5, 1.1)),
               tone * static_cast<float>(random.uniform(0.5, 1.3)))
      .cwiseMin(0.8f);
}

Material green(RandomStream& random) {
  Material m;
  m.pattern = Pattern::foliage;
  const auto u = [&](double a, double b) { return static_cast<float>(random.uniform(a, b)); };
  m.albedo = Vec3f(u(0.025, 0.06), u(0.045, 0.10), u(0.01, 0.025));
  m.second = random.uniform() < 0.15 ? Vec3f(u(0.15, 0.25), u(0.09, 0.13), 0.02f)
                                     : Vec3f(u(0.05, 0.11), u(0.08, 0.14), u(0.015, 0.035));
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
  add_person(actor, random.uniform(1.6, 1.85), random.uniform(0.15, 0.3), 0.95, random);
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
        const Vec3d p(u(-0.5, 0.5) * l, (random.uniform() < 0.5 ? 0.5 : -0.5) * w * u(0.8, 1.05),
                      u(0.02, 1) * h);
        const Vec3d q = random.uniform() < 0.3 ? Vec3d(p.x(), u(-0.5, 0.5) * w, h * u(0.92, 1.04)) : p;
        add_leaves(b, q, {0.05, 0.05, 0.05}, 1, 0.08, random);
      }
      const Material m = green(random);
      Material core = m;
      core.albedo *= 0.4f, core.second *= 0.4f;
      actor.surfaces = {surface(a, core), surface(b, m)};
      break;
    }
    case 5: {  // bush
      const Vec3d r(u(0.5, 1.6), u(0.5, 1.6), u(0.5, 1.2));
      add_leaves(b, {0, 0, 0.8 * r.z()}, r, static_cast<int>(900 * r.x() * r.y() + 400), 0.09, random);
      actor.surfaces = {surface(b, green(random))};
      break;
    }
    case 6: {  // switch cabinet, advertising pillar
      if (random.uniform() < 0.5) {
        add_box(a, {-0.25, -0.6, 0}, {0.25, u(0.3, 0.9), u(1.0, 1.6)});
        actor.surfaces = {surface(a, plain(tone(0.25, 0.5), 0.4f))};
      } else {
        append(a, cylinder(u(0.5, 0.7), u(2.4, 3.2), 20), Transform::Identity());
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
