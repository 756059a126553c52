#include "generator/street_site.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "base/sizes.h"
#include "generator/parts.h"
#include "geometry/mesh.h"

namespace mirage::generator {

bool on_roof(const Surface& surface, const Placed& placed) {
  const double top = placed.box.bottom + placed.box.height;
  return std::any_of(surface.mesh.vertices.begin(), surface.mesh.vertices.end(),
                     [&](const Vec3d& v) { return v.z() > top + 0.01; });
}

Street StreetSite::build(double behind) {
  choose_layout();
  behind_ = ahead_ = behind;
  far_ = kFar + behind;
  if (behind > 0 && cross_s_ < kFar && chance(0.5)) cross_s_ += behind;  // before us, or behind
  lay_ground();
  place_traffic();
  furnish();
  return finish();
}

MovingStreet StreetSite::build_moving(double seconds) {
  choose_layout();
  widen(seconds);
  lay_ground();
  drive(seconds);
  furnish();
  moving_.standing = finish();
  return std::move(moving_);
}

Street StreetSite::finish() {
  Street out;
  for (Surface& s : surfaces_)
    if (!s.mesh.faces.empty()) out.surfaces.push_back(std::move(s));
  out.placed = std::move(placed_);
  return out;
}

// Plants, fences and ground that every look uses.

void StreetSite::add_fence(double s0, double s1, double d) {
  const int style = random_.below(5);
  const double h = u(0.8, 1.9);
  Mesh mesh, leaves;
  Material m = plain(Vec3f::Constant(f(0.03, 0.3)), 0.3f);
  const auto panel = [&](double a, double b, double low, double high) {
    add_quad(mesh, on_ground(a, d, low), on_ground(b, d, low), on_ground(b, d, high), on_ground(a, d, high));
  };
  for (double s = s0; s < s1; s += 2) {
    if (in_cross(s, 3)) continue;
    const double e = std::min(s + 2, s1);
    if (style >= 3) {  // clipped hedge
      for (double side : {-0.3, 0.3}) {
        add_quad(mesh, on_ground(s, d + side), on_ground(e, d + side), on_ground(e, d + side, h - 0.06),
                 on_ground(s, d + side, h - 0.06));
        for (int i = 0; i < (away(s) < 30 ? 160 : 50); ++i) {
          const double up = u(0.02, 1.02) * h, across = d + side * u(0.9, 1.15);
          add_leaves(leaves, on_ground(u(s, e), across, up), {0.04, 0.04, 0.04}, 1,
                     away(s) < 30 ? 0.06 : 0.11, random_);
        }
      }
      add_quad(mesh, on_ground(s, d - 0.3, h - 0.06), on_ground(e, d - 0.3, h - 0.06),
               on_ground(e, d + 0.3, h - 0.06), on_ground(s, d + 0.3, h - 0.06));
      continue;
    }
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
  if (style >= 3) {
    m.pattern = Pattern::foliage, m.albedo = Vec3f(f(0.025, 0.05), f(0.05, 0.09), 0.018f);
    m.second = Vec3f(f(0.05, 0.09), f(0.08, 0.13), 0.025f), m.variant = random_.next_u32();
    add(leaves, m);
    m.albedo *= 0.4f, m.second *= 0.4f;
  }
  add(mesh, m);
}

void StreetSite::add_woods(int side, double from) {
  Mesh leaves, trunks, cores;
  for (double s = -5; s < far_ + 10; s += 3) {
    if (in_cross(s, 2)) continue;
    for (int k = 0; k < 2; ++k) {
      const double d = sign(side) * (from + u(0, 10));
      const Vec3d p = on_ground(s, d);
      const double h = u(4, 12);
      const int count = away(s) < 15 ? 1300 : away(s) < 40 ? 600 : 180;
      const double size = away(s) < 15 ? 0.11 : away(s) < 40 ? 0.17 : 0.34;
      const Vec3d crown = p + Vec3d(0, 0, 0.55 * h);
      add_leaves(leaves, crown, {2.4, 2.4, 0.48 * h}, count, size, random_);
      append(cores, ellipsoid({1.3, 1.3, 0.3 * h}), at(crown.x(), crown.y(), crown.z()));
      if (away(s) < 40) append(trunks, cylinder(u(0.08, 0.2), 0.7 * h, 7), at(p.x(), p.y(), p.z()));
    }
  }
  Material m = plain(Vec3f(f(0.03, 0.06), f(0.055, 0.1), 0.02f), 0.35f);
  m.pattern = Pattern::foliage, m.second = Vec3f(f(0.06, 0.14), f(0.09, 0.13), 0.03f),
  m.variant = random_.next_u32();
  add(leaves, m);
  m.albedo *= 0.35f, m.second *= 0.35f;
  add(cores, m);
  add(trunks, plain(Vec3f(0.07f, 0.055f, 0.045f), 0.3f));
}

void StreetSite::add_ground() {
  Mesh earth;
  for (double d = -80; d < 79; d += 8) add_strip(earth, d, d + 8, -12, far_ + 30, 4, -0.35);
  add(earth, plain(Vec3f(0.07f, 0.065f, 0.05f), 0.3f));
}

void StreetSite::add_manhole_covers(int count) {
  Mesh covers;
  for (int i = 0; i < count; ++i) {
    const double d = 0.8 * u(-half_[0], half_[1]);
    const Vec3d p = on_ground(u(4, 40), d, 0.006);
    append(covers, cylinder(0.32, 0.004, 18), at(p.x(), p.y(), p.z()));
  }
  add(covers, plain(Vec3f::Constant(0.045f), 0.2f));
}

// Poles, lamps, European road signs and traffic lights. All of them face −x: oncoming traffic reads them.

namespace {

using namespace sign_color;

void european_sign(Actor& pole, double x, double z, RandomStream& random) {
  SignBoard sign(pole, x, z);
  const double r = random.uniform(0.30, 0.42);
  const int kind = random.below(8);
  const auto back = [&](int corners, double radius, double turn) {
    sign.polygon(corners, radius, turn, kGrey, 0.012);
  };
  switch (kind) {
    case 0:  // warning
    case 1:  // give way
      back(3, 1.25 * r, kind * kPi), sign.polygon(3, 1.25 * r, kind * kPi, kRed);
      sign.polygon(3, 0.85 * r, kind * kPi, kWhite);
      if (kind == 0) sign.bar(-0.035, -0.15 * r, 0.035, 0.4 * r, kBlack);
      break;
    case 2:  // speed limit
      back(24, r, 0), sign.polygon(24, r, 0, kRed), sign.polygon(24, 0.78 * r, 0, kWhite);
      for (double y : {0.08 * r, -0.52 * r}) {
        sign.bar(y, -0.4 * r, y + 0.42 * r, 0.4 * r, kBlack);
        sign.bar(y + 0.14 * r, -0.26 * r, y + 0.28 * r, 0.26 * r, kWhite);
      }
      break;
    case 3:  // no parking
      back(24, r, 0), sign.polygon(24, r, 0, kRed), sign.polygon(24, 0.82 * r, 0, kBlue);
      sign.slanted_bar(1.7 * r, 0.16 * r, 0.25 * kPi, kRed);
      break;
    case 4:  // no entry
      back(24, r, 0), sign.polygon(24, r, 0, kRed), sign.bar(-0.7 * r, -0.13 * r, 0.7 * r, 0.13 * r, kWhite);
      break;
    case 5:  // priority road
      back(4, r, 0), sign.polygon(4, r, 0, kWhite), sign.polygon(4, 0.78 * r, 0, kYellow);
      break;
    case 6:  // stop
      back(8, r, kPi / 8), sign.polygon(8, r, kPi / 8, kRed);
      for (int i = 0; i < 4; ++i)
        sign.bar((-0.68 + 0.36 * i) * r, -0.2 * r, (-0.44 + 0.36 * i) * r, 0.2 * r, kWhite);
      break;
    default:  // parking
      back(4, 1.3 * r, 0.25 * kPi), sign.polygon(4, 1.3 * r, 0.25 * kPi, kBlue);
      sign.bar(0.12 * r, -0.6 * r, 0.34 * r, 0.6 * r, kWhite);
      sign.bar(-0.34 * r, 0.0, 0.12 * r, 0.6 * r, kWhite),
          sign.bar(-0.12 * r, 0.18 * r, 0.12 * r, 0.42 * r, kBlue);
  }
}

std::unique_ptr<StreetSite> site_of(std::uint64_t seed, std::uint64_t index, double height, Look look) {
  return look == Look::american ? american_street(seed, index, height) : european_street(seed, index, height);
}

constexpr double kApart = 0.35;  // m between the boxes of two movers, to each side
constexpr int kTries = 60;       // courses drawn for a mover before it is left out

}  // namespace

Street make_street(std::uint64_t seed, std::uint64_t index, double height, Look look, double behind) {
  return site_of(seed, index, height, look)->build(behind);
}

MovingStreet make_moving_street(std::uint64_t seed, std::uint64_t index, double height, Look look,
                                double seconds) {
  return site_of(seed, index, height, look)->build_moving(seconds);
}

Actor make_pole(RandomStream& random) {
  Actor pole;
  const double h = random.uniform(2.4, 8), r = h < 4 ? 0.035 : random.uniform(0.05, 0.09);
  Mesh post = cylinder(r, h, 10), board;
  if (h < 4) {
    european_sign(pole, -r - 0.01, h - 0.38, random);
  } else if (random.uniform() < 0.6) {
    add_box(post, {-0.05, -0.04, h - 0.1}, {1.3, 0.04, h});  // street lamp's arm
    add_box(board, {0.8, -0.12, h - 0.05}, {1.5, 0.12, h + 0.08});
  }
  pole.add(post, plain(Vec3f::Constant(static_cast<float>(random.uniform(0.08, 0.4))), 0.35f, 0.02f));
  if (!board.faces.empty()) pole.add(board, plain(Vec3f::Constant(0.5f), 0.3f, 0.01f));
  return pole;
}

void add_signal_lamps(Actor& actor, Mesh& hoods, const SignalLamps& lamps, int lit) {
  const std::array<Vec3f, 3> dark = {Vec3f(0.10f, 0.01f, 0.01f), Vec3f(0.12f, 0.07f, 0.01f),
                                     Vec3f(0.01f, 0.08f, 0.05f)},
                             bright = {Vec3f(3.0f, 0.12f, 0.08f), Vec3f(3.0f, 1.3f, 0.05f),
                                       Vec3f(0.1f, 2.6f, 1.1f)};
  const double x = lamps.highest.x(), y = lamps.highest.y(), r = lamps.hood;
  for (std::size_t k = 0; k < 3; ++k) {
    const double z = lamps.highest.z() - lamps.apart * static_cast<double>(k);
    const Transform pose(Eigen::Translation3d(x - 0.005, y, z) *
                         Eigen::AngleAxisd(-0.5 * kPi, Vec3d::UnitY()));
    Material glass = plain(dark[k], 0.3f, 0.03f);
    if (static_cast<int>(k) == lit) glass.emission = bright[k];
    actor.add(moved(cylinder(lamps.lens, 0.01, 18), pose), glass);
    for (int i = 0; i < 6; ++i) {
      const double a = kPi * i / 6, b = kPi * (i + 1) / 6;
      const Vec3d p(x, y + r * std::cos(a), z + r * std::sin(a)),
          q(x, y + r * std::cos(b), z + r * std::sin(b)), out(lamps.hood_long, 0, 0);
      add_quad(hoods, p, q, q - out, p - out);
    }
  }
}

Actor make_traffic_light(RandomStream& random, int lit) {
  Actor light;
  const double foot = random.uniform(2.1, 2.5);
  Mesh housing;
  add_box(housing, {-0.30, -0.16, foot}, {-0.07, 0.16, foot + 0.96});
  add_signal_lamps(light, housing, {{-0.30, 0, foot + 0.80}, 0.32, 0.11, 0.13, 0.17}, lit);
  light.add(cylinder(0.06, foot + 1.0, 12), plain(sign_color::kGrey, 0.35f, 0.02f));
  light.add(housing, plain(Vec3f::Constant(0.02f), 0.15f, 0.02f));
  return light;
}

Transform Waypoint::pose() const {
  return at(position.x(), position.y(), position.z(), yaw);
}

std::size_t MovingStreet::step(double time) const {
  const auto k = as_size(std::lround(std::max(0.0, time) / kWayStep));
  return std::min(k, own.size() - 1);
}

std::vector<Surface> MovingStreet::surfaces_of(std::size_t mover, double time) const {
  const Transform pose = movers[mover].way[step(time)].pose();
  std::vector<Surface> surfaces = movers[mover].actor.surfaces;
  for (Surface& surface : surfaces) {
    surface.mesh = moved(std::move(surface.mesh), pose);
    surface.object = static_cast<int>(standing.placed.size() + mover);
  }
  return surfaces;
}

Street MovingStreet::at(double time) const {
  Street street = standing;
  for (std::size_t k = 0; k < movers.size(); ++k) {
    const Waypoint& now = movers[k].way[step(time)];
    const Vec3d& size = movers[k].actor.size;
    street.placed.push_back(
        {movers[k].actor.type,
         {{now.position.x(), now.position.y(), size.x(), size.y(), now.yaw}, now.position.z(), size.z()},
         movers[k].actor.kind});
    for (Surface& surface : surfaces_of(k, time)) street.surfaces.push_back(std::move(surface));
  }
  return street;
}

Way StreetSite::way_of(const Course& course, double seconds, double lift) const {
  const auto steps = as_size(std::lround(seconds / kWayStep)) + 1;
  Way way(steps);
  double s = course.s, speed = course.speed;
  for (std::size_t k = 0; k < steps; ++k) {
    const double t = static_cast<double>(k) * kWayStep;
    const double change =
        std::clamp((t - course.change_from) / std::max(1e-9, course.change_lasts), 0.0, 1.0);
    const double d = course.d + (course.d_to - course.d) * change * change * (3 - 2 * change);
    const double sideways = change > 0 && change < 1
                                ? (course.d_to - course.d) * 6 * change * (1 - change) / course.change_lasts
                                : 0;
    Waypoint& now = way[k];
    const double along = course.crosses ? d : s, across = course.crosses ? s : d;
    const Vec2d p = xy(along, across);
    now.position = Vec3d(p.x(), p.y(), ground_z(along, across) + lift);
    const double lane = yaw(along) + (course.crosses ? 0.5 * kPi : 0) + (course.speed < 0 ? kPi : 0);
    now.yaw = std::remainder(
        lane + (speed != 0 ? std::atan2(sideways, std::abs(speed)) * (speed < 0 ? -1 : 1) : 0), 2 * kPi);
    // The middle of the step's speeds carries the place on.
    const double before = speed;
    if (t >= course.brake_from) {
      const double slower = std::max(course.slowest, std::abs(speed) - course.brake * kWayStep);
      speed = std::copysign(std::min(slower, std::abs(speed)), course.speed);
    }
    s += 0.5 * (before + speed) * kWayStep;
  }
  for (std::size_t k = 0; k < steps; ++k) {
    const std::size_t a = k > 0 ? k - 1 : 0, b = std::min(k + 1, steps - 1);
    const double dt = static_cast<double>(b - a) * kWayStep;
    way[k].velocity = (way[b].position - way[a].position) / dt;
    way[k].yaw_rate = std::remainder(way[b].yaw - way[a].yaw, 2 * kPi) / dt;
  }
  return way;
}

void StreetSite::widen(double seconds) {
  heading_ = 0;
  if (lanes_[0] < 2) {
    lanes_[0] = 2;
    half_[0] += lane_;
  }
  ego_d_ = -0.5 * turn_lane_ - 1.5 * lane_ + 0.15 * random_.normal();
  own_speed_ = std::min(u(5, 12), 60 / seconds);
  ahead_ = own_speed_ * seconds;
  far_ = kFar + ahead_;
  if (!(cross_s_ < far_)) cross_s_ = 1e9;
  if (cross_s_ > far_ || cross_s_ < 25) cross_s_ = u(30, 45) + 0.5 * ahead_;
}

void StreetSite::drive(double seconds) {
  const double left_lane = lane_d(0, 0), oncoming_lane = lane_d(1, lanes_[1] - 1);
  const auto box_at = [](const Waypoint& at, const Vec3d& size, double margin) {
    return BevBox{at.position.x(), at.position.y(), size.x() + 2 * margin, size.y() + 2 * margin, at.yaw};
  };
  const Vec3d own_size(7, 2.2, 0);  // with the way to its nose
  Course leader{.s = u(13, 26), .speed = own_speed_ + wobble(0.3), .d = ego_d_ + wobble(0.2)};
  leader.brake_from = u(0.15, 0.45) * seconds, leader.brake = u(2, 4.5);
  leader.slowest = u(0, 0.4) * own_speed_, leader.d_to = leader.d;
  Course own{.s = 0, .speed = own_speed_, .d = ego_d_, .d_to = ego_d_};
  own.brake_from = leader.brake_from + 1, own.brake = leader.brake, own.slowest = leader.slowest;
  moving_.own = way_of(own, seconds, height_);

  const auto meets = [&](const Way& way, const Vec3d& size) {
    constexpr std::size_t kEach = 5;
    for (std::size_t k = 0; k < way.size(); k += kEach) {
      const BevBox box = box_at(way[k], size, kApart);
      if (intersection_area(box, box_at(moving_.own[k], own_size, 0)) > 0) return true;
      for (const Mover& other : moving_.movers)
        if (intersection_area(box, box_at(other.way[k], other.actor.size, kApart)) > 0) return true;
    }
    return false;
  };
  const auto add = [&](const std::string& role, const auto& course_of) {
    Actor actor = vehicle(0);
    for (int i = 0; i < kTries; ++i) {
      Way way = way_of(course_of(i), seconds, 0);
      if (meets(way, actor.size)) continue;
      moving_.movers.push_back({role, std::move(actor), std::move(way)});
      return;
    }
  };
  add("brakes", [&](int i) {
    leader.s += i > 0 ? 1 : 0;
    return leader;
  });
  add("overtakes", [&](int i) {
    Course course{.s = u(-16, -7), .speed = own_speed_ + u(3.5, 7), .d = left_lane + wobble(0.2)};
    course.d_to = course.d;
    if (i < kTries / 2)
      course.d_to = ego_d_, course.change_from = u(0.4, 0.9) * seconds, course.change_lasts = u(2, 3);
    return course;
  });
  add("crosses", [&](int) {
    const double side = chance(0.5) ? 1 : -1;
    // Along the crossing street: `s` runs to our left.
    Course course{.s = -side * u(10, 35), .speed = side * u(4, 9), .d = cross_s_ + side * 0.5 * cross_half_};
    course.crosses = true, course.d_to = course.d;
    return course;
  });
  const auto towards = [&](int) {
    Course course{.s = u(25, 75) + ahead_, .speed = -u(6, 13), .d = oncoming_lane + wobble(0.25)};
    course.d_to = course.d;
    return course;
  };
  for (int i = 1 + random_.below(3); i > 0; --i) add("towards", towards);
  for (int i = random_.below(3); i > 0; --i)
    add("keeps", [&](int) {
      const double lane = chance(0.7) ? left_lane : ego_d_;
      Course course{.s = u(18, 60), .speed = own_speed_ + u(-1, 3), .d = lane + wobble(0.25)};
      course.d_to = course.d;
      return course;
    });
  // Nothing stands where something drives.
  constexpr std::size_t kEach = 12;
  for (std::size_t k = 0; k < moving_.own.size(); k += kEach) {
    taken_.push_back(box_at(moving_.own[k], own_size, 0.15));
    for (const Mover& mover : moving_.movers) taken_.push_back(box_at(mover.way[k], mover.actor.size, 0.2));
  }
}

}  // namespace mirage::generator
