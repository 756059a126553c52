#include "scene/generator/street.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "geometry/shapes.h"

namespace mirage::generator {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kFar = 110;    // m of street that is built
constexpr double kKerb = 0.11;  // m

enum class Kind { residential, avenue, rural, crossing, square };

// Street coordinates: s along the centre line (0 at the ego vehicle), d to its left.
class Builder {
 public:
  Builder(std::uint64_t seed, std::uint64_t index, double height)
      : random_(seed, "street", index), actors_(seed, "street actors", index), height_(height) {}

  Street build() {
    choose();
    lay_ground();
    place_vehicles();
    place_edges();
    place_people();
    Street out;
    for (Surface& s : surfaces_)
      if (!s.mesh.faces.empty()) out.surfaces.push_back(std::move(s));
    out.placed = std::move(placed_);
    return out;
  }

 private:
  double u(double a, double b) { return random_.uniform(a, b); }
  bool chance(double p) { return random_.uniform() < p; }
  float f(double a, double b) { return static_cast<float>(random_.uniform(a, b)); }

  void choose() {
    const double pick = random_.uniform();
    kind_ = pick < 0.42   ? Kind::residential
            : pick < 0.62 ? Kind::avenue
            : pick < 0.74 ? Kind::rural
            : pick < 0.9  ? Kind::crossing
                          : Kind::square;
    lane_ = u(2.9, 3.6);
    lanes_left_ = kind_ == Kind::avenue && chance(0.4) ? 2 : 1;
    lanes_right_ = kind_ == Kind::avenue && chance(0.5) ? 2 : 1;
    const double parking = kind_ == Kind::residential ? 0.85
                           : kind_ == Kind::crossing  ? 0.5
                           : kind_ == Kind::avenue    ? 0.35
                           : kind_ == Kind::square    ? 0.9
                                                      : 0.05;
    for (int side = 0; side < 2; ++side) {
      strip_[side] = chance(parking) ? (chance(kind_ == Kind::square ? 0.7 : 0.15) ? 5.0 : u(2.0, 2.4)) : 0;
      half_[side] = lane_ * (side ? lanes_left_ : lanes_right_) + strip_[side] + u(0.0, 0.4);
      pavement_[side] = kind_ == Kind::rural ? 0 : u(1.5, 4.0);
      front_[side] = kind_ == Kind::residential ? (chance(0.5) ? u(0, 1) : u(2, 7))
                     : kind_ == Kind::rural     ? u(4, 12)
                                                : u(2, 12);
    }
    heading_ = 0.02 * random_.normal();
    curvature_ = chance(0.4) ? 0.0025 * random_.normal() : 0;
    ego_d_ = -0.5 * lane_ + 0.25 * random_.normal();
    if (lanes_right_ == 2 && chance(0.5)) ego_d_ -= lane_;
    slope_ = 0.010 * random_.normal();
    wave_ = 0.10 * random_.uniform(), wave_length_ = u(30, 80), wave_phase_ = u(0, 2 * kPi);
    cross_s_ = kind_ == Kind::crossing || chance(0.15) ? u(14, 45) : 1e9;
    cross_half_ = u(3, 6);
  }

  Vec2d xy(double s, double d) const {
    // A shallow arc: heading θ0 + κ s.
    const double a = heading_ + curvature_ * s, m = heading_ + 0.5 * curvature_ * s;
    const Vec2d centre =
        -ego_d_ * Vec2d(-std::sin(heading_), std::cos(heading_)) + s * Vec2d(std::cos(m), std::sin(m));
    return centre + d * Vec2d(-std::sin(a), std::cos(a));
  }
  double yaw(double s) const { return heading_ + curvature_ * s; }
  double road_z(double s, double d) const {
    const auto wave = [&](double t) { return wave_ * std::sin(2 * kPi * t / wave_length_ + wave_phase_); };
    return -height_ + slope_ * s + wave(s) - wave(0) - 0.018 * (std::abs(d) - std::abs(ego_d_));
  }
  bool in_cross(double s, double margin = 0) const { return std::abs(s - cross_s_) < cross_half_ + margin; }
  double ground_z(double s, double d) const {
    const double edge = half_[d > 0];
    double z = road_z(s, std::clamp(d, -half_[0], half_[1]));
    if (std::abs(d) > edge + 0.05 && !in_cross(s)) {
      z += kind_ == Kind::rural ? 0.04 : kKerb;
      const double out = std::abs(d) - edge - pavement_[d > 0];
      if (out > 0)
        z += std::min(out, 25.0) * bank_[d > 0] + 0.06 * std::sin(0.7 * s + d) * std::min(1.0, out);
    }
    return z;
  }
  Vec3d on_ground(double s, double d, double lift = 0) const {
    const Vec2d p = xy(s, d);
    return {p.x(), p.y(), ground_z(s, d) + lift};
  }

