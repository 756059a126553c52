#include "generator/street.h"

#include <algorithm>

#include "generator/looks/american.h"
#include "generator/looks/european.h"

namespace mirage::generator {

bool on_roof(const Surface& surface, const Placed& placed) {
  const double top = placed.box.bottom + placed.box.height;
  return std::any_of(surface.mesh.vertices.begin(), surface.mesh.vertices.end(),
                     [&](const Vec3d& v) { return v.z() > top + 0.01; });
}

Street make_street(std::uint64_t seed, std::uint64_t index, double height, Look look) {
  if (look == Look::american) return AmericanStreet(seed, index, height).build();
  return EuropeanStreet(seed, index, height).build();
}

}  // namespace mirage::generator
