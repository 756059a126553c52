#include "generator/moving_street.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "generator/looks/american.h"
#include "generator/looks/european.h"

namespace mirage::generator {
namespace {

constexpr double kApart = 0.35;  // m that two that drive keep between their boxes, to each side
constexpr int kTries = 60;       // courses drawn for one that drives before it is left out

}  // namespace

Transform Waypoint::pose() const {
  return at(position.x(), position.y(), position.z(), yaw);
}

std::size_t MovingStreet::step(double time) const {
  const auto k = static_cast<std::size_t>(std::lround(std::max(0.0, time) / kWayStep));
  return std::min(k, own.size() - 1);
}

std::vector<Surface> MovingStreet::surfaces_of(std::size_t mover, double time) const {
  const Transform pose = movers[mover].way[step(time)].pose();
  std::vector<Surface> surfaces = movers[mover].actor.surfaces;
  for (Surface& surface : surfaces) {
    for (Vec3d& v : surface.mesh.vertices) v = pose * v;
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
  const auto steps = static_cast<std::size_t>(std::lround(seconds / kWayStep)) + 1;
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

void StreetSite::widen(double seconds, int& own_lanes, double inner) {
  heading_ = 0;
  if (own_lanes < 2) {
    own_lanes = 2;
    half_[0] += lane_;
  }
  ego_d_ = -inner - 1.5 * lane_ + 0.15 * random_.normal();
  own_speed_ = std::min(u(5, 12), 60 / seconds);
  ahead_ = own_speed_ * seconds;
  far_ = kFar + ahead_;
  if (!(cross_s_ < far_)) cross_s_ = 1e9;
  if (cross_s_ > far_ || cross_s_ < 25) cross_s_ = u(30, 45) + 0.5 * ahead_;
}

void StreetSite::drive(double seconds, double left_lane, double oncoming_lane,
                       const std::function<Actor()>& vehicle) {
  const auto wobble = [&](double sigma) { return sigma * random_.normal(); };
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
    Actor actor = vehicle();
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

MovingStreet make_moving_street(std::uint64_t seed, std::uint64_t index, double height, Look look,
                                double seconds) {
  if (look == Look::american) return AmericanStreet(seed, index, height).build_moving(seconds);
  return EuropeanStreet(seed, index, height).build_moving(seconds);
}

}  // namespace mirage::generator
