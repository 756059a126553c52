// The North American look: avenues with shops behind car parks, suburbs with lawns and driveways, office
// blocks.
#include <memory>

#include "generator/looks/american_parts.h"
#include "generator/street_site.h"
#include "geometry/mesh.h"

namespace mirage::generator {
namespace {

class AmericanStreet final : public StreetSite {
 public:
  AmericanStreet(std::uint64_t seed, std::uint64_t index, double height)
      : StreetSite(seed, "american street", index, height) {}

 private:
  enum class Kind { avenue, suburb, downtown };

  void furnish() override {
    place_parked();
    for (int side : {0, 1}) {
      if (kind_ == Kind::suburb)
        line_with_houses(side);
      else if (kind_ == Kind::avenue)
        line_with_shops(side);
      else
        line_with_offices(side);
      place_verge(side);
    }
    place_utility_line();
    place_people();
    close_view();
  }

  // Course and ground
  void choose_layout() override;
  void lay_ground() override;
  // Markings, junction, traffic
  void paint_road();
  void paint_arrow(Mesh& paint, double s, double d);
  void place_junction();
  void place_traffic() override;
  void place_parked();
  // Things beside the road
  void line_with_houses(int side);
  void line_with_shops(int side);
  void line_with_offices(int side);
  void place_verge(int side);
  void place_utility_line();
  void place_people();
  void close_view();
  void add_house(double s, double d, double along, double deep, int side, double drive_s);
  void add_shop(double s, double d, double along, double deep, int side);
  void add_office(double s, double d, double along, double deep, int side);

  Actor vehicle(double alike) override;
  /// A wall's frame: x along the street, y to its left, z up, origin on the ground before the middle.
  Transform footing(double s, double d) const {
    const Vec2d p = xy(s, d);
    return at(p.x(), p.y(), ground_z(s, d), yaw(s));
  }