  void add_strip(Mesh& mesh, double d0, double d1, double s0, double s1, double step, double lift = 0) {
    for (double s = s0; s < s1 - 1e-6; s += step) {
      const double e = std::min(s + step, s1);
      add_quad(mesh, on_ground(s, d0, lift), on_ground(e, d0, lift), on_ground(e, d1, lift),
               on_ground(s, d1, lift));
    }
  }

  void lay_ground() {
    for (double& bank : bank_) bank = chance(0.35) ? u(-0.03, 0.12) : 0;
    Material tar = plain(Vec3f(1, 1, 1.03f) * f(0.065, 0.15), f(0.16, 0.32));
    tar.pattern = Pattern::asphalt, tar.variant = random_.next_u32();
    Mesh road;
    add_strip(road, -half_[0], half_[1], -12, kFar, 2);
    if (cross_s_ < kFar)
      for (int side : {-1, 1})
        for (double s = cross_s_ - cross_half_; s < cross_s_ + cross_half_ - 0.1; s += cross_half_ / 3)
          for (double d = half_[side > 0]; d < 60; d += 6) {
            const double e = std::min(s + cross_half_ / 3, cross_s_ + cross_half_);
            add_quad(road, on_ground(s, side * d), on_ground(e, side * d), on_ground(e, side * (d + 6)),
                     on_ground(s, side * (d + 6)));
          }
    surfaces_.push_back(surface(road, tar));

    Material stone = plain(Vec3f(1.0f, 0.97f, 0.92f) * f(0.12, 0.28), f(0.25, 0.4));
    stone.pattern = Pattern::paving, stone.variant = random_.next_u32();
    Material lawn = plain(Vec3f(f(0.03, 0.06), f(0.05, 0.10), 0.018f), 0.4f);
    lawn.pattern = Pattern::grass, lawn.second = Vec3f(f(0.07, 0.15), f(0.08, 0.13), 0.035f),
    lawn.variant = random_.next_u32();
    Material kerb = plain(Vec3f::Constant(f(0.2, 0.36)), 0.3f);
    Mesh pavement, grass, kerbs;
    const bool green = kind_ == Kind::rural || kind_ == Kind::avenue || chance(0.5);
    for (int side : {0, 1}) {
      const double sign = side ? 1 : -1, edge = half_[side], outer = edge + pavement_[side];
      for (int piece = 0; piece < 2; ++piece) {
        double s0 = piece == 0 ? -12 : cross_s_ + cross_half_,
               s1 = piece == 0 ? std::min(kFar, cross_s_ - cross_half_) : kFar;
        if (s1 <= s0) continue;
        s0 += 0.01, s1 -= 0.01;
        const auto lay = [&](Mesh& mesh, double a, double b, double step) {
          // Wound upwards on either side.
          if (sign > 0)
            add_strip(mesh, a, b, s0, s1, step);
          else
            add_strip(mesh, -b, -a, s0, s1, step);
        };
        if (kind_ != Kind::rural) {
          lay(kerbs, edge + 0.06, edge + 0.2, 3);
          for (double s = s0; s < s1; s += 3) {
            const double e = std::min(s + 3, s1), z = 0.05 - kKerb;
            add_quad(kerbs, on_ground(s, sign * edge), on_ground(e, sign * edge),
                     on_ground(e, sign * (edge + 0.06), 0), on_ground(s, sign * (edge + 0.06), 0));
            (void)z;
          }
          lay(pavement, edge + 0.2, outer, 2);
        }
        lay(green ? grass : pavement, outer, outer + 6, 2);
        lay(green ? grass : pavement, outer + 6, outer + 24, 4);
        lay(grass, outer + 24, outer + 80, 8);
      }
    }
    surfaces_.push_back(surface(pavement, stone));
    surfaces_.push_back(surface(grass, lawn));
    surfaces_.push_back(surface(kerbs, kerb));

    Mesh paint;
    const double mark = 0.12;
    if (kind_ != Kind::residential || chance(0.3)) {
      const auto dashes = [&](double d, double on, double off) {
        for (double s = -10 + u(0, 6); s < kFar; s += on + off)
          if (!in_cross(s, on)) add_strip(paint, d - 0.5 * mark, d + 0.5 * mark, s, s + on, 2, 0.008);
      };
      const auto solid = [&](double d) {
        for (double s = -10; s < kFar; s += 2)
          if (!in_cross(s, 2)) add_strip(paint, d - 0.5 * mark, d + 0.5 * mark, s, s + 2, 2, 0.008);
      };
      if (chance(0.8))
        dashes(0, u(2.5, 4), u(3, 6));
      else
        solid(0);
      for (int k = 1; k < lanes_left_; ++k) dashes(k * lane_, 3, 6);
      for (int k = 1; k < lanes_right_; ++k) dashes(-k * lane_, 3, 6);
      if (kind_ == Kind::rural || kind_ == Kind::avenue) {
        solid(lanes_left_ * lane_ - 0.1);
        solid(-lanes_right_ * lane_ + 0.1);
      }
    }
    if (cross_s_ < kFar && chance(0.7)) {
      const double s = cross_s_ - cross_half_ - 1.2;
      add_strip(paint, -lanes_right_ * lane_ + 0.2, -0.2, s, s + 0.5, 1, 0.008);
      if (chance(0.5))
        for (double d = -half_[0] + 0.4; d < half_[1] - 0.4; d += 1.0)
          add_strip(paint, d, d + 0.5, s - 4.2, s - 1.2, 2, 0.008);
    }
    surfaces_.push_back(surface(paint, plain(Vec3f::Constant(f(0.4, 0.7)), 0.75f)));
  }

