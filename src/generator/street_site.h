// The ground that every look of a street is laid on: its course, its heights, and the placing of things. The
// looks (looks/european.cpp, looks/american.cpp) say what stands where.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "generator/street.h"

namespace mirage::generator {

inline constexpr double kFar = 110;    // m of street that is built
inline constexpr double kKerb = 0.11;  // m

/// A street that is being laid out. Street coordinates: s along the centre line (behind_ at the ego vehicle),
/// d to its left.
class StreetSite {
 public:
  virtual ~StreetSite() = default;
  /// Builds one moment of it; `behind`: length of street behind the ego vehicle (m).
  Street build(double behind);
  /// Builds some seconds of it.
  MovingStreet build_moving(double seconds);

 protected:
  /// Streams "PURPOSE" (the layout) and "PURPOSE actors" (the look of things) of (seed, index). `height`: of
  /// the `velo` origin over the road.
  StreetSite(std::uint64_t seed, const std::string& purpose, std::uint64_t index, double height)
      : random_(seed, purpose, index), actors_(seed, purpose + " actors", index), height_(height) {}

  /// Chooses the street: its course, its lanes and what lies beside them.
  virtual void choose_layout() = 0;
  /// Lays the ground, its markings, and the junction.
  virtual void lay_ground() = 0;
  /// Places things on the lanes.
  virtual void place_traffic() = 0;
  /// Places things everywhere else.
  virtual void furnish() = 0;
  /// A vehicle, or with probability `alike` something that looks like a car to a LiDAR.
  virtual Actor vehicle(double alike) = 0;

  double u(double a, double b) { return random_.uniform(a, b); }
  bool chance(double p) { return random_.uniform() < p; }
  float f(double a, double b) { return static_cast<float>(random_.uniform(a, b)); }
  double wobble(double sigma) { return sigma * random_.normal(); }

  /// The sign of d on a side: 0 is the right one, ours, and 1 the left.
  static double sign(int side) { return side ? 1 : -1; }
  /// Middle of a lane on a side, counted from the centre line.
  double lane_d(int side, int lane) const { return sign(side) * (0.5 * turn_lane_ + (lane + 0.5) * lane_); }

