// Random vectors of test scenes.
#pragma once

#include "base/random.h"
#include "base/types.h"

namespace mirage::test {

/// Drawn from the last component to the first: the order of evaluation of arguments depends on the compiler.
inline Vec3d random_vector(RandomStream& random, const Vec3d& low, const Vec3d& high) {
  Vec3d v;
  for (int c = 2; c >= 0; --c) v[c] = random.uniform(low[c], high[c]);
  return v;
}

inline Vec3d random_vector(RandomStream& random, double low, double high) {
  return random_vector(random, Vec3d::Constant(low), Vec3d::Constant(high));
}

}  // namespace mirage::test
