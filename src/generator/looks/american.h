// The North American look: avenues with shops behind car parks, suburbs with lawns and driveways, office
// blocks.
#pragma once

#include "generator/looks/american_parts.h"
#include "generator/street_site.h"

namespace mirage::generator {

class AmericanStreet : public StreetSite {
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
  void choose() override;
  void lay_ground() override;
  // Markings, junction, traffic
  void paint_road();
  void paint_arrow(Mesh& paint, double s, double d);
  void place_junction();
  void place_traffic() override;
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

  Actor vehicle(double alike) override;
  /// A wall's frame: x along the street, y to its left, z up, origin on the ground before the middle.
  Transform footing(double s, double d) const {
    const Vec2d p = xy(s, d);
    return at(p.x(), p.y(), ground_z(s, d), yaw(s));
  }

  Kind kind_ = Kind::avenue;
  double verge_[2] = {};  // grass between kerb and walk
};

}  // namespace mirage::generator
