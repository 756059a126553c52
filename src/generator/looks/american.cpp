// The North American look: which street it is and its ground.
#include "generator/looks/american.h"

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
  ego_d_ = lane_d(0, random_.below(lanes_[0])) + 0.2 * random_.normal();
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

}  // namespace mirage::generator
