// Puts a car together: the lofted body with wheels, lamps, plates, glass, seats and mirrors.
#pragma once

#include "generator/car_body.h"

namespace mirage::generator {

/// What a body is given beyond its shape.
struct CarTrim {
  bool rails = false, bright_rails = false;  ///< on the roof
  bool bed = false;                          ///< a pick-up's, behind the rear window
  bool split_lamps = false;                  ///< rear lamps with a clear band across
  bool american = false;                     ///< short, high plates without a band; no amber at the rear
};

/// `size` (length, width, height, m): of the label box, to which the whole is stretched.
Actor assemble(const BodyShape& shape, const std::string& type, const Vec3d& size, const CarTrim& trim,
               RandomStream& random);

/// Puts something on the roof of one car in ten: a box, a ladder, skis, a taxi sign, rolled carpets, timber.
/// Its surfaces come last and each stands out of the label box, which stays the car's own. `car`: assembled
/// from `shape`.
void add_roof_load(Actor& car, const BodyShape& shape, RandomStream& random);

Material paint_of(RandomStream& random);
Material tyre_rubber();
Material dark_plastic();

}  // namespace mirage::generator
