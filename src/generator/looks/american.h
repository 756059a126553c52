// The North American look: avenues with shops behind car parks, suburbs with lawns and driveways, office
// blocks.
#pragma once

#include "generator/looks/american_parts.h"
#include "generator/street_site.h"

namespace mirage::generator {

class AmericanStreet : private StreetSite {
 public:
  AmericanStreet(std::uint64_t seed, std::uint64_t index, double height)
      : StreetSite(seed, "american street", index, height) {}

  Street build(double behind) {
    choose();
    go_on(behind);
    lay_ground();
    paint_road();
    if (cross_s_ < far_) place_junction();
    place_traffic();
    furnish();
    return finish();
  }
  MovingStreet build_moving(double seconds) {
    choose();
    widen(seconds, lanes_[0], 0.5 * turn_lane_);
    lay_ground();
    paint_road();
    if (cross_s_ < far_) place_junction();
    drive(seconds, lane_d(0, 0), lane_d(1, lanes_[1] - 1), [&] { return vehicle(0); });
    furnish();
    return finish_moving();
  }

 private:
  enum class Kind { avenue, suburb, downtown };

  void furnish() {
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
  void choose();
  void lay_ground();
  // Markings, junction, traffic
  void paint_road();
  void paint_arrow(Mesh& paint, double s, double d);
  void place_junction();
  void place_traffic();
  void place_parked();
  // What stands beside the road
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

  /// A vehicle, or with probability `alike` something that looks like a car to a LiDAR.
  Actor vehicle(double alike);
  double sign(int side) const { return side ? 1 : -1; }
  /// Middle of a lane on a side (0: our own), counted from the centre line.
  double lane_d(int side, int lane) const { return sign(side) * (0.5 * turn_lane_ + (lane + 0.5) * lane_); }
  /// A wall's frame: x along the street, y to its left, z up, origin on the ground before the middle.
  Transform footing(double s, double d) const {
    const Vec2d p = xy(s, d);
    return at(p.x(), p.y(), ground_z(s, d), yaw(s));
  }

  Kind kind_ = Kind::avenue;
  double turn_lane_ = 0;   // m; 0: none, the yellow lines are in the middle
  int lanes_[2] = {2, 2};  // right, left
  double verge_[2] = {};   // grass between kerb and walk
};

}  // namespace mirage::generator