  // Stands an actor at (s, d), heading `turn` from the street's; false where it would overlap another.
  bool put(Actor actor, double s, double d, double turn, double margin = 0.25) {
    const Vec2d p = xy(s, d);
    const double heading = yaw(s) + turn, z = ground_z(s, d);
    const BevBox box{p.x(), p.y(), actor.size.x() + 2 * margin, actor.size.y() + 2 * margin, heading};
    if (intersection_area(box, BevBox{-0.3, 0, 7, 2.6, 0}) > 0) return false;  // the ego vehicle
    for (const BevBox& other : taken_)
      if (intersection_area(box, other) > 0) return false;
    taken_.push_back(box);
    int object = -1;
    if (!actor.type.empty()) {
      object = static_cast<int>(placed_.size());
      placed_.push_back({actor.type,
                         {{p.x(), p.y(), actor.size.x(), actor.size.y(), std::remainder(heading, 2 * kPi)},
                          z,
                          actor.size.z()}});
    }
    add_surfaces(actor, at(p.x(), p.y(), z, heading), object);
    return true;
  }

  void add_surfaces(Actor& actor, const Transform& velo_from_actor, int object) {
    for (Surface& s : actor.surfaces) {
      for (Vec3d& v : s.mesh.vertices) v = velo_from_actor * v;
      s.object = object;
      surfaces_.push_back(std::move(s));
    }
  }

  Actor vehicle() {
    const double pick = actors_.uniform();
    return pick < 0.93 ? make_car(actors_) : pick < 0.985 ? make_van(actors_) : make_truck(actors_);
  }

