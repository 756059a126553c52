// The European look: streets of a middle-sized German town and the roads around it.
#include <memory>

#include "generator/street_site.h"
#include "geometry/mesh.h"

namespace mirage::generator {
namespace {

class EuropeanStreet final : public StreetSite {
 public:
  EuropeanStreet(std::uint64_t seed, std::uint64_t index, double height)
      : StreetSite(seed, "street", index, height) {}

 private:
  enum class Kind { residential, avenue, rural, crossing, square };

  void choose_layout() override;
  void lay_ground() override;
  void place_traffic() override;
  void furnish() override {
    place_parked();
    place_edges();
    place_people();
  }
  void place_parked();
  void place_people();
  void place_edges();
  void place_signals();
  void add_building(double s, double d, double along, double deep, int side);

  Actor vehicle(double alike) override {
    if (actors_.uniform() < alike) return make_look_alike(make_car(actors_), actors_);
    const double pick = actors_.uniform();
    return pick < 0.93 ? make_car(actors_) : pick < 0.985 ? make_van(actors_) : make_truck(actors_);
  }

  Kind kind_ = Kind::residential;
};

// Which street it is, its road and its traffic.

void EuropeanStreet::choose_layout() {
  const double pick = random_.uniform();
  kind_ = pick < 0.42   ? Kind::residential
          : pick < 0.62 ? Kind::avenue
          : pick < 0.74 ? Kind::rural
          : pick < 0.9  ? Kind::crossing
                        : Kind::square;
  lane_ = u(2.9, 3.6);
  lanes_[1] = kind_ == Kind::avenue && chance(0.4) ? 2 : 1;
  lanes_[0] = kind_ == Kind::avenue && chance(0.5) ? 2 : 1;
  const double parking = kind_ == Kind::residential ? 0.85
                         : kind_ == Kind::crossing  ? 0.5
                         : kind_ == Kind::avenue    ? 0.35
                         : kind_ == Kind::square    ? 0.9
                                                    : 0.05;
  for (int side = 0; side < 2; ++side) {
    strip_[side] = chance(parking) ? (chance(kind_ == Kind::square ? 0.7 : 0.15) ? 5.0 : u(2.0, 2.4)) : 0;
    half_[side] = lane_ * lanes_[side] + strip_[side] + u(0.0, 0.4);
    pavement_[side] = kind_ == Kind::rural ? 0 : u(1.5, 4.0);
    front_[side] = kind_ == Kind::residential ? (chance(0.5) ? u(0, 1) : u(2, 7))
                   : kind_ == Kind::rural     ? u(4, 12)
                                              : u(2, 12);
  }
  heading_ = wobble(0.02);
  curvature_ = chance(0.4) ? wobble(0.0025) : 0;
  ego_d_ = -0.5 * lane_ + wobble(0.25);
  if (lanes_[0] == 2 && chance(0.5)) ego_d_ -= lane_;
  slope_ = wobble(0.010);
  wave_ = 0.10 * random_.uniform(), wave_length_ = u(30, 80), wave_phase_ = u(0, 2 * kPi);
  cross_s_ = kind_ == Kind::crossing || chance(0.15) ? u(14, 45) : 1e9;
  cross_half_ = u(3, 6);
  kerb_ = kind_ == Kind::rural ? 0.04 : kKerb;
}

void EuropeanStreet::lay_ground() {
  for (double& bank : bank_) bank = chance(0.35) ? u(-0.03, 0.12) : 0;
  Material tar = plain(Vec3f(1, 1, 1.03f) * f(0.065, 0.15), f(0.16, 0.32));
  tar.pattern = Pattern::asphalt, tar.variant = random_.next_u32();
  Mesh road;
  add_strip(road, -half_[0], half_[1], -12, far_, 2);
  add_cross_road(road, 60);
  add(road, tar);

  Material stone = plain(Vec3f(1.0f, 0.97f, 0.92f) * f(0.12, 0.28), f(0.25, 0.4));
  stone.pattern = Pattern::paving, stone.variant = random_.next_u32();
  Material lawn = plain(Vec3f(f(0.03, 0.06), f(0.05, 0.10), 0.018f), 0.4f);
  lawn.pattern = Pattern::grass, lawn.second = Vec3f(f(0.07, 0.15), f(0.08, 0.13), 0.035f),
  lawn.variant = random_.next_u32();
  Material kerb = plain(Vec3f::Constant(f(0.2, 0.36)), 0.3f);
  Mesh pavement, grass, kerbs;
  const bool green = kind_ == Kind::rural || kind_ == Kind::avenue || chance(0.5);
  for_each_stretch([&](int side, double s0, double s1) {
    const double edge = half_[side], outer = edge + pavement_[side];
    const auto lay = [&](Mesh& mesh, double a, double b) { add_side_strip(mesh, side, a, b, s0, s1, 2); };
    if (kind_ != Kind::rural) {
      add_kerb(kerbs, side, s0, s1, 3);
      lay(pavement, edge + 0.2, outer);
    }
    lay(green ? grass : pavement, outer, outer + 6);
    lay(green ? grass : pavement, outer + 6, outer + 24);
    lay(grass, outer + 24, outer + 80);
  });
  add_ground();
  add_manhole_covers(random_.below(4));
  add(pavement, stone);
  add(grass, lawn);
  add(kerbs, kerb);

  Mesh paint;
  const double mark = 0.12;
  if (kind_ != Kind::residential || chance(0.3)) {
    const auto dashes = [&](double d, double on, double off) {
      for (double s = -10 + u(0, 6); s < far_; s += on + off)
        if (!in_cross(s, on)) add_strip(paint, d - 0.5 * mark, d + 0.5 * mark, s, s + on, 2, 0.008);
    };
    const auto solid = [&](double d) {
      for (double s = -10; s < far_; s += 2)
        if (!in_cross(s, 2)) add_strip(paint, d - 0.5 * mark, d + 0.5 * mark, s, s + 2, 2, 0.008);
    };
    if (chance(0.8)) {
      const double gap = u(3, 6);
      dashes(0, u(2.5, 4), gap);
    } else {
      solid(0);
    }
    for (int k = 1; k < lanes_[1]; ++k) dashes(k * lane_, 3, 6);
    for (int k = 1; k < lanes_[0]; ++k) dashes(-k * lane_, 3, 6);
    if (kind_ == Kind::rural || kind_ == Kind::avenue) {
      solid(lanes_[1] * lane_ - 0.1);
      solid(-lanes_[0] * lane_ + 0.1);
    }
  }
  if (cross_s_ < far_ && chance(0.7)) {
    const double s = cross_s_ - cross_half_ - 1.2;
    add_strip(paint, -lanes_[0] * lane_ + 0.2, -0.2, s, s + 0.5, 1, 0.008);
    if (chance(0.5))
      for (double d = -half_[0] + 0.4; d < half_[1] - 0.4; d += 1.0)
        add_strip(paint, d, d + 0.5, s - 4.2, s - 1.2, 2, 0.008);
  }
  add(paint, plain(Vec3f::Constant(f(0.4, 0.7)), 0.75f));
}

void EuropeanStreet::place_traffic() {
  const double flow = kind_ == Kind::avenue ? 0.85 : kind_ == Kind::rural ? 0.8 : 0.65;
  // Ahead in our own lane and in the next one.
  if (chance(flow)) {
    double s = u(7, 35);
    const int count = 1 + (chance(0.45) ? 1 + random_.below(2) : 0);
    for (int i = 0; i < count; ++i, s += u(7, 22))
      put(vehicle(kLaneDecoyShare), {.turn = wobble(0.02), .d = ego_d_ + wobble(0.25), .s = s});
  }
  if (lanes_[0] == 2)
    for (double s = u(3, 20); s < 65 + ahead_; s += u(8, 35)) {
      const double d = ego_d_ > -lane_ ? -1.5 * lane_ : -0.5 * lane_;
      put(vehicle(kLaneDecoyShare), {.turn = wobble(0.02), .d = d + wobble(0.25), .s = s});
    }
  for (int lane = 0; lane < lanes_[1]; ++lane)
    if (chance(flow))
      for (double s = u(4, 40); s < 66 + ahead_; s += u(8, 45))
        put(vehicle(kLaneDecoyShare),
            {.turn = kPi + wobble(0.03), .d = (lane + 0.5) * lane_ + wobble(0.3), .s = s});
  if (cross_s_ < far_) {
    const int count = random_.below(5);
    for (int i = 0; i < count; ++i) {
      const bool left = chance(0.5);
      put(vehicle(kLaneDecoyShare), {.turn = (left ? 0.5 : -0.5) * kPi + wobble(0.12),
                                     .d = u(-22, 22),
                                     .s = cross_s_ + (left ? 0.5 : -0.5) * cross_half_ + wobble(0.4)});
    }
    if (chance(0.4))
      put(vehicle(kLaneDecoyShare),
          {.turn = u(-kPi, kPi), .d = u(-5, 5), .s = cross_s_ + wobble(2.0)});  // turning
  }
}

void EuropeanStreet::place_parked() {
  for (int side : {0, 1}) {
    if (strip_[side] == 0) continue;
    const double share = u(0.5, 1.0);
    const bool across = strip_[side] > 4, slanted = across && chance(0.4);
    const double slant = slanted ? u(0.5, 1.1) : 0.5 * kPi;
    const double d = sign(side) * (half_[side] - 0.5 * strip_[side] + (across ? 0 : u(-0.1, 0.3)));
    for (double s = -4 + u(0, 5); s < 66 + ahead_;
         s += across ? u(2.4, 2.9) / std::sin(slant) : u(5.0, 6.3)) {
      if (!chance(share) || in_cross(s, 6)) continue;
      double turn = 0;
      if (across)
        turn = (chance(0.75) ? 1 : -1) * sign(side) * slant;
      else
        turn = chance(side ? 0.7 : 0.12) ? kPi : 0;
      put(vehicle(kParkedDecoyShare), {.turn = turn + wobble(0.025), .d = d + wobble(0.1), .s = s}, 0.12);
    }
  }
  // Cars off the street: drives, yards, car parks.
  for (int side : {0, 1}) {
    const int count = chance(0.45) ? 1 + random_.below(4) : 0;
    for (int i = 0; i < count; ++i)
      put(vehicle(kParkedDecoyShare),
          {.turn = u(-kPi, kPi),
           .d = sign(side) * (half_[side] + pavement_[side] + u(2.5, 12)),
           .s = u(8, 60)},
          0.3);
    // At the roadside, half on the pavement or the verge.
    for (int i = 1 + random_.below(4); i > 0; --i) {
      const double s = u(6, 64), d = half_[side] + u(1.2, std::max(2.0, pavement_[side] + 0.5));
      if (in_cross(s, 3)) continue;
      put(vehicle(kParkedDecoyShare),
          {.turn = chance(0.8) ? (chance(0.5) ? 0 : kPi) + wobble(0.06) : u(-kPi, kPi),
           .d = sign(side) * d,
           .s = s},
          0.2);
    }
  }
}

// Things beside the road.

void EuropeanStreet::add_building(double s, double d, double along, double deep, int side) {
  const double h = chance(0.6) ? u(5, 10) : u(9, 18);
  const Vec2d p = xy(s, sign(side) * (d + 0.5 * deep));
  const double base = ground_z(s, sign(side) * d);
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
  add(moved(box_mesh({along, deep, h + 3}), t * Transform(Eigen::Translation3d(0, 0, 0.5 * (h - 3)))), wall);
  Mesh roof;
  const double e = 0.4, rise = chance(0.75) ? u(1.5, 4) : 0.3;
  const double a = 0.5 * along + e, b = 0.5 * deep + e;
  const auto q = [&](double x, double y, double z) { return t * Vec3d(x, y, h + z); };
  add_quad(roof, q(-a, -b, -0.1), q(a, -b, -0.1), q(a, 0, rise), q(-a, 0, rise));
  add_quad(roof, q(a, b, -0.1), q(-a, b, -0.1), q(-a, 0, rise), q(a, 0, rise));
  add_quad(roof, q(-a, -b, -0.1), q(-a, 0, rise), q(-a, b, -0.1), q(-a, 0, 0));
  add_quad(roof, q(a, -b, -0.1), q(a, 0, rise), q(a, b, -0.1), q(a, 0, 0));
  add(roof, plain(chance(0.6) ? Vec3f(0.22f, 0.08f, 0.05f) : Vec3f::Constant(0.08f), 0.3f));
  // Balconies, a door or a shop front give the walls relief.
  Mesh relief;
  const double front = -sign(side) * 0.5 * deep;
  for (int i = random_.below(4); i > 0; --i) {
    const double x = u(-0.4, 0.4) * along, z = u(2.6, std::max(2.7, h - 2)), w = u(0.5, 1.5);
    add_box(relief, {x - w, front, z}, {x + w, front - sign(side) * 1.0, z + u(0.15, 1.0)});
  }
  add(moved(std::move(relief), t), plain(wall.albedo * 0.8f, 0.35f));
}

void EuropeanStreet::place_edges() {
  for (int side : {0, 1}) {
    const double edge = half_[side] + pavement_[side];
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
          const BevBox box = outline(s + 0.5 * along, sign(side) * (line + 0.5 * deep), along, deep, yaw(s));
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
      add_fence(s, s + u(8, 50), sign(side) * (edge + 0.2));
    }
    // Street trees in a row, or a few anywhere.
    const bool row = chance(kind_ == Kind::avenue ? 0.75 : 0.35);
    for (double s = u(2, 12); s < 75 + ahead_; s += row ? u(7, 11) : u(12, 45)) {
      if (in_cross(s, 2)) continue;
      Actor tree = make_tree(actors_, detail(s, 3.0, 1.5, 0.6));
      const double d =
          sign(side) * (row ? half_[side] + std::min(0.9, 0.5 * pavement_[side] + 0.4) : edge + u(0.5, 5));
      const BevBox box = outline(s, d, 0.6, 0.6);
      if (!free(box)) continue;
      taken_.push_back(box);
      add_surfaces(tree, at(box.x, box.y, ground_z(s, d), u(0, 6)), -1);
    }
    for (double s = u(3, 15); s < 80 + ahead_; s += u(8, 30)) {
      if (in_cross(s, 0)) continue;
      stand(make_pole(actors_), s, sign(side) * (half_[side] + u(0.35, 0.7)), side ? kPi : 0);
    }
    for (int i = random_.below(6) + 1; i > 0; --i) {
      const double s = u(4, 55);
      if (in_cross(s, 1)) continue;
      put(make_clutter(actors_),
          {.turn = chance(0.7) ? wobble(0.05) : u(-kPi, kPi),
           .d = sign(side) * (edge + (chance(0.4) ? u(-std::min(1.2, pavement_[side]), 0.5) : u(0.5, 7))),
           .s = s},
          0.1);
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
    if (chance(0.25))
      put(make_cyclist(actors_),
          {.turn = side ? kPi : 0, .d = sign(side) * (half_[side] - u(0.3, 1.2)), .s = u(6, 50)}, 0.1);
    else
      put(make_pedestrian(actors_),
          {.turn = u(-kPi, kPi),
           .d = sign(side) * (half_[side] + u(-0.5, std::max(0.5, pavement_[side]))),
           .s = u(5, 45)},
          0.1);
  }
}

}  // namespace

std::unique_ptr<StreetSite> european_street(std::uint64_t seed, std::uint64_t index, double height) {
  return std::make_unique<EuropeanStreet>(seed, index, height);
}

}  // namespace mirage::generator
