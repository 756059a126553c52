// Central differences against an analytic gradient, in double; prints both values on failure.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <span>
#include <vector>

#include "base/types.h"

namespace mirage::test {

/// The coordinates x, y, z of all points in turn.
inline std::vector<double> flat(std::span<const Vec3d> points) {
  std::vector<double> x;
  for (const Vec3d& p : points) x.insert(x.end(), p.data(), p.data() + 3);
  return x;
}

struct GradientCheck {
  double worst = 0;  ///< largest |analytic − numeric| / max(scale, |numeric|)
  int checked = 0;
};

/// Compares `gradient` with (f(x + h e_i) − f(x − h e_i)) / 2h for every i with pick(i).
inline GradientCheck check_gradient(const std::function<double(const std::vector<double>&)>& f,
                                    std::vector<double> x, const std::vector<double>& gradient,
                                    double step = 1e-6, double tolerance = 1e-5, double scale = 1e-3,
                                    const std::function<bool(std::size_t)>& pick = {}) {
  GradientCheck result;
  EXPECT_EQ(x.size(), gradient.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (pick && !pick(i)) continue;
    const double at = x[i];
    x[i] = at + step;
    const double above = f(x);
    x[i] = at - step;
    const double below = f(x);
    x[i] = at;
    const double numeric = (above - below) / (2 * step);
    const double error = std::abs(numeric - gradient[i]) / std::max(scale, std::abs(numeric));
    EXPECT_LE(error, tolerance) << "component " << i << ": analytic " << gradient[i] << ", numeric "
                                << numeric;
    result.worst = std::max(result.worst, error);
    ++result.checked;
  }
  return result;
}

}  // namespace mirage::test
