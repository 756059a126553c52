#include "scene/generator/street.h"

#include "scene/generator/looks/american.h"
#include "scene/generator/looks/european.h"

namespace mirage::generator {

Street make_street(std::uint64_t seed, std::uint64_t index, double height, Look look) {
  if (look == Look::american) return AmericanStreet(seed, index, height).build();
  return EuropeanStreet(seed, index, height).build();
}

}  // namespace mirage::generator
