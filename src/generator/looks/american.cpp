// The North American look: which street it is and its ground.
#include "generator/looks/american.h"

#include "geometry/shapes.h"

namespace mirage::generator {

void AmericanStreet::choose() {
  const double pick = random_.uniform();
  kind_ = pick < 0.48 ? Kind::avenue : pick < 0.78 ? Kind::suburb : Kind::downtown;
  lane_ = u(3.2, 3.7);
  const bool wide = kind_ == Kind::avenue;
  turn_lane_ = wide ? (chance(0.65) ? u(3.3, 4.2) : 0) : kind_ == Kind::downtown && chance(0.25) ? 3.2 : 0;
  for (int side : {0, 1}) {
    lanes_[side] = kind_ == Kind::suburb     ? 1
                   : kind_ == Kind::downtown ? 1 + random_.below(2)
                                             : 2 + random_.below(2);
    // Kerb-side parking, a cycle lane, or a gutter.
    strip_[side] = kind_ == Kind::suburb     ? (chance(0.8) ? u(2.1, 2.5) : 0.6)
                   : kind_ == Kind::downtown ? (chance(0.8) ? u(2.2, 2.5) : 0.4)
                                             : (chance(0.35) ? u(1.4, 1.9) : 0.5);
    half_[side] = 0.5 * turn_lane_ + lane_ * lanes_[side] + strip_[side];
    verge_[side] = kind_ == Kind::downtown ? 0 : chance(0.8) ? u(1.0, 2.6) : 0;
    pavement_[side] = verge_[side] + (kind_ == Kind::downtown ? u(2.8, 4.5) : u(1.3, 1.9));
    front_[side] = kind_ == Kind::suburb ? u(7, 12) : kind_ == Kind::avenue ? u(13, 26) : u(0, 1.5);
  }
  heading_ = 0.02 * random_.normal();
  curvature_ = chance(kind_ == Kind::suburb ? 0.5 : 0.2) ? 0.0025 * random_.normal() : 0;
  ego_d_ = lane_d(0, random_.below(lanes_[0]));
  ego_d_ += 0.2 * random_.normal();
  slope_ = 0.008 * random_.normal();
  wave_ = 0.10 * random_.uniform(), wave_length_ = u(30, 80), wave_phase_ = u(0, 2 * kPi);
  cross_s_ = chance(kind_ == Kind::suburb ? 0.45 : 0.7) ? u(16, 48) : 1e9;
  cross_half_ = kind_ == Kind::suburb ? u(3.5, 5) : u(5, 9);
}

void AmericanStreet::lay_ground() {
  for (double& bank : bank_) bank = kind_ == Kind::suburb && chance(0.5) ? u(0.0, 0.07) : 0;
  const bool concrete = chance(0.2);
  Material tar = plain(
      (concrete ? Vec3f(1.04f, 1, 0.93f) : Vec3f(1, 1, 1.02f)) * (concrete ? f(0.2, 0.3) : f(0.07, 0.17)),
      f(0.18, 0.34));
  tar.pattern = Pattern::asphalt, tar.variant = random_.next_u32();
  Mesh road;
  add_strip(road, -half_[0], half_[1], -12, far_, 2);
  add_cross_road(road, 70);
  surfaces_.push_back(surface(road, tar));
  add_earth();
  add_manhole_covers(random_.below(3));

  Material walk = plain(Vec3f(1.0f, 0.97f, 0.9f) * f(0.25, 0.42), f(0.3, 0.45));
  walk.pattern = Pattern::paving, walk.variant = 3 * (random_.next_u32() / 3) + 1;  // slabs, not setts
  Material lot = plain(Vec3f(1, 1, 1.02f) * f(0.06, 0.14), f(0.18, 0.3));
  lot.pattern = Pattern::asphalt, lot.variant = random_.next_u32();
  Material lawn = plain(Vec3f(f(0.03, 0.07), f(0.06, 0.11), 0.02f), 0.4f);
  lawn.pattern = Pattern::grass, lawn.variant = random_.next_u32();
  lawn.second = chance(0.3) ? Vec3f(0.2f, 0.17f, 0.08f) : Vec3f(f(0.06, 0.11), f(0.09, 0.13), 0.03f);
  Mesh slabs, grass, kerbs, lots;
  for (int side : {0, 1}) {
    const double edge = half_[side], outer = edge + pavement_[side];
    for (int piece = 0; piece < 2; ++piece) {
      double s0 = piece == 0 ? -12 : cross_s_ + cross_half_,
             s1 = piece == 0 ? std::min(far_, cross_s_ - cross_half_) : far_;
      if (s1 <= s0) continue;
      s0 += 0.01, s1 -= 0.01;
      const auto lay = [&](Mesh& mesh, double a, double b) {  // wound upwards on either side
        if (side)
          add_strip(mesh, a, b, s0, s1, 2);
        else
          add_strip(mesh, -b, -a, s0, s1, 2);
      };
      lay(kerbs, edge + 0.06, edge + 0.2);
      for (double s = s0; s < s1; s += 2) {
        const double e = std::min(s + 2, s1), d = sign(side) * edge, b = sign(side) * (edge + 0.06);
        add_quad(kerbs, on_ground(s, d), on_ground(e, d), on_ground(e, b), on_ground(s, b));
      }
      if (verge_[side] > 0) lay(grass, edge + 0.2, edge + verge_[side]);
      lay(slabs, edge + std::max(0.2, verge_[side]), outer);
      if (kind_ == Kind::suburb) {
        lay(grass, outer, outer + 8), lay(grass, outer + 8, outer + 26);
      } else if (kind_ == Kind::avenue) {
        lay(grass, outer, outer + 1.5), lay(lots, outer + 1.5, outer + 26);
      } else {
        lay(slabs, outer, outer + 6), lay(lots, outer + 6, outer + 26);
      }
      lay(grass, outer + 26, outer + 80);
    }
  }
  surfaces_.push_back(surface(slabs, walk));
  surfaces_.push_back(surface(lots, lot));
  surfaces_.push_back(surface(grass, lawn));
  surfaces_.push_back(surface(kerbs, plain(Vec3f(1, 0.98f, 0.93f) * f(0.28, 0.42), 0.35f)));
}

// The North American look: road markings, the junction and the traffic.

namespace {

constexpr double kLine = 0.11, kLift = 0.008;  // m, width of a line, height of the paint

}  // namespace

// A left arrow in the turn lane: a shaft and a head.
void AmericanStreet::paint_arrow(Mesh& paint, double s, double d) {
  add_strip(paint, d - 0.3, d - 0.15, s, s + 1.6, 1.6, kLift);
  add_strip(paint, d - 0.3, d + 0.25, s + 1.45, s + 1.6, 1, kLift);
  add_quad(paint, on_ground(s + 1.05, d + 0.25, kLift), on_ground(s + 2.0, d + 0.25, kLift),
           on_ground(s + 1.525, d + 0.75, kLift), on_ground(s + 1.525, d + 0.75, kLift));
}

void AmericanStreet::paint_road() {
  Mesh white, yellow;
  const auto line = [&](Mesh& mesh, double d, double on, double off, double phase) {
    for (double s = -10 + phase; s < far_; s += on + off)
      if (!in_cross(s + 0.5 * on, 0.5 * on + 4.5))
        add_strip(mesh, d - 0.5 * kLine, d + 0.5 * kLine, s, s + on, 2, kLift);
  };
  const auto solid = [&](Mesh& mesh, double d) { line(mesh, d, 2, 0, 0); };
  if (turn_lane_ > 0) {
    for (int side : {0, 1}) {
      solid(yellow, sign(side) * 0.5 * turn_lane_);
      line(yellow, sign(side) * (0.5 * turn_lane_ - 0.25), 3, 6, 1);
    }
    for (double s = u(5, 20); s < 70 + ahead_; s += u(25, 40))
      if (!in_cross(s, 6)) paint_arrow(white, s, 0);
  } else if (kind_ != Kind::suburb || chance(0.4)) {
    for (double d : {-0.12, 0.12}) solid(yellow, d);
  }
  for (int side : {0, 1}) {
    for (int k = 1; k < lanes_[side]; ++k)
      line(white, sign(side) * (0.5 * turn_lane_ + k * lane_), 3, 9, u(0, 9));
    if (strip_[side] > 1 && kind_ != Kind::suburb) solid(white, sign(side) * (half_[side] - strip_[side]));
    if (kind_ == Kind::downtown && strip_[side] > 2)  // parking bays
      for (double s = -6; s < 70 + ahead_; s += 6.4)
        if (!in_cross(s, 7)) {
          const double a = sign(side) * half_[side], b = sign(side) * (half_[side] - strip_[side]);
          add_strip(white, std::min(a, b), std::max(a, b), s, s + 0.1, 1, kLift);
        }
  }
  if (cross_s_ < far_) {
    const double s = cross_s_ - cross_half_, e = cross_s_ + cross_half_;
    const bool bars = kind_ != Kind::suburb ? chance(0.7) : chance(0.3);
    if (kind_ != Kind::suburb || chance(0.6)) {  // stop lines, ours and theirs
      add_strip(white, -half_[0] + 0.2, -0.5 * turn_lane_ - 0.3, s - 4.6, s - 4.1, 1, kLift);
      add_strip(white, 0.5 * turn_lane_ + 0.3, half_[1] - 0.2, e + 4.1, e + 4.6, 1, kLift);
    }
    for (double start : {s - 3.6, e + 0.6}) {
      if (bars) {
        for (double d = -half_[0] + 0.5; d < half_[1] - 0.6; d += 1.2)
          add_strip(white, d, d + 0.6, start, start + 3, 1.5, kLift);
      } else if (kind_ != Kind::suburb) {
        for (double edge : {start, start + 2.7})
          add_strip(white, -half_[0] + 0.2, half_[1] - 0.2, edge, edge + 0.3, 1, kLift);
      }
    }
  }
  surfaces_.push_back(surface(white, plain(Vec3f::Constant(f(0.4, 0.7)), 0.75f)));
  surfaces_.push_back(surface(yellow, plain(Vec3f(f(0.5, 0.65), f(0.28, 0.36), 0.02f), 0.65f)));
}

// Signals on mast arms behind the junction, for us and for those who come; in suburbs stop signs.
void AmericanStreet::place_junction() {
  const double before = cross_s_ - cross_half_ - 1.8, behind = cross_s_ + cross_half_ + 1.8;
  if (kind_ == Kind::suburb) {
    stand(american::make_stop_sign(actors_), before - 1.5, -half_[0] - 0.8);
    if (chance(0.5)) stand(american::make_stop_sign(actors_), behind + 1.5, half_[1] + 0.8, kPi);
    return;
  }
  const int lit = random_.below(3);
  // Each side's lanes as seen from its pole at the kerb: metres from the pole.
  const auto arm = [&](int side, double s, double turn) {
    std::vector<double> heads;
    const double pole = half_[side] + 0.9;
    for (int k = lanes_[side]; k-- > 0;) heads.push_back(pole - std::abs(lane_d(side, k)));
    if (turn_lane_ > 0) heads.push_back(pole);
    stand(american::make_mast_arm(actors_, heads.back() + 0.8, heads, lit), s, sign(side) * pole, turn);
  };
  if (chance(0.7)) {
    arm(0, behind, 0);
    arm(1, before, kPi);
  } else {  // span wire between two poles, heads hanging from it
    const Vec3d a = on_ground(behind, -half_[0] - 1.2, 6.6), b = on_ground(behind, half_[1] + 1.2, 6.6);
    Actor wire;
    Mesh posts, cable;
    for (const Vec3d& p : {a, b}) append(posts, cylinder(0.14, 7.6, 9, 0.1), at(p.x(), p.y(), p.z() - 6.6));
    const auto hang = [&](double t) { return Vec3d(a + t * (b - a) - Vec3d(0, 0, 1.6 * t * (1 - t))); };
    for (int i = 0; i < 12; ++i) {
      const Vec3d p = hang(i / 12.0), q = hang((i + 1) / 12.0), up(0, 0, 0.03);
      add_quad(cable, p, q, q + up, p + up);
    }
    surfaces_.push_back(surface(posts, plain(Vec3f(0.12f, 0.09f, 0.06f), 0.3f)));
    surfaces_.push_back(surface(cable, plain(Vec3f::Constant(0.03f), 0.1f)));
    const bool yellow = chance(0.6);
    for (int k = 0; k < lanes_[0] + (turn_lane_ > 0); ++k) {
      const double d = k < lanes_[0] ? lane_d(0, k) : 0;
      const Vec3d p = hang((d + half_[0] + 1.2) / (half_[0] + half_[1] + 2.4));
      Actor head;
      american::add_signal_head(head, 0, -0.65, lit, yellow);
      add_surfaces(head, at(p.x(), p.y(), p.z(), yaw(behind)), -1);
    }
  }
}

Actor AmericanStreet::vehicle(double alike) {
  if (actors_.uniform() < alike) return make_look_alike(american::make_car(actors_), actors_);
  const double pick = actors_.uniform();
  return pick < 0.915   ? american::make_car(actors_)
         : pick < 0.955 ? make_van(actors_)
         : pick < 0.988 ? make_truck(actors_)
                        : american::make_school_bus(actors_);
}

void AmericanStreet::place_traffic() {
  const auto wobble = [&](double sigma) { return sigma * random_.normal(); };
  const double flow = kind_ == Kind::suburb ? 0.4 : 0.8;
  for (int lane = 0; lane < lanes_[0]; ++lane) {
    const bool own = std::abs(lane_d(0, lane) - ego_d_) < 0.5 * lane_;
    if (!chance(flow)) continue;
    for (double s = own ? u(8, 35) : u(2, 25); s < 66 + ahead_; s += u(7.5, 40))
      put(vehicle(kAlikeOnLanes),
          {.turn = wobble(0.02), .d = (own ? ego_d_ : lane_d(0, lane)) + wobble(0.25), .s = s});
  }
  for (int lane = 0; lane < lanes_[1]; ++lane) {
    if (!chance(flow)) continue;
    for (double s = u(4, 40); s < 70 + ahead_; s += u(8, 45))
      put(vehicle(kAlikeOnLanes), {.turn = kPi + wobble(0.03), .d = lane_d(1, lane) + wobble(0.3), .s = s});
  }
  if (turn_lane_ > 0 && chance(0.35))
    put(vehicle(kAlikeOnLanes), {.turn = chance(0.5) ? 0 : kPi, .d = wobble(0.2), .s = u(8, 50)});
  if (cross_s_ < far_) {
    for (int i = random_.below(6); i > 0; --i) {
      const bool left = chance(0.5);
      put(vehicle(kAlikeOnLanes), {.turn = (left ? 0.5 : -0.5) * kPi + wobble(0.1),
                                   .d = u(-28, 28),
                                   .s = cross_s_ + (left ? 1 : -1) * u(0.3, 0.6) * cross_half_});
    }
    if (chance(0.35))
      put(vehicle(kAlikeOnLanes),
          {.turn = u(-kPi, kPi), .d = u(-7, 7), .s = cross_s_ + wobble(2.0)});  // turning
  }
}

void AmericanStreet::place_parked() {
  const auto wobble = [&](double sigma) { return sigma * random_.normal(); };
  for (int side : {0, 1}) {  // along the kerb
    if (strip_[side] < 2) continue;
    const double share = u(0.4, 1.0), d = sign(side) * (half_[side] - 0.5 * strip_[side] + 0.05);
    for (double s = -4 + u(0, 5); s < 70 + ahead_; s += u(6.0, 7.2))
      if (chance(share) && !in_cross(s, 8))
        put(vehicle(kAlikeParked), {.turn = (side ? kPi : 0) + wobble(0.02), .d = d + wobble(0.1), .s = s},
            0.12);
  }
  for (int side : {0, 1})  // at the roadside, on verge and walk
    for (int i = 1 + random_.below(4); i > 0; --i) {
      const double s = u(6, 66), d = half_[side] + u(1.2, std::max(2.0, pavement_[side] + 1.0));
      if (in_cross(s, 3)) continue;
      put(vehicle(kAlikeParked),
          {.turn = chance(0.8) ? (chance(0.5) ? 0 : kPi) + wobble(0.06) : u(-kPi, kPi),
           .d = sign(side) * d,
           .s = s},
          0.2);
    }
}

}  // namespace mirage::generator