  Kind kind_ = Kind::avenue;
  double verge_[2] = {};  // grass between kerb and walk
};

// Which street it is and its ground.

void AmericanStreet::choose_layout() {
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
  heading_ = wobble(0.02);
  curvature_ = chance(kind_ == Kind::suburb ? 0.5 : 0.2) ? wobble(0.0025) : 0;
  ego_d_ = lane_d(0, random_.below(lanes_[0]));
  ego_d_ += wobble(0.2);
  slope_ = wobble(0.008);
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
  add(road, tar);
  add_ground();
  add_manhole_covers(random_.below(3));

  Material walk = plain(Vec3f(1.0f, 0.97f, 0.9f) * f(0.25, 0.42), f(0.3, 0.45));
  walk.pattern = Pattern::paving, walk.variant = 3 * (random_.next_u32() / 3) + 1;  // slabs, not setts
  Material lot = plain(Vec3f(1, 1, 1.02f) * f(0.06, 0.14), f(0.18, 0.3));
  lot.pattern = Pattern::asphalt, lot.variant = random_.next_u32();
  Material lawn = plain(Vec3f(f(0.03, 0.07), f(0.06, 0.11), 0.02f), 0.4f);
  lawn.pattern = Pattern::grass, lawn.variant = random_.next_u32();
  lawn.second = chance(0.3) ? Vec3f(0.2f, 0.17f, 0.08f) : Vec3f(f(0.06, 0.11), f(0.09, 0.13), 0.03f);
  Mesh slabs, grass, kerbs, lots;
  for_each_stretch([&](int side, double s0, double s1) {
    const double edge = half_[side], outer = edge + pavement_[side];
    const auto lay = [&](Mesh& mesh, double a, double b) { add_side_strip(mesh, side, a, b, s0, s1, 2); };
    add_kerb(kerbs, side, s0, s1, 2);
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
  });
  add(slabs, walk);
  add(lots, lot);
  add(grass, lawn);
  add(kerbs, plain(Vec3f(1, 0.98f, 0.93f) * f(0.28, 0.42), 0.35f));
  paint_road();
  if (cross_s_ < far_) place_junction();
}

// Road markings, the junction and the traffic.

constexpr double kLine = 0.11, kLift = 0.008;  // m, width of a line, height of the paint

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
  add(white, plain(Vec3f::Constant(f(0.4, 0.7)), 0.75f));
  add(yellow, plain(Vec3f(f(0.5, 0.65), f(0.28, 0.36), 0.02f), 0.65f));
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
    Mesh posts, cable;
    for (const Vec3d& p : {a, b}) append(posts, cylinder(0.14, 7.6, 9, 0.1), at(p.x(), p.y(), p.z() - 6.6));
    const auto hang = [&](double t) { return Vec3d(a + t * (b - a) - Vec3d(0, 0, 1.6 * t * (1 - t))); };
    for (int i = 0; i < 12; ++i) {
      const Vec3d p = hang(i / 12.0), q = hang((i + 1) / 12.0), up(0, 0, 0.03);
      add_quad(cable, p, q, q + up, p + up);
    }
    add(posts, plain(Vec3f(0.12f, 0.09f, 0.06f), 0.3f));
    add(cable, plain(Vec3f::Constant(0.03f), 0.1f));
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
  const double flow = kind_ == Kind::suburb ? 0.4 : 0.8;
  for (int lane = 0; lane < lanes_[0]; ++lane) {
    const bool own = std::abs(lane_d(0, lane) - ego_d_) < 0.5 * lane_;
    if (!chance(flow)) continue;
    for (double s = own ? u(8, 35) : u(2, 25); s < 66 + ahead_; s += u(7.5, 40))
      put(vehicle(kLaneDecoyShare),
          {.turn = wobble(0.02), .d = (own ? ego_d_ : lane_d(0, lane)) + wobble(0.25), .s = s});
  }
  for (int lane = 0; lane < lanes_[1]; ++lane) {
    if (!chance(flow)) continue;
    for (double s = u(4, 40); s < 70 + ahead_; s += u(8, 45))
      put(vehicle(kLaneDecoyShare), {.turn = kPi + wobble(0.03), .d = lane_d(1, lane) + wobble(0.3), .s = s});
  }
  if (turn_lane_ > 0 && chance(0.35))
    put(vehicle(kLaneDecoyShare), {.turn = chance(0.5) ? 0 : kPi, .d = wobble(0.2), .s = u(8, 50)});
  if (cross_s_ < far_) {
    for (int i = random_.below(6); i > 0; --i) {
      const bool left = chance(0.5);
      put(vehicle(kLaneDecoyShare), {.turn = (left ? 0.5 : -0.5) * kPi + wobble(0.1),
                                     .d = u(-28, 28),
                                     .s = cross_s_ + (left ? 1 : -1) * u(0.3, 0.6) * cross_half_});
    }
    if (chance(0.35))
      put(vehicle(kLaneDecoyShare),
          {.turn = u(-kPi, kPi), .d = u(-7, 7), .s = cross_s_ + wobble(2.0)});  // turning
  }
}

void AmericanStreet::place_parked() {
  for (int side : {0, 1}) {  // along the kerb
    if (strip_[side] < 2) continue;
    const double share = u(0.4, 1.0), d = sign(side) * (half_[side] - 0.5 * strip_[side] + 0.05);
    for (double s = -4 + u(0, 5); s < 70 + ahead_; s += u(6.0, 7.2))
      if (chance(share) && !in_cross(s, 8))
        put(vehicle(kParkedDecoyShare),
            {.turn = (side ? kPi : 0) + wobble(0.02), .d = d + wobble(0.1), .s = s}, 0.12);
  }
  for (int side : {0, 1})  // at the roadside, on verge and walk
    for (int i = 1 + random_.below(4); i > 0; --i) {
      const double s = u(6, 66), d = half_[side] + u(1.2, std::max(2.0, pavement_[side] + 1.0));
      if (in_cross(s, 3)) continue;
      put(vehicle(kParkedDecoyShare),
          {.turn = chance(0.8) ? (chance(0.5) ? 0 : kPi) + wobble(0.06) : u(-kPi, kPi),
           .d = sign(side) * d,
           .s = s},
          0.2);
    }
}

// Clapboard or stucco, shingle roof, garage with a driveway to the road, porch or front steps.
void AmericanStreet::add_house(double s, double d, double along, double deep, int side, double drive_s) {
  const double h = chance(0.55) ? u(2.9, 3.4) : u(5.2, 6.2), front = -sign(side) * 0.5 * deep,
               out = -sign(side);
  const Transform t = footing(s, sign(side) * (d + 0.5 * deep));
  const double ground = ground_z(s, sign(side) * d) - t.translation().z();
  Material wall;
  const Vec3f tints[7] = {{0.62f, 0.61f, 0.57f}, {0.55f, 0.48f, 0.36f}, {0.36f, 0.42f, 0.46f},
                          {0.30f, 0.36f, 0.28f}, {0.52f, 0.46f, 0.40f}, {0.30f, 0.12f, 0.08f},
                          {0.62f, 0.56f, 0.34f}};
  const int tint = random_.below(7);
  wall.albedo = tints[tint] * f(0.6, 1.1), wall.pattern = tint == 5 ? Pattern::brick : Pattern::facade;
  wall.second = wall.pattern == Pattern::brick ? Vec3f::Constant(0.3f) : Vec3f(0.04f, 0.045f, 0.055f);
  wall.variant = random_.next_u32(), wall.lidar = 0.4f;
  wall.foot = static_cast<float>(t.translation().z() + ground);
  Mesh body;
  add_box(body, {-0.5 * along, -0.5 * deep, ground - 1}, {0.5 * along, 0.5 * deep, ground + h});
  add(moved(body, t), wall);

  Mesh roof, trim;
  const double e = 0.5, rise = u(1.6, 3.0), a = 0.5 * along + e, b = 0.5 * deep + e, z = ground + h;
  const double hip = chance(0.5) ? u(2, 4) : 0;  // hipped or gabled
  const auto q = [&](double x, double y, double up) { return Vec3d(x, y, z + up); };
  add_quad(roof, q(-a, -b, -0.1), q(a, -b, -0.1), q(a - hip, 0, rise), q(-a + hip, 0, rise));
  add_quad(roof, q(a, b, -0.1), q(-a, b, -0.1), q(-a + hip, 0, rise), q(a - hip, 0, rise));
  for (double x : {-1.0, 1.0})
    add_quad(hip > 0 ? roof : trim, q(x * a, -b, -0.1), q(x * a, b, -0.1), q(x * (a - hip), 0, rise),
             q(x * (a - hip), 0, rise));
  for (double y : {-b, b}) add_box(trim, {-a, y - 0.03, z - 0.28}, {a, y + 0.03, z - 0.08});  // gutters
  const float tone = f(0.05, 0.16);
  add(moved(roof, t), plain(Vec3f(1.1f, 1, 0.92f) * tone, 0.25f));

  // Garage: stands out a little, a light door in panels, a drive of concrete.
  Mesh garage, door, grooves, drive;
  const double x = drive_s - s, w = 2.6, y0 = front + out * 0.9, top = ground + 2.7;
  add_box(garage, {x - w, front, ground - 1}, {x + w, y0, top});
  add_quad(roof = Mesh(), {x - w - 0.3, front, top + 0.9}, {x + w + 0.3, front, top + 0.9},
           {x + w + 0.3, y0 + out * 0.4, top - 0.05}, {x - w - 0.3, y0 + out * 0.4, top - 0.05});
  const double yd = y0 + out * 0.02;
  add_quad(door, {x - 2.3, yd, ground}, {x + 2.3, yd, ground}, {x + 2.3, yd, ground + 2.2},
           {x - 2.3, yd, ground + 2.2});
  for (int k = 1; k < 4; ++k)
    add_quad(grooves, {x - 2.3, yd + out * 0.01, ground + 0.55 * k},
             {x + 2.3, yd + out * 0.01, ground + 0.55 * k},
             {x + 2.3, yd + out * 0.01, ground + 0.55 * k + 0.03},
             {x - 2.3, yd + out * 0.01, ground + 0.55 * k + 0.03});
  Material plainwall = wall;
  plainwall.pattern = wall.pattern == Pattern::brick ? Pattern::brick : Pattern::plain;
  add(moved(garage, t), plainwall);
  add(moved(roof, t), plain(Vec3f(1.1f, 1, 0.92f) * tone, 0.25f));
  add(moved(door, t), plain(Vec3f::Constant(f(0.3, 0.7)), 0.5f));
  add(moved(grooves, t), plain(Vec3f::Constant(0.15f), 0.3f));
  for (double r = half_[side]; r < d - 0.9; r += 1.5) {
    const double r1 = std::min(r + 1.5, d - 0.9), m = sign(side);
    add_quad(drive, on_ground(drive_s - 2.2, m * r, 0.02), on_ground(drive_s + 2.2, m * r, 0.02),
             on_ground(drive_s + 2.2, m * r1, 0.02), on_ground(drive_s - 2.2, m * r1, 0.02));
  }
  Material slab = plain(Vec3f(1, 0.98f, 0.94f) * f(0.22, 0.4), 0.35f);
  slab.pattern = Pattern::paving, slab.variant = 3 * (random_.next_u32() / 3) + 1;
  add(drive, slab);
  // Porch: posts and a small roof before the door, at the other end of the front.
  const double px = x > 0 ? -0.2 * along : 0.2 * along, py = front + out * 1.8;
  add_box(trim, {px - 1.8, front, ground + 2.5}, {px + 1.8, py, ground + 2.68});
  for (double k : {-1.7, 1.7})
    add_box(trim, {px + k - 0.07, py - 0.07, ground - 0.5}, {px + k + 0.07, py + 0.07, ground + 2.5});
  add_box(trim, {px - 1.8, front, ground - 0.5}, {px + 1.8, py, ground + 0.25});
  add(moved(trim, t), plain(Vec3f::Constant(f(0.4, 0.7)), 0.5f));
}

// A low flat building: glass front, coloured fascia with the shop's name, roof units.
void AmericanStreet::add_shop(double s, double d, double along, double deep, int side) {
  const double h = u(4.8, 7.5), front = -sign(side) * 0.5 * deep, out = -sign(side);
  const Transform t = footing(s, sign(side) * (d + 0.5 * deep));
  const double ground = ground_z(s, sign(side) * d) - t.translation().z();
  Material wall = plain(Vec3f(0.5f, 0.45f, 0.37f) * f(0.5, 1.3), 0.4f);
  if (chance(0.35))
    wall.pattern = Pattern::brick, wall.albedo = Vec3f(0.3f, 0.14f, 0.09f),
    wall.second = Vec3f::Constant(0.35f);
  wall.variant = random_.next_u32();
  Mesh body, units;
  add_box(body, {-0.5 * along, -0.5 * deep, ground - 1}, {0.5 * along, 0.5 * deep, ground + h});
  add(moved(body, t), wall);
  for (int k = random_.below(4); k > 0; --k) {
    const double x = u(-0.4, 0.4) * along, y = u(-0.3, 0.3) * deep;
    add_box(units, {x - 1, y - 0.8, ground + h}, {x + 1, y + 0.8, ground + h + u(0.8, 1.4)});
  }
  add(moved(units, t), plain(Vec3f::Constant(0.4f), 0.4f));

  Mesh glass, frames;
  const double y = front + out * 0.03, yf = front + out * 0.07, gl = 0.46 * along;
  add_quad(glass, {-gl, y, ground + 0.4}, {gl, y, ground + 0.4}, {gl, y, ground + 2.9},
           {-gl, y, ground + 2.9});
  for (double x = -gl; x <= gl + 0.01; x += gl / std::ceil(gl / 1.1))
    add_box(frames, {x - 0.04, y, ground + 0.4}, {x + 0.04, yf, ground + 2.9});
  add_box(frames, {-gl, y, ground + 2.1}, {gl, yf, ground + 2.16});
  add(moved(glass, t), plain(Vec3f(0.03f, 0.035f, 0.04f), 0.15f, 0.08f));
  add(moved(frames, t), plain(Vec3f::Constant(f(0.05, 0.5)), 0.4f));

  // One to three shops share the building, each with its fascia, name and perhaps an awning.
  const int shops = 1 + random_.below(3);
  for (int k = 0; k < shops; ++k) {
    const double w = along / shops, middle = -0.5 * along + (k + 0.5) * w, z = ground + 3.1,
                 top = z + u(0.9, 1.3);
    const Vec3f color =
        chance(0.35) ? Vec3f::Constant(f(0.05, 0.7)) : Vec3f(f(0.02, 0.5), f(0.02, 0.3), f(0.02, 0.4));
    Mesh board, letters;
    add_box(board, {middle - 0.48 * w, front, z}, {middle + 0.48 * w, front + out * 0.3, top});
    add(moved(board, t), plain(color, 0.5f));
    const double half = std::min(0.35 * w, 3.5);
    american::add_letters(letters, 0, half, -half, 0.5 * (z + top), 0.55 * (top - z), actors_);
    // From a board that faces −x to one that faces the street.
    const Transform face = t * at(middle, front + out * 0.32, 0, out < 0 ? 0.5 * kPi : -0.5 * kPi);
    add(moved(letters, face),
        plain(color.mean() < 0.25f ? Vec3f(0.7f, 0.68f, 0.6f) : Vec3f::Constant(0.03f), 0.5f));
    if (chance(0.4)) {
      Mesh awning;
      const double ya = front + out * 1.5;
      add_quad(awning, {middle - 0.4 * w, front + out * 0.05, z - 0.05},
               {middle + 0.4 * w, front + out * 0.05, z - 0.05}, {middle + 0.4 * w, ya, z - 0.7},
               {middle - 0.4 * w, ya, z - 0.7});
      add(moved(awning, t), plain(Vec3f(f(0.05, 0.4), f(0.03, 0.2), f(0.03, 0.25)), 0.4f));
    }
  }
}

// Storeys of windows over a glazed ground floor.
void AmericanStreet::add_office(double s, double d, double along, double deep, int side) {
  const double h = chance(0.5) ? u(11, 20) : u(18, 38), front = -sign(side) * 0.5 * deep, out = -sign(side);
  const Transform t = footing(s, sign(side) * (d + 0.5 * deep));
  const double ground = ground_z(s, sign(side) * d) - t.translation().z();
  const Vec3f tints[6] = {{0.5f, 0.46f, 0.4f},   {0.34f, 0.16f, 0.11f}, {0.5f, 0.5f, 0.5f},
                          {0.16f, 0.17f, 0.19f}, {0.6f, 0.56f, 0.48f},  {0.42f, 0.3f, 0.22f}};
  Material wall;
  wall.pattern = Pattern::facade, wall.albedo = tints[random_.below(6)] * f(0.6, 1.1);
  wall.second = chance(0.4) ? Vec3f(0.05f, 0.09f, 0.12f) : Vec3f(0.035f, 0.04f, 0.05f);
  wall.variant = random_.next_u32(), wall.lidar = 0.35f;
  wall.foot = static_cast<float>(t.translation().z() + ground);
  Mesh body, glass, ledge;
  add_box(body, {-0.5 * along, -0.5 * deep, ground - 2}, {0.5 * along, 0.5 * deep, ground + h});
  add(moved(body, t), wall);
  const double y = front + out * 0.03;
  for (double x = -0.5 * along + 0.5; x < 0.5 * along - 2; x += 3.2)
    add_quad(glass, {x, y, ground + 0.3}, {x + 2.6, y, ground + 0.3}, {x + 2.6, y, ground + 3.2},
             {x, y, ground + 3.2});
  for (double z : {3.4, h - 0.5})
    add_box(ledge, {-0.5 * along - 0.15, front, ground + z},
            {0.5 * along + 0.15, front + out * 0.35, ground + z + 0.4});
  add(moved(glass, t), plain(Vec3f(0.03f, 0.035f, 0.04f), 0.15f, 0.08f));
  add(moved(ledge, t), plain(wall.albedo * 0.8f, 0.35f));
}

// Things beside the road.

void AmericanStreet::line_with_houses(int side) {
  const double edge = half_[side] + pavement_[side], line = edge + front_[side];
  for (double s = -12; s < far_;) {
    const double along = u(10, 16), plot = along + u(3, 8), deep = u(8, 11);
    const double middle = s + 0.5 * along;
    if (!in_cross(middle, 0.5 * along + 3)) {
      const double drive = s + (chance(0.5) ? 2.2 : along - 2.2);
      add_house(middle, line, along, deep, side, drive);
      taken_.push_back(outline(middle, sign(side) * (line + 0.5 * deep), along, deep, yaw(middle)));
      if (chance(0.75) && s < 66 + ahead_)
        put(vehicle(kParkedDecoyShare),
            {.turn = (chance(0.75) ? 0.5 : -0.5) * kPi * sign(side),
             .d = sign(side) * (line - u(2.9, 3.6)),
             .s = drive + wobble(0.1)},
            0.1);
    }
    s += plot;
  }
  if (chance(0.3)) {
    const double s = u(-5, 25);
    add_fence(s, s + u(8, 25), sign(side) * (edge + 0.4));
  }
  for (double s = u(0, 10); s < 70 + ahead_; s += u(9, 22)) {  // trees on the lawns
    if (in_cross(s, 3)) continue;
    const BevBox box = outline(s, sign(side) * (edge + 2.5), 1, 1);
    if (!free(box)) continue;
    taken_.push_back(box);
    stand(make_tree(actors_, detail(s, 2.4, 1.2, 0.5)), s, sign(side) * (edge + 2.5), u(0, 6));
  }
  add_woods(side, line + u(16, 24));
}

void AmericanStreet::line_with_shops(int side) {
  const double edge = half_[side] + pavement_[side], line = edge + front_[side];
  for (double s = -10; s < far_;) {
    const double along = u(14, 34), deep = u(10, 16), middle = s + 0.5 * along;
    if (chance(0.82) && !in_cross(middle, 0.5 * along + 4)) {
      add_shop(middle, line, along, deep, side);
      taken_.push_back(outline(middle, sign(side) * (line + 0.5 * deep), along, deep, yaw(middle)));
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
      put(vehicle(kParkedDecoyShare),
          {.turn = (chance(0.8) ? 0.5 : -0.5) * kPi * sign(side),
           .d = sign(side) * row + wobble(0.15),
           .s = s + 1.4},
          0.1);
  }
  add(lines, plain(Vec3f::Constant(f(0.35, 0.6)), 0.6f));
  for (double s = u(0, 25); s < 90; s += u(22, 60)) {
    if (in_cross(s, 4)) continue;
    stand(american::make_pylon(actors_), s, sign(side) * (edge + 0.9));
  }
  // A low hedge or young trees on the strip between walk and car park.
  if (chance(0.4))
    for (double s = u(0, 6); s < 75 + ahead_; s += u(9, 14)) {
      if (in_cross(s, 4) || !free(outline(s, sign(side) * (edge + 0.8), 1, 1))) continue;
      stand(make_tree(actors_, detail(s, 2.0, 1.0, 0.4)), s, sign(side) * (edge + 0.8), u(0, 6));
    }
  add_woods(side, line + u(24, 40));
}

void AmericanStreet::line_with_offices(int side) {
  const double line = half_[side] + pavement_[side] + front_[side];
  for (double s = -10; s < far_;) {
    const double along = u(16, 40), deep = u(14, 20), middle = s + 0.5 * along;
    if (chance(0.88) && !in_cross(middle, 0.5 * along + 2)) {
      add_office(middle, line, along, deep, side);
      taken_.push_back(outline(middle, sign(side) * (line + 0.5 * deep), along, deep, yaw(middle)));
    }
    s += along + (chance(0.6) ? 0.05 : u(3, 10));
  }
  if (chance(0.5))
    for (double s = u(2, 10); s < 70 + ahead_; s += u(9, 14))
      if (!in_cross(s, 4))
        stand(make_tree(actors_, detail(s, 2.0, 1.0, 0.4)), s, sign(side) * (half_[side] + 1.0), u(0, 6));
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
      put(american::make_kerb_item(actors_),
          {.turn = (side ? 1 : -1) * 0.5 * kPi,
           .d = sign(side) * (half_[side] + std::max(0.6, pavement_[side] - 0.5)),
           .s = s},
          0.1);
  }
  if (kind_ == Kind::suburb && verge_[side] > 0.8 && chance(0.5))
    for (double s = u(2, 10); s < 75 + ahead_; s += u(9, 14)) {
      const double d = sign(side) * (half_[side] + 0.5 * verge_[side]);
      if (!in_cross(s, 4) && free(outline(s, d, 0.6, 0.6)))
        stand(make_tree(actors_, detail(s, 2.4, 1.2, 0.5)), s, d, u(0, 6));
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
  add(wires, plain(Vec3f::Constant(0.025f), 0.1f));
}

void AmericanStreet::place_people() {
  const int count = kind_ == Kind::downtown ? random_.below(8) : random_.below(4);
  for (int i = 0; i < count; ++i) {
    const int side = random_.below(2);
    const double s = u(6, 45);
    if (chance(0.25))
      put(make_cyclist(actors_),
          {.turn = side ? kPi : 0, .d = sign(side) * (half_[side] - u(0.4, 1.2)), .s = s}, 0.1);
    else if (cross_s_ < 45 && chance(0.3))  // on the near crosswalk
      put(make_pedestrian(actors_),
          {.turn = (chance(0.5) ? 0.5 : -0.5) * kPi,
           .d = u(-half_[0], half_[1]),
           .s = cross_s_ - cross_half_ - u(1.0, 3.2)},
          0.1);
    else
      put(make_pedestrian(actors_),
          {.turn = chance(0.8) ? (chance(0.5) ? 0 : kPi) + wobble(0.1) : u(-kPi, kPi),
           .d = sign(side) * (half_[side] + u(std::max(0.4, verge_[side]), pavement_[side])),
           .s = s},
          0.1);
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
    const double tall = u(2, 4.5), wide = u(2.5, 4), deep = u(2.5, 4);
    const Vec3d radii(deep, wide, tall), middle = p + Vec3d(0, 0, u(2, 4));
    append(crowns, ellipsoid(0.8 * radii), at(middle.x(), middle.y(), middle.z()));
    add_leaves(leaves, middle, radii, 160, 0.45, random_);
  }
  Material m = plain(Vec3f(0.03f, 0.055f, 0.02f), 0.35f);
  m.pattern = Pattern::foliage, m.second = Vec3f(0.06f, 0.09f, 0.03f), m.variant = random_.next_u32();
  add(leaves, m);
  m.albedo *= 0.5f, m.second *= 0.5f;
  add(crowns, m);
}

}  // namespace

std::unique_ptr<StreetSite> american_street(std::uint64_t seed, std::uint64_t index, double height) {
  return std::make_unique<AmericanStreet>(seed, index, height);
}

}  // namespace mirage::generator
