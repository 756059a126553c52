// Where a thing was over time, from measurements with noise: the fixed-interval smoother of Rauch, Tung and
// Striebel (AIAA Journal 3, 1965) for motion of nearly constant velocity. Each of x, y, z and the heading is
// a filter of its own, with state (p, v), acceleration as white noise of density q, and steps dt:
//
//   F = [1 dt; 0 1]    Q = q [dt³/3 dt²/2; dt²/2 dt]    z = p + noise of σ
//   backwards:  x_k ← x_k + C (x_{k+1} − F x_k),  C = P_k Fᵀ (F P_k Fᵀ + Q)⁻¹
//
// Measurements further than 2 σ off the first answer count less by Huber's weights, and the smoother runs
// once more.
#pragma once

#include <span>
#include <vector>

#include "base/types.h"

namespace mirage {

/// A measured place and heading.
struct PlaceMeasurement {
  double time = 0;  ///< s
  Vec3d position = Vec3d::Zero();
  double yaw = 0;                         ///< rad; whole turns do not matter
  Vec3d sigma = Vec3d(0.06, 0.06, 0.03);  ///< m, of the position
  double yaw_sigma = 0.02;                ///< rad
};

/// How fast the motion may change.
struct SmootherSettings {
  Vec3d acceleration = Vec3d(0.5, 0.5, 0.02);  ///< q of x, y and z, m²/s³
  double turn = 0.02;                          ///< q of the heading, rad²/s³
};

/// The smoothed place at a measurement's time.
struct SmoothPlace {
  Vec3d position = Vec3d::Zero(), velocity = Vec3d::Zero();  ///< m, m/s
  double yaw = 0, yaw_rate = 0;                              ///< rad, rad/s
};

/// One answer a measurement. InputError for times that do not rise and for a σ that is not positive.
std::vector<SmoothPlace> smooth(std::span<const PlaceMeasurement> measurements,
                                const SmootherSettings& settings = {});

/// m: noise of places along a track that is independent from one to the next, from their second differences
/// d: √(mean |d|² / 6), which is free of constant velocity. Of three places only those count whose two steps
/// of time are alike (to a tenth): across a pause of the track constant velocity has a second difference,
/// too. 0 where there are none.
double jitter(std::span<const Vec3d> places, std::span<const double> times);

}  // namespace mirage
