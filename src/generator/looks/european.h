// The European look: streets of a middle-sized German town and the roads around it.
#pragma once

#include "generator/street_site.h"

namespace mirage::generator {

class EuropeanStreet : private StreetSite {
 public:
  EuropeanStreet(std::uint64_t seed, std::uint64_t index, double height)
      : StreetSite(seed, "street", index, height) {}

  Street build(double behind) {
    choose();
    go_on(behind);
    lay_ground();
    place_traffic();
    place_parked();
    place_edges();
    place_people();
    return finish();
  }
  MovingStreet build_moving(double seconds) {
    choose();
    widen(seconds, lanes_right_, 0);
    lay_ground();
    drive(seconds, -0.5 * lane_, (lanes_left_ - 0.5) * lane_, [&] { return vehicle(0); });
    place_parked();
    place_edges();
    place_people();
    return finish_moving();
  }

 private:
  enum class Kind { residential, avenue, rural, crossing, square };

  void choose();
  void lay_ground();
  void place_traffic();
  void place_parked();
  void place_people();
  void place_edges();
  void place_signals();
  void add_building(double s, double d, double along, double deep, int side);

  /// A vehicle, or with probability `alike` something that looks like a car to a LiDAR.
  Actor vehicle(double alike) {
    if (actors_.uniform() < alike) return make_look_alike(make_car(actors_), actors_);
    const double pick = actors_.uniform();
    return pick < 0.93 ? make_car(actors_) : pick < 0.985 ? make_van(actors_) : make_truck(actors_);
  }

  Kind kind_ = Kind::residential;
};

}  // namespace mirage::generator
