#include "geometry/shapes.h"
#include "scene/generator/street_builder.h"

namespace mirage::generator {

void StreetBuilder::add_building(double s, double d, double along, double deep, int side) {
  const double sign = side ? 1 : -1, h = chance(0.6) ? u(5, 10) : u(9, 18);
  const Vec2d p = xy(s, sign * (d + 0.5 * deep));
  const double base = ground_z(s, sign * d);
  Material wall;
  wall.pattern = chance(0.85) ? Pattern::facade : Pattern::brick;
  const Vec3f tints[6] = {{0.62f, 0.58f, 0.5f}, {0.6f, 0.5f, 0.32f},   {0.5f, 0.5f, 0.5f},
                          {0.4f, 0.16f, 0.1f},  {0.55f, 0.42f, 0.36f}, {0.36f, 0.42f, 0.46f}};
  wall.albedo = tints[random_.below(6)] * f(0.35, 1.1);
  wall.second = wall.pattern == Pattern::brick ? Vec3f::Constant(0.3f) : Vec3f(0.035f, 0.04f, 0.05f);
  wall.variant = random_.next_u32();
  wall.lidar = 0.35f;
  const Transform t = at(p.x(), p.y(), base, yaw(s));
  Mesh body;
  append(body, box_mesh({along, deep, h + 3}), t * Transform(Eigen::Translation3d(0, 0, 0.5 * (h - 3))));
  surfaces_.push_back(surface(body, wall));
  Mesh roof;
  const double e = 0.4, rise = chance(0.75) ? u(1.5, 4) : 0.3;
  const double a = 0.5 * along + e, b = 0.5 * deep + e;
  const auto q = [&](double x, double y, double z) { return t * Vec3d(x, y, h + z); };
  add_quad(roof, q(-a, -b, -0.1), q(a, -b, -0.1), q(a, 0, rise), q(-a, 0, rise));
  add_quad(roof, q(a, b, -0.1), q(-a, b, -0.1), q(-a, 0, rise), q(a, 0, rise));
  add_quad(roof, q(-a, -b, -0.1), q(-a, 0, rise), q(-a, b, -0.1), q(-a, 0, 0));
  add_quad(roof, q(a, -b, -0.1), q(a, 0, rise), q(a, b, -0.1), q(a, 0, 0));
  surfaces_.push_back(
      surface(roof, plain(chance(0.6) ? Vec3f(0.22f, 0.08f, 0.05f) : Vec3f::Constant(0.08f), 0.3f)));
  // Balconies, a door or a shop front give the walls relief.
  Mesh relief;
  const double front = -sign * 0.5 * deep;
  for (int i = random_.below(4); i > 0; --i) {
    const double x = u(-0.4, 0.4) * along, z = u(2.6, std::max(2.7, h - 2)), w = u(0.5, 1.5);
    const Vec3d low(x - w, std::min(front, front - sign * 1.0), z),
        high(x + w, std::max(front, front - sign * 1.0), z + u(0.15, 1.0));
    Mesh part;
    add_box(part, low, high);
    append(relief, part, t);
  }
  if (!relief.faces.empty()) surfaces_.push_back(surface(relief, plain(wall.albedo * 0.8f, 0.35f)));
}

void StreetBuilder::add_fence(double s0, double s1, double d) {
  const int style = random_.below(3);
  const double h = u(0.8, 1.9);
  Mesh mesh;
  Material m = plain(Vec3f::Constant(f(0.03, 0.3)), 0.3f);
  const auto panel = [&](double a, double b, double low, double high) {
    add_quad(mesh, on_ground(a, d, low), on_ground(b, d, low), on_ground(b, d, high), on_ground(a, d, high));
  };
  for (double s = s0; s < s1; s += 2) {
    if (in_cross(s, 3)) continue;
    const double e = std::min(s + 2, s1);
    panel(s, s + 0.07, 0, h);
    if (style == 0) {  // wall
      panel(s, e, 0, h);
    } else if (style == 1) {  // rails
      panel(s, e, 0.15, 0.22);
      panel(s, e, h - 0.12, h - 0.05);
      for (double x = s + 0.18; x < e; x += 0.18) panel(x, x + 0.03, 0.15, h);
    } else {  // boards
      for (double x = s; x < e; x += 0.14) panel(x, x + 0.115, 0.05, h);
    }
  }
  if (style == 0 && chance(0.5))
    m.pattern = Pattern::brick, m.albedo = Vec3f(0.3f, 0.13f, 0.09f), m.second = Vec3f::Constant(0.35f);
  if (style == 2) m.albedo = Vec3f(f(0.08, 0.25), f(0.06, 0.16), 0.06f);
  surfaces_.push_back(surface(mesh, m));
}

void StreetBuilder::add_woods(int side, double from) {
  const double sign = side ? 1 : -1;
  Mesh leaves, trunks;
  for (double s = -5; s < kFar + 10; s += 3) {
    if (in_cross(s, 2)) continue;
    for (int k = 0; k < 2; ++k) {
      const double d = sign * (from + u(0, 10));
      const Vec3d p = on_ground(s, d);
      const double h = u(4, 12);
      const int count = s < 15 ? 500 : s < 40 ? 260 : 90;
      const double size = s < 15 ? 0.17 : s < 40 ? 0.26 : 0.5;
      add_leaves(leaves, p + Vec3d(0, 0, 0.55 * h), {2.4, 2.4, 0.48 * h}, count, size, random_);
      if (s < 40) append(trunks, cylinder(u(0.08, 0.2), 0.7 * h, 7), at(p.x(), p.y(), p.z()));
    }
  }
  Material m = plain(Vec3f(f(0.03, 0.06), f(0.055, 0.1), 0.02f), 0.35f);
  m.pattern = Pattern::foliage, m.second = Vec3f(f(0.06, 0.14), f(0.09, 0.13), 0.03f),
  m.variant = random_.next_u32();
  surfaces_.push_back(surface(leaves, m));
  surfaces_.push_back(surface(trunks, plain(Vec3f(0.07f, 0.055f, 0.045f), 0.3f)));
}

void StreetBuilder::place_edges() {
  for (int side : {0, 1}) {
    const double sign = side ? 1 : -1, edge = half_[side] + pavement_[side];
    const double line = edge + front_[side] + 0.3;
    const bool wooded = kind_ == StreetKind::rural    ? chance(0.75)
                        : kind_ == StreetKind::avenue ? chance(0.4)
                                                      : chance(0.08);
    if (wooded) {
      add_woods(side, line + u(0, 4));
    } else {
      const double gap = kind_ == StreetKind::rural ? 0.85 : kind_ == StreetKind::residential ? 0.15 : 0.35;
      for (double s = -8; s < kFar;) {
        const double along = u(7, 22), deep = u(8, 14);
        if (!chance(gap) && !in_cross(s + 0.5 * along, 0.5 * along + 3)) {
          const Vec2d p = xy(s + 0.5 * along, sign * (line + 0.5 * deep));
          const BevBox box{p.x(), p.y(), along, deep, yaw(s)};
          const bool free = std::none_of(taken_.begin(), taken_.end(),
                                         [&](const BevBox& b) { return intersection_area(b, box) > 0; });
          if (free) {
            add_building(s + 0.5 * along, line, along, deep, side);
            taken_.push_back(box);
          }
        }
        s += along + (chance(0.5) ? 0.05 : u(1, 6));
      }
      add_woods(side, line + u(22, 40));
    }
    if (kind_ != StreetKind::rural && front_[side] > 1.5 && chance(0.6)) {
      const double s = u(-5, 20);
      add_fence(s, s + u(8, 50), sign * (edge + 0.2));
    }
    // Street trees in a row, or a few anywhere.
    const bool row = chance(kind_ == StreetKind::avenue ? 0.75 : 0.35);
    for (double s = u(2, 12); s < 75; s += row ? u(7, 11) : u(12, 45)) {
      if (in_cross(s, 2)) continue;
      Actor tree = make_tree(actors_, s < 22 ? 3.0 : s < 40 ? 1.5 : 0.6);
      const double d =
          sign * (row ? half_[side] + std::min(0.9, 0.5 * pavement_[side] + 0.4) : edge + u(0.5, 5));
      const Vec2d p = xy(s, d);
      const BevBox box{p.x(), p.y(), 0.6, 0.6, 0};
      if (std::any_of(taken_.begin(), taken_.end(),
                      [&](const BevBox& b) { return intersection_area(b, box) > 0; }))
        continue;
      taken_.push_back(box);
      add_surfaces(tree, at(p.x(), p.y(), ground_z(s, d), u(0, 6)), -1);
    }
    for (double s = u(3, 15); s < 80; s += u(8, 30)) {
      if (in_cross(s, 0)) continue;
      Actor pole = make_pole(actors_);
      const double d = sign * (half_[side] + u(0.35, 0.7));
      const Vec2d p = xy(s, d);
      add_surfaces(pole, at(p.x(), p.y(), ground_z(s, d), yaw(s) + (side ? kPi : 0)), -1);
    }
    for (int i = random_.below(6) + 1; i > 0; --i) {
      const double s = u(4, 55);
      if (in_cross(s, 1)) continue;
      put(make_clutter(actors_), s, sign * (edge + (chance(0.4) ? u(-1.2, 0.5) : u(0.5, 7))),
          chance(0.7) ? 0.05 * random_.normal() : u(-kPi, kPi), 0.1);
    }
  }
  // The street's end: something stands there, not the bare horizon.
  if (chance(0.6)) add_building(kFar - 5, -15, u(25, 60), 12, 1);
}

void StreetBuilder::place_people() {
  const int count = kind_ == StreetKind::rural ? random_.below(2) : random_.below(5);
  for (int i = 0; i < count; ++i) {
    const int side = random_.below(2);
    const double sign = side ? 1 : -1;
    if (chance(0.25))
      put(make_cyclist(actors_), u(6, 50), sign * (half_[side] - u(0.3, 1.2)), side ? kPi : 0, 0.1);
    else
      put(make_pedestrian(actors_), u(5, 45), sign * (half_[side] + u(-0.5, std::max(0.5, pavement_[side]))),
          u(-kPi, kPi), 0.1);
  }
}

}  // namespace mirage::generator
