#include "tracking/smoother.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <string>

#include "base/angles.h"
#include "base/error.h"

namespace mirage {
namespace {

struct Sample {
  double time = 0, value = 0, sigma = 1;
};

/// One axis: (p, v) at each sample.
std::vector<Vec2d> smooth_axis(const std::vector<Sample>& samples, double density) {
  constexpr double kUnknownSpeed = 100;  // σ of the first velocity
  const std::size_t n = samples.size();
  std::vector<Vec2d> x(n), ahead(n);
  std::vector<Eigen::Matrix2d> p(n), p_ahead(n), f(n, Eigen::Matrix2d::Identity());
  for (std::size_t k = 0; k < n; ++k) {
    const double variance = samples[k].sigma * samples[k].sigma;
    if (k == 0) {
      ahead[k] = Vec2d(samples[k].value, 0);
      p_ahead[k] = Vec2d(1e3 * variance, kUnknownSpeed * kUnknownSpeed).asDiagonal();
    } else {
      const double dt = samples[k].time - samples[k - 1].time;
      f[k](0, 1) = dt;
      Eigen::Matrix2d q;
      q << dt * dt * dt / 3, dt * dt / 2, dt * dt / 2, dt;
      ahead[k] = f[k] * x[k - 1];
      p_ahead[k] = f[k] * p[k - 1] * f[k].transpose() + density * q;
    }
    const Vec2d gain = p_ahead[k].col(0) / (p_ahead[k](0, 0) + variance);
    x[k] = ahead[k] + gain * (samples[k].value - ahead[k][0]);
    p[k] = p_ahead[k] - gain * p_ahead[k].row(0);
  }
  for (std::size_t k = n - 1; k-- > 0;)
    x[k] += p[k] * f[k + 1].transpose() * p_ahead[k + 1].inverse() * (x[k + 1] - ahead[k + 1]);
  return x;
}

/// Twice: the second time with weights by how far off each sample was.
std::vector<Vec2d> robust_axis(std::vector<Sample> samples, double density) {
  constexpr double kFar = 2;  // σ
  const std::vector<Vec2d> first = smooth_axis(samples, density);
  for (std::size_t k = 0; k < samples.size(); ++k) {
    const double off = std::abs(samples[k].value - first[k][0]) / samples[k].sigma;
    samples[k].sigma *= std::sqrt(std::max(1.0, off / kFar));
  }
  return smooth_axis(samples, density);
}

}  // namespace

std::vector<SmoothPlace> smooth(std::span<const PlaceMeasurement> measurements,
                                const SmootherSettings& settings) {
  if (measurements.empty()) return {};
  for (std::size_t k = 0; k < measurements.size(); ++k) {
    if (k > 0 && !(measurements[k].time > measurements[k - 1].time))
      throw InputError("track", std::to_string(measurements[k].time), "is no later time than the one before",
                       "give measurements in order of time");
    if (!(measurements[k].sigma.minCoeff() > 0 && measurements[k].yaw_sigma > 0))
      throw InputError("track", "sigma", "is not over 0", "say how large the noise is");
  }
  std::vector<SmoothPlace> places(measurements.size());
  std::vector<Sample> samples(measurements.size());
  for (int axis = 0; axis < 4; ++axis) {
    double yaw = measurements.front().yaw;
    for (std::size_t k = 0; k < samples.size(); ++k) {
      const PlaceMeasurement& m = measurements[k];
      yaw += wrap_angle(m.yaw - yaw);
      samples[k] =
          axis < 3 ? Sample{m.time, m.position[axis], m.sigma[axis]} : Sample{m.time, yaw, m.yaw_sigma};
    }
    const auto states = robust_axis(samples, axis < 3 ? settings.acceleration[axis] : settings.turn);
    for (std::size_t k = 0; k < states.size(); ++k) {
      if (axis < 3) {
        places[k].position[axis] = states[k][0];
        places[k].velocity[axis] = states[k][1];
      } else {
        places[k].yaw = wrap_angle(states[k][0]);
        places[k].yaw_rate = states[k][1];
      }
    }
  }
  return places;
}

double jitter(std::span<const Vec3d> places, std::span<const double> times) {
  double sum = 0;
  int count = 0;
  for (std::size_t k = 1; k + 1 < places.size(); ++k) {
    const double before = times[k] - times[k - 1], after = times[k + 1] - times[k];
    if (std::abs(after - before) > 0.1 * std::min(before, after)) continue;
    sum += (places[k - 1] - 2 * places[k] + places[k + 1]).squaredNorm();
    ++count;
  }
  return count > 0 ? std::sqrt(sum / (6 * count)) : 0;
}

}  // namespace mirage
