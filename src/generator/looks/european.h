// The European look: streets of a middle-sized German town and the roads around it.
#pragma once

#include "generator/street_site.h"

namespace mirage::generator {

class EuropeanStreet : public StreetSite {
 public:
  EuropeanStreet(std::uint64_t seed, std::uint64_t index, double height)
      : StreetSite(seed, "street", index, height) {}

 private:
  enum class Kind { residential, avenue, rural, crossing, square };

  void choose() override;
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

}  // namespace mirage::generator