  void place_vehicles() {
    const auto wobble = [&](double sigma) { return sigma * random_.normal(); };
    const double flow = kind_ == Kind::avenue ? 0.8 : kind_ == Kind::rural ? 0.75 : 0.55;
    // Ahead in our own lane and in the next one.
    if (chance(flow)) {
      double s = u(7, 35);
      const int count = 1 + (chance(0.45) ? 1 + random_.below(2) : 0);
      for (int i = 0; i < count; ++i, s += u(7, 22)) put(vehicle(), s, ego_d_ + wobble(0.25), wobble(0.02));
    }
    if (lanes_right_ == 2)
      for (double s = u(3, 20); s < 65; s += u(8, 35)) {
        const double d = ego_d_ > -lane_ ? -1.5 * lane_ : -0.5 * lane_;
        put(vehicle(), s, d + wobble(0.25), wobble(0.02));
      }
    for (int lane = 0; lane < lanes_left_; ++lane)
      if (chance(flow))
        for (double s = u(4, 40); s < 66; s += u(8, 45))
          put(vehicle(), s, (lane + 0.5) * lane_ + wobble(0.3), kPi + wobble(0.03));
    if (cross_s_ < kFar) {
      const int count = random_.below(5);
      for (int i = 0; i < count; ++i) {
        const bool left = chance(0.5);
        put(vehicle(), cross_s_ + (left ? 0.5 : -0.5) * cross_half_ + wobble(0.4), u(-22, 22),
            (left ? 0.5 : -0.5) * kPi + wobble(0.12));
      }
      if (chance(0.4)) put(vehicle(), cross_s_ + wobble(2.0), u(-5, 5), u(-kPi, kPi));  // turning
    }
    for (int side : {0, 1}) {
      const double sign = side ? 1 : -1;
      if (strip_[side] == 0) continue;
      const double share = u(0.35, 0.95);
      const bool across = strip_[side] > 4, slanted = across && chance(0.4);
      const double slant = slanted ? u(0.5, 1.1) : 0.5 * kPi;
      const double d = sign * (half_[side] - 0.5 * strip_[side] + (across ? 0 : u(-0.1, 0.3)));
      for (double s = -4 + u(0, 5); s < 66; s += across ? u(2.4, 2.9) / std::sin(slant) : u(5.0, 6.3)) {
        if (!chance(share) || in_cross(s, 6)) continue;
        double turn = 0;
        if (across)
          turn = (chance(0.75) ? 1 : -1) * sign * slant;
        else
          turn = chance(side ? 0.7 : 0.12) ? kPi : 0;
        put(vehicle(), s, d + wobble(0.1), turn + wobble(0.025), 0.12);
      }
    }
    // Cars off the street: drives, yards, car parks.
    for (int side : {0, 1}) {
      const double sign = side ? 1 : -1;
      const int count = chance(0.45) ? 1 + random_.below(4) : 0;
      for (int i = 0; i < count; ++i)
        put(vehicle(), u(8, 60), sign * (half_[side] + pavement_[side] + u(2.5, 12)), u(-kPi, kPi), 0.3);
    }
  }

  void place_people() {
    const int count = kind_ == Kind::rural ? random_.below(2) : random_.below(5);
    for (int i = 0; i < count; ++i) {
      const int side = random_.below(2);
      const double sign = side ? 1 : -1;
      if (chance(0.25))
        put(make_cyclist(actors_), u(6, 50), sign * (half_[side] - u(0.3, 1.2)), side ? kPi : 0, 0.1);
      else
        put(make_pedestrian(actors_), u(5, 45),
            sign * (half_[side] + u(-0.5, std::max(0.5, pavement_[side]))), u(-kPi, kPi), 0.1);
    }
  }

  void place_edges();
  void add_building(double s, double d, double along, double deep, int side);
  void add_fence(double s0, double s1, double d);
  void add_woods(int side, double from);

  RandomStream random_, actors_;
  double height_;
  Kind kind_ = Kind::residential;
  double lane_ = 3, half_[2] = {4, 4}, strip_[2] = {}, pavement_[2] = {}, front_[2] = {}, bank_[2] = {};
  int lanes_left_ = 1, lanes_right_ = 1;
  double heading_ = 0, curvature_ = 0, ego_d_ = 0, slope_ = 0, wave_ = 0, wave_length_ = 50, wave_phase_ = 0;
  double cross_s_ = 1e9, cross_half_ = 4;
  std::vector<Surface> surfaces_;
  std::vector<Placed> placed_;
  std::vector<BevBox> taken_;
};

void Builder::add_building(double s, double d, double along, double deep, int side) {
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

void Builder::add_fence(double s0, double s1, double d) {
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

void Builder::add_woods(int side, double from) {
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

void Builder::place_edges() {
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
    if (kind_ != Kind::rural && front_[side] > 1.5 && chance(0.6)) {
      const double s = u(-5, 20);
      add_fence(s, s + u(8, 50), sign * (edge + 0.2));
    }
    // Street trees in a row, or a few anywhere.
    const bool row = chance(kind_ == Kind::avenue ? 0.75 : 0.35);
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

}  // namespace

Street make_street(std::uint64_t seed, std::uint64_t index, double height) {
  return Builder(seed, index, height).build();
}

}  // namespace mirage::generator
