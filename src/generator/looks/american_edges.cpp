// The North American look: what stands beside the road.
#include "generator/looks/american.h"
#include "geometry/shapes.h"

namespace mirage::generator {

void AmericanStreet::line_with_houses(int side) {
  const double edge = half_[side] + pavement_[side], line = edge + front_[side];
  for (double s = -12; s < far_;) {
    const double along = u(10, 16), plot = along + u(3, 8), deep = u(8, 11);
    const double middle = s + 0.5 * along;
    if (!in_cross(middle, 0.5 * along + 3)) {
      const double drive = s + (chance(0.5) ? 2.2 : along - 2.2);
      add_house(middle, line, along, deep, side, drive);
      const Vec2d p = xy(middle, sign(side) * (line + 0.5 * deep));
      taken_.push_back({p.x(), p.y(), along, deep, yaw(middle)});
      if (chance(0.75) && s < 66 + ahead_)
        put(vehicle(kAlikeParked), drive + 0.1 * random_.normal(), sign(side) * (line - u(2.9, 3.6)),
            (chance(0.75) ? 0.5 : -0.5) * kPi * sign(side), 0.1);
    }
    s += plot;
  }
  if (chance(0.3)) {
    const double s = u(-5, 25);
    add_fence(s, s + u(8, 25), sign(side) * (edge + 0.4));
  }
  for (double s = u(0, 10); s < 70 + ahead_; s += u(9, 22)) {  // trees on the lawns
    if (in_cross(s, 3)) continue;
    const Vec2d p = xy(s, sign(side) * (edge + 2.5));
    const BevBox box{p.x(), p.y(), 1, 1, 0};
    if (!free(box)) continue;
    taken_.push_back(box);
    stand(make_tree(actors_, s < 22 ? 2.4 : s < 40 ? 1.2 : 0.5), s, sign(side) * (edge + 2.5), u(0, 6));
  }
  add_woods(side, line + u(16, 24));
}

void AmericanStreet::line_with_shops(int side) {
  const double edge = half_[side] + pavement_[side], line = edge + front_[side];
  for (double s = -10; s < far_;) {
    const double along = u(14, 34), deep = u(10, 16), middle = s + 0.5 * along;
    if (chance(0.82) && !in_cross(middle, 0.5 * along + 4)) {
      add_shop(middle, line, along, deep, side);
      const Vec2d p = xy(middle, sign(side) * (line + 0.5 * deep));
      taken_.push_back({p.x(), p.y(), along, deep, yaw(middle)});
    }
    s += along + (chance(0.4) ? 0.05 : u(3, 12));
  }
  // Car park between walk and shops: bays across, some of them taken.
  Mesh lines;
  const double row = line - 4.2, share = u(0.25, 0.85);
  for (double s = -4; s < 75 + ahead_; s += 2.75) {
    if (in_cross(s, 7)) continue;
    const double a = sign(side) * (row - 2.5), b = sign(side) * (row + 2.5);
    add_strip(lines, std::min(a, b), std::max(a, b), s, s + 0.1, 1, 0.008);
    if (chance(share) && s < 62)
      put(vehicle(kAlikeParked), s + 1.4, sign(side) * row + 0.15 * random_.normal(),
          (chance(0.8) ? 0.5 : -0.5) * kPi * sign(side), 0.1);
  }
  surfaces_.push_back(surface(lines, plain(Vec3f::Constant(f(0.35, 0.6)), 0.6f)));
  for (double s = u(0, 25); s < 90; s += u(22, 60)) {
    if (in_cross(s, 4)) continue;
    stand(american::make_pylon(actors_), s, sign(side) * (edge + 0.9));
  }
  // A low hedge or young trees on the strip between walk and car park.
  if (chance(0.4))
    for (double s = u(0, 6); s < 75 + ahead_; s += u(9, 14)) {
      const Vec2d p = xy(s, sign(side) * (edge + 0.8));
      if (in_cross(s, 4) || !free({p.x(), p.y(), 1, 1, 0})) continue;
      stand(make_tree(actors_, s < 22 ? 2.0 : s < 40 ? 1.0 : 0.4), s, sign(side) * (edge + 0.8), u(0, 6));
    }
  add_woods(side, line + u(24, 40));
}

void AmericanStreet::line_with_offices(int side) {
  const double line = half_[side] + pavement_[side] + front_[side];
  for (double s = -10; s < far_;) {
    const double along = u(16, 40), deep = u(14, 20), middle = s + 0.5 * along;
    if (chance(0.88) && !in_cross(middle, 0.5 * along + 2)) {
      add_office(middle, line, along, deep, side);
      const Vec2d p = xy(middle, sign(side) * (line + 0.5 * deep));
      taken_.push_back({p.x(), p.y(), along, deep, yaw(middle)});
    }
    s += along + (chance(0.6) ? 0.05 : u(3, 10));
  }
  if (chance(0.5))
    for (double s = u(2, 10); s < 70 + ahead_; s += u(9, 14))
      if (!in_cross(s, 4))
        stand(make_tree(actors_, s < 22   ? 2.0
                                 : s < 40 ? 1.0
                                          : 0.4),
              s, sign(side) * (half_[side] + 1.0), u(0, 6));
}

void AmericanStreet::place_verge(int side) {
  const double kerb = half_[side] + 0.7, turn = side ? kPi : 0;
  const auto at_kerb = [&](Actor actor, double s) {
    if (!in_cross(s, 2)) stand(std::move(actor), s, sign(side) * kerb, turn);
  };
  for (double s = u(0, 25); s < 90; s += u(15, 40)) at_kerb(american::make_sign(actors_), s);
  for (double s = u(4, 30); s < 60; s += u(30, 70)) at_kerb(american::make_hydrant(actors_), s);
  if (kind_ != Kind::suburb)
    for (double s = u(0, 20); s < 100 + ahead_; s += u(25, 35))
      at_kerb(american::make_street_lamp(actors_), s);
  for (int i = random_.below(4); i > 0; --i) {
    const double s = u(3, 55);
    if (!in_cross(s, 2))
      put(american::make_kerb_item(actors_), s,
          sign(side) * (half_[side] + std::max(0.6, pavement_[side] - 0.5)), (side ? 1 : -1) * 0.5 * kPi,
          0.1);
  }
  if (kind_ == Kind::suburb && verge_[side] > 0.8 && chance(0.5))
    for (double s = u(2, 10); s < 75 + ahead_; s += u(9, 14)) {
      const Vec2d p = xy(s, sign(side) * (half_[side] + 0.5 * verge_[side]));
      if (!in_cross(s, 4) && free({p.x(), p.y(), 0.6, 0.6, 0}))
        stand(make_tree(actors_, s < 22   ? 2.4
                                 : s < 40 ? 1.2
                                          : 0.5),
              s, sign(side) * (half_[side] + 0.5 * verge_[side]), u(0, 6));
    }
}

// Wooden poles along one side, joined by three power lines and two lower cables.
void AmericanStreet::place_utility_line() {
  if (kind_ == Kind::downtown || !chance(0.85)) return;
  const int side = random_.below(2);
  const double d = sign(side) * (half_[side] + std::max(0.8, pavement_[side] + 0.3)), height = u(9, 11.5),
               span = u(28, 38);
  std::vector<double> feet;
  for (double s = -14 + u(0, 12); s < far_; s += span) {
    double place = s;
    if (in_cross(s, 2)) place = cross_s_ - cross_half_ - 3;
    stand(american::make_utility_pole(actors_, height), place, d);
    feet.push_back(place);
  }
  Mesh wires;
  for (std::size_t i = 0; i + 1 < feet.size(); ++i)
    for (const Vec2d& line :
         {Vec2d(-1.05, 0.12), Vec2d(0.6, 0.12), Vec2d(1.05, 0.12), Vec2d(0.15, -2.4), Vec2d(0.15, -3.0)}) {
      const Vec3d a = on_ground(feet[i], d + line.x(), height - 0.55 + line.y()),
                  b = on_ground(feet[i + 1], d + line.x(), height - 0.55 + line.y());
      const double thick = line.y() < 0 ? 0.05 : 0.025, sag = 0.012 * (feet[i + 1] - feet[i]);
      const auto hang = [&](double t) { return Vec3d(a + t * (b - a) - Vec3d(0, 0, 4 * sag * t * (1 - t))); };
      for (int k = 0; k < 8; ++k) {
        const Vec3d p = hang(k / 8.0), q = hang((k + 1) / 8.0), up(0, 0, thick);
        add_quad(wires, p, q, q + up, p + up);
      }
    }
  surfaces_.push_back(surface(wires, plain(Vec3f::Constant(0.025f), 0.1f)));
}

void AmericanStreet::place_people() {
  const int count = kind_ == Kind::downtown ? random_.below(8) : random_.below(4);
  for (int i = 0; i < count; ++i) {
    const int side = random_.below(2);
    const double s = u(6, 45);
    if (chance(0.25))
      put(make_cyclist(actors_), s, sign(side) * (half_[side] - u(0.4, 1.2)), side ? kPi : 0, 0.1);
    else if (cross_s_ < 45 && chance(0.3))  // on the near crosswalk
      put(make_pedestrian(actors_), cross_s_ - cross_half_ - u(1.0, 3.2), u(-half_[0], half_[1]),
          (chance(0.5) ? 0.5 : -0.5) * kPi, 0.1);
    else
      put(make_pedestrian(actors_), s,
          sign(side) * (half_[side] + u(std::max(0.4, verge_[side]), pavement_[side])),
          chance(0.8) ? (chance(0.5) ? 0 : kPi) + 0.1 * random_.normal() : u(-kPi, kPi), 0.1);
  }
}

// The street's end: something stands there, not the bare horizon.
void AmericanStreet::close_view() {
  if (chance(0.35)) {
    add_office(far_ + 4, -14, u(25, 60), 14, 1);
    return;
  }
  Mesh crowns, leaves;
  for (int i = 0; i < 26; ++i) {
    const double d = -60 + 4.7 * i;
    const Vec3d p = on_ground(far_ + u(0, 12), d);
    const Vec3d radii(u(2.5, 4), u(2.5, 4), u(2, 4.5)), middle = p + Vec3d(0, 0, u(2, 4));
    append(crowns, ellipsoid(0.8 * radii), at(middle.x(), middle.y(), middle.z()));
    add_leaves(leaves, middle, radii, 160, 0.45, random_);
  }
  Material m = plain(Vec3f(0.03f, 0.055f, 0.02f), 0.35f);
  m.pattern = Pattern::foliage, m.second = Vec3f(0.06f, 0.09f, 0.03f), m.variant = random_.next_u32();
  surfaces_.push_back(surface(leaves, m));
  m.albedo *= 0.5f, m.second *= 0.5f;
  surfaces_.push_back(surface(crowns, m));
}

}  // namespace mirage::generator
