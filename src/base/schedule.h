// Learning-rate schedule of the trainings.
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

namespace mirage {

/// Learning rate at `progress` in [0, 1]: a linear rise over the first 5 %, then half a cosine down to 1 % of
/// the peak.
inline double one_cycle(double peak, double progress) {
  constexpr double rise = 0.05, floor = 0.01;
  progress = std::clamp(progress, 0.0, 1.0);
  if (progress < rise) return peak * (0.05 + 0.95 * progress / rise);
  const double along = (progress - rise) / (1 - rise);
  return peak * (floor + (1 - floor) * 0.5 * (1 + std::cos(std::numbers::pi * along)));
}

}  // namespace mirage
