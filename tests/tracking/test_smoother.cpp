// The smoother on known motion.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "base/error.h"
#include "base/sizes.h"
#include "base/types.h"
#include "tracking/tracker.h"

namespace mirage {
namespace {

struct Truth {
  Vec3d position;
  double yaw;
};

/// A car at 12 m/s that brakes at 4 m/s² for a second and a half, and turns at 15°/s for a second.
std::vector<Truth> drive(int frames) {
  std::vector<Truth> truth;
  double x = 0, y = 0, yaw = 0.4, speed = 12;
  constexpr int kParts = 100;
  for (int i = 0; i < frames; ++i) {
    truth.push_back({{x, y, 0.1 * std::sin(0.02 * i)}, yaw});
    for (int k = 0; k < kParts; ++k) {
      const double t = 0.1 * (i + static_cast<double>(k) / kParts), dt = 0.1 / kParts;
      if (t > 1.5 && t < 3) speed -= 4 * dt;
      if (t > 3.5 && t < 4.5) yaw += 15 * kDegree * dt;
      x += speed * std::cos(yaw) * dt;
      y += speed * std::sin(yaw) * dt;
    }
  }
  return truth;
}

TEST(Smoother, RidesWithinThreeCentimetresAndOneDegree) {
  const std::vector<Truth> truth = drive(60);
  std::mt19937 random(5);
  std::normal_distribution<double> draw;
  double noise = 0, error = 0, turn = 0;
  int count = 0;
  for (int repetition = 0; repetition < 20; ++repetition) {
    std::vector<PlaceMeasurement> measured;
    for (std::size_t i = 0; i < truth.size(); ++i) {
      PlaceMeasurement m;
      m.time = 0.1 * static_cast<double>(i);
      m.position = truth[i].position + Vec3d(0.05 * draw(random), 0.05 * draw(random), 0.02 * draw(random));
      m.yaw = truth[i].yaw + 1.5 * kDegree * draw(random) + (i % 7 == 0 ? 2 * M_PI : 0);
      measured.push_back(m);
    }
    const auto places = smooth(measured);
    std::vector<Vec3d> before, after;
    std::vector<double> times;
    for (std::size_t i = 0; i < truth.size(); ++i, ++count) {
      noise += (measured[i].position - truth[i].position).squaredNorm();
      error += (places[i].position - truth[i].position).squaredNorm();
      turn += std::pow(wrap_angle(places[i].yaw - truth[i].yaw), 2);
      times.push_back(measured[i].time);
      before.push_back(measured[i].position);
      after.push_back(places[i].position);
    }
    EXPECT_NEAR(jitter(before, times), 0.074, 0.02);  // √(2 · 5² + 2²) cm and the braking's part
    EXPECT_LT(jitter(after, times), 0.03);
  }
  EXPECT_GT(std::sqrt(noise / count), 0.07);
  EXPECT_LT(std::sqrt(error / count), 0.05);  // in space; along each axis under 3 cm
  EXPECT_LT(std::sqrt(error / count / 3), 0.03);
  EXPECT_LT(std::sqrt(turn / count), 1 * kDegree);
}

TEST(Smoother, ConstantVelocityIsExactAndItsVelocityIsTold) {
  std::vector<PlaceMeasurement> measured(20);
  for (int i = 0; i < 20; ++i) {
    measured[as_size(i)].time = 0.1 * i + (i > 9 ? 0.3 : 0);  // with a pause
    const double t = measured[as_size(i)].time;
    measured[as_size(i)].position = Vec3d(3 + 8 * t, -2 * t, 1);
    measured[as_size(i)].yaw = 3.1 + 0.2 * t;
  }
  const auto places = smooth(measured);
  for (std::size_t i = 0; i < 20; ++i) {
    EXPECT_LT((places[i].position - measured[i].position).norm(), 2e-3);
    EXPECT_LT((places[i].velocity - Vec3d(8, -2, 0)).norm(), 0.02);
    EXPECT_NEAR(wrap_angle(places[i].yaw - measured[i].yaw), 0, 1e-3);
    EXPECT_NEAR(places[i].yaw_rate, 0.2, 5e-3);
  }
}

TEST(Smoother, OneWildMeasurementMovesLittle) {
  std::vector<PlaceMeasurement> measured(21);
  for (int i = 0; i < 21; ++i) measured[as_size(i)].time = 0.1 * i;
  measured[10].position = Vec3d(1, 0, 0);
  EXPECT_LT(smooth(measured)[10].position.norm(), 0.1);
}

TEST(Smoother, RefusesTimesThatDoNotRise) {
  std::vector<PlaceMeasurement> measured(2);
  EXPECT_THROW(smooth(measured), InputError);
  measured[1].time = 1;
  EXPECT_NO_THROW(smooth(measured));
  measured[1].yaw_sigma = 0;
  EXPECT_THROW(smooth(measured), InputError);
  EXPECT_TRUE(smooth({}).empty());
}

}  // namespace
}  // namespace mirage
