// The European look: what stands beside the road.
#include "generator/looks/european.h"
#include "geometry/shapes.h"

namespace mirage::generator {

void EuropeanStreet::add_building(double s, double d, double along, double deep, int side) {
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
  wall.foot = static_cast<float>(base);
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

void EuropeanStreet::place_edges() {
  for (int side : {0, 1}) {
    const double sign = side ? 1 : -1, edge = half_[side] + pavement_[side];
    const double line = edge + front_[side] + 0.3;
    const bool wooded = kind_ == Kind::rural    ? chance(0.75)
                        : kind_ == Kind::avenue ? chance(0.4)
                                                : chance(0.08);
    if (wooded) {
      add_woods(side, line + u(0, 4));
    } else {
      const double gap = kind_ == Kind::rural ? 0.85 : kind_ == Kind::residential ? 0.15 : 0.35;
      for (double s = -8; s < far_;) {
        const double along = u(7, 22), deep = u(8, 14);
        if (!chance(gap) && !in_cross(s + 0.5 * along, 0.5 * along + 3)) {
          const Vec2d p = xy(s + 0.5 * along, sign * (line + 0.5 * deep));
          const BevBox box{p.x(), p.y(), along, deep, yaw(s)};
          if (free(box)) {
            add_building(s + 0.5 * along, line, along, deep, side);
            taken_.push_back(box);
          }
        }
        s += along + (chance(0.5) ? 0.05 : u(1, 6));
      }
      add_woods(side, line + u(22, 40));
    }
    if (kind_ != Kind::rural && front_[side] > 1.0 && chance(0.7)) {
      const double s = u(-5, 20);
      add_fence(s, s + u(8, 50), sign * (edge + 0.2));
    }
    // Street trees in a row, or a few anywhere.
    const bool row = chance(kind_ == Kind::avenue ? 0.75 : 0.35);
    for (double s = u(2, 12); s < 75 + ahead_; s += row ? u(7, 11) : u(12, 45)) {
      if (in_cross(s, 2)) continue;
      Actor tree = make_tree(actors_, s < 22 ? 3.0 : s < 40 ? 1.5 : 0.6);
      const double d =
          sign * (row ? half_[side] + std::min(0.9, 0.5 * pavement_[side] + 0.4) : edge + u(0.5, 5));
      const Vec2d p = xy(s, d);
      const BevBox box{p.x(), p.y(), 0.6, 0.6, 0};
      if (!free(box)) continue;
      taken_.push_back(box);
      add_surfaces(tree, at(p.x(), p.y(), ground_z(s, d), u(0, 6)), -1);
    }
    for (double s = u(3, 15); s < 80 + ahead_; s += u(8, 30)) {
      if (in_cross(s, 0)) continue;
      stand(make_pole(actors_), s, sign * (half_[side] + u(0.35, 0.7)), side ? kPi : 0);
    }
    for (int i = random_.below(6) + 1; i > 0; --i) {
      const double s = u(4, 55);
      if (in_cross(s, 1)) continue;
      put(make_clutter(actors_), s,
          sign * (edge + (chance(0.4) ? u(-std::min(1.2, pavement_[side]), 0.5) : u(0.5, 7))),
          chance(0.7) ? 0.05 * random_.normal() : u(-kPi, kPi), 0.1);
    }
  }
  place_signals();
  // The street's end: something stands there, not the bare horizon.
  if (chance(0.6)) add_building(far_ - 5, -15, u(25, 60), 12, 1);
}

// Lights where our street meets the crossing: on the right before it, often on the left and behind it too.
void EuropeanStreet::place_signals() {
  if (cross_s_ > far_ || !chance(0.55)) return;
  const int lit = random_.below(3);
  const double before = cross_s_ - cross_half_ - 1.6, behind = cross_s_ + cross_half_ + 1.6;
  stand(make_traffic_light(actors_, lit), before, -half_[0] - 0.5);
  if (chance(0.5)) stand(make_traffic_light(actors_, lit), before, half_[1] + 0.5);
  if (chance(0.5)) stand(make_traffic_light(actors_, lit), behind, half_[1] + 0.5, kPi);
}

void EuropeanStreet::place_people() {
  const int count = kind_ == Kind::rural ? random_.below(2) : random_.below(5);
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