  Vec2d xy(double s, double d) const {
    // A shallow arc: heading θ0 + κ t, where t is 0 at the ego vehicle.
    const double t = s - behind_, a = heading_ + curvature_ * t, m = heading_ + 0.5 * curvature_ * t;
    const Vec2d centre =
        -ego_d_ * Vec2d(-std::sin(heading_), std::cos(heading_)) + t * Vec2d(std::cos(m), std::sin(m));
    return centre + d * Vec2d(-std::sin(a), std::cos(a));
  }
  double yaw(double s) const { return heading_ + curvature_ * (s - behind_); }
  /// How far along the street from the ego vehicle, or behind it.
  double away(double s) const { return std::abs(s - behind_); }
  /// A tree's detail at s: `near` within 22 m of the ego vehicle, `middle` within 40 m, else `distant`.
  double detail(double s, double near, double middle, double distant) const {
    return away(s) < 22 ? near : away(s) < 40 ? middle : distant;
  }
  double road_z(double s, double d) const {
    const auto wave = [&](double t) { return wave_ * std::sin(2 * kPi * t / wave_length_ + wave_phase_); };
    return -height_ + slope_ * (s - behind_) + wave(s - behind_) - wave(0) -
           0.018 * (std::abs(d) - std::abs(ego_d_));
  }
  bool in_cross(double s, double margin = 0) const { return std::abs(s - cross_s_) < cross_half_ + margin; }
  double ground_z(double s, double d) const {
    const double edge = half_[d > 0];
    double z = road_z(s, std::clamp(d, -half_[0], half_[1]));
    if (std::abs(d) > edge + 0.05 && !in_cross(s)) {
      z += kerb_;
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

  /// The outline of a thing of that size at (s, d); `heading`: from `velo`'s x.
  BevBox outline(double s, double d, double length, double width, double heading = 0) const {
    const Vec2d p = xy(s, d);
    return {p.x(), p.y(), length, width, heading};
  }

  void add(Mesh mesh, const Material& material) { surfaces_.push_back(surface(std::move(mesh), material)); }
  void add_strip(Mesh& mesh, double d0, double d1, double s0, double s1, double step, double lift = 0) {
    for (double s = s0; s < s1 - 1e-6; s += step) {
      const double e = std::min(s + step, s1);
      add_quad(mesh, on_ground(s, d0, lift), on_ground(e, d0, lift), on_ground(e, d1, lift),
               on_ground(s, d1, lift));
    }
  }
  /// The same beside the road, from `a` to `b` m off its middle, wound upwards on either side.
  void add_side_strip(Mesh& mesh, int side, double a, double b, double s0, double s1, double step) {
    if (side)
      add_strip(mesh, a, b, s0, s1, step);
    else
      add_strip(mesh, -b, -a, s0, s1, step);
  }
  /// Kerbstones along the road's edge: their tops and their faces.
  void add_kerb(Mesh& kerbs, int side, double s0, double s1, double step) {
    const double edge = half_[side], d = sign(side) * edge, b = sign(side) * (edge + 0.06);
    add_side_strip(kerbs, side, edge + 0.06, edge + 0.2, s0, s1, step);
    for (double s = s0; s < s1; s += step) {
      const double e = std::min(s + step, s1);
      add_quad(kerbs, on_ground(s, d), on_ground(e, d), on_ground(e, b), on_ground(s, b));
    }
  }
  /// lay(side, s0, s1) for the street's stretches before and behind the crossing, on both sides.
  template <class Lay>
  void for_each_stretch(const Lay& lay) const {
    for (int side : {0, 1})
      for (const auto& [s0, s1] : {std::pair(-12.0, std::min(far_, cross_s_ - cross_half_)),
                                   std::pair(cross_s_ + cross_half_, far_)})
        if (s1 > s0) lay(side, s0 + 0.01, s1 - 0.01);
  }
  /// The crossing road's surface beside the street's own, out to `reach` m from its middle; none without one.
  void add_cross_road(Mesh& road, double reach) {
    if (!(cross_s_ < far_)) return;
    for (int side : {-1, 1})
      for (double s = cross_s_ - cross_half_; s < cross_s_ + cross_half_ - 0.1; s += cross_half_ / 3)
        for (double d = half_[side > 0]; d < reach; d += 6) {
          const double e = std::min(s + cross_half_ / 3, cross_s_ + cross_half_);
          add_quad(road, on_ground(s, side * d), on_ground(e, side * d), on_ground(e, side * (d + 6)),
                   on_ground(s, side * (d + 6)));
        }
  }

  /// Heading `turn` (radians) from the street's. The order of the members is the order of their random draws,
  /// which a list of a function's arguments leaves to the compiler.
  struct Stand {
    double turn, d, s;
  };

  /// Places the actor; false if it would overlap another.
  bool put(Actor actor, const Stand& stand, double margin = 0.25) {
    const auto [turn, d, s] = stand;
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
                          actor.size.z()},
                         actor.kind});
    }
    add_surfaces(actor, at(p.x(), p.y(), z, heading), object);
    return true;
  }

  void add_surfaces(Actor& actor, const Transform& velo_from_actor, int object) {
    for (Surface& s : actor.surfaces) {
      s.mesh = moved(std::move(s.mesh), velo_from_actor);
      s.object = object;
      surfaces_.push_back(std::move(s));
    }
  }

  /// Whether no placed thing overlaps the box.
  bool free(const BevBox& box) const {
    return std::none_of(taken_.begin(), taken_.end(),
                        [&](const BevBox& b) { return intersection_area(b, box) > 0; });
  }

  /// Stands something without a label at (s, d), heading `turn` from the street's, and keeps nothing free.
  void stand(Actor actor, double s, double d, double turn = 0) {
    const Vec2d p = xy(s, d);
    add_surfaces(actor, at(p.x(), p.y(), ground_z(s, d), yaw(s) + turn), -1);
  }

  // Plants and fences (street_site.cpp).
  void add_fence(double s0, double s1, double d);
  void add_woods(int side, double from);
  /// Adds earth under kerbs and side roads, so that no sky shows between them.
  void add_ground();
  void add_manhole_covers(int count);

  // Movers (street_site.cpp).
  /// Along the street: s over time, and the lane; along the crossing one if it `crosses` (s and d swapped).
  struct Course {
    double s = 0, speed = 0;                          ///< at 0; speed below 0: towards us
    double d = 0, d_to = 0;                           ///< before and after a change of lanes
    double change_from = 0, change_lasts = 0;         ///< s
    double brake_from = 1e9, brake = 0, slowest = 0;  ///< s, m/s², m/s
    bool crosses = false;
  };
  Way way_of(const Course& course, double seconds, double lift) const;
  /// Call it before the ground is laid: gives our side at least two lanes, ours the second from the middle,
  /// and makes the street long enough.
  void widen(double seconds);
  /// Call it after the ground is laid: adds the traffic.
  void drive(double seconds);

  RandomStream random_, actors_;
  double height_;
  double kerb_ = kKerb;  ///< height of what lies beside the road (m)
  double lane_ = 3, half_[2] = {4, 4}, strip_[2] = {}, pavement_[2] = {}, front_[2] = {}, bank_[2] = {};
  int lanes_[2] = {1, 1};  ///< right, left
  double turn_lane_ = 0;   ///< m; 0: there is none in the middle
  double heading_ = 0, curvature_ = 0, ego_d_ = 0, slope_ = 0, wave_ = 0, wave_length_ = 50, wave_phase_ = 0;
  double cross_s_ = 1e9, cross_half_ = 4;
  double far_ = kFar, ahead_ = 0;  ///< m of street that is built; further on than a single frame needs
  double behind_ = 0;              ///< m of it behind the ego vehicle
  double own_speed_ = 0;
  MovingStreet moving_;
  std::vector<Surface> surfaces_;
  std::vector<Placed> placed_;
  std::vector<BevBox> taken_;

 private:
  Street finish();
};

/// Streets of a middle-sized German town and the roads around it.
std::unique_ptr<StreetSite> european_street(std::uint64_t seed, std::uint64_t index, double height);
/// North American avenues, suburbs and office blocks.
std::unique_ptr<StreetSite> american_street(std::uint64_t seed, std::uint64_t index, double height);

}  // namespace mirage::generator
