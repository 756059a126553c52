// The North American look: road markings, the junction and the traffic.
#include "generator/looks/american.h"
#include "geometry/shapes.h"

namespace mirage::generator {
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
      put(vehicle(kAlikeOnLanes), s, (own ? ego_d_ : lane_d(0, lane)) + wobble(0.25), wobble(0.02));
  }
  for (int lane = 0; lane < lanes_[1]; ++lane) {
    if (!chance(flow)) continue;
    for (double s = u(4, 40); s < 70 + ahead_; s += u(8, 45))
      put(vehicle(kAlikeOnLanes), s, lane_d(1, lane) + wobble(0.3), kPi + wobble(0.03));
  }
  if (turn_lane_ > 0 && chance(0.35))
    put(vehicle(kAlikeOnLanes), u(8, 50), wobble(0.2), chance(0.5) ? 0 : kPi);
  if (cross_s_ < far_) {
    for (int i = random_.below(6); i > 0; --i) {
      const bool left = chance(0.5);
      put(vehicle(kAlikeOnLanes), cross_s_ + (left ? 1 : -1) * u(0.3, 0.6) * cross_half_, u(-28, 28),
          (left ? 0.5 : -0.5) * kPi + wobble(0.1));
    }
    if (chance(0.35)) put(vehicle(kAlikeOnLanes), cross_s_ + wobble(2.0), u(-7, 7), u(-kPi, kPi));  // turning
  }
}

void AmericanStreet::place_parked() {
  const auto wobble = [&](double sigma) { return sigma * random_.normal(); };
  for (int side : {0, 1}) {  // along the kerb
    if (strip_[side] < 2) continue;
    const double share = u(0.4, 1.0), d = sign(side) * (half_[side] - 0.5 * strip_[side] + 0.05);
    for (double s = -4 + u(0, 5); s < 70 + ahead_; s += u(6.0, 7.2))
      if (chance(share) && !in_cross(s, 8))
        put(vehicle(kAlikeParked), s, d + wobble(0.1), (side ? kPi : 0) + wobble(0.02), 0.12);
  }
  for (int side : {0, 1})  // at the roadside, on verge and walk
    for (int i = 1 + random_.below(4); i > 0; --i) {
      const double s = u(6, 66), d = half_[side] + u(1.2, std::max(2.0, pavement_[side] + 1.0));
      if (in_cross(s, 3)) continue;
      put(vehicle(kAlikeParked), s, sign(side) * d,
          chance(0.8) ? (chance(0.5) ? 0 : kPi) + wobble(0.06) : u(-kPi, kPi), 0.2);
    }
}

}  // namespace mirage::generator
