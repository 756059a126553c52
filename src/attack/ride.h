// Where a vehicle that carries an object stands while it drives: the object rides on it. One roof for each
// frame, as found in that frame alone (scene/carrier.h), would jump with the fits; here roof and box follow
// the vehicle's track, smoothed over all its frames (tracking/smoother.h), in the world.
#pragma once

#include <vector>

#include "scene/carrier.h"

namespace mirage {

/// A vehicle in one frame of its track, as found there.
struct RideFrame {
  Moment moment;
  Carrier carrier;
};

/// The vehicle over its track, and what the smoothing did.
struct Ride {
  std::vector<Carrier> carriers;  ///< one a frame; the labelled box and a fitted shape move with the roof
  std::vector<Vec3d> velocities;  ///< of the roof in the world, m/s
  int fitted = 0;                 ///< frames whose roof was fitted
  double residual_m = 0, residual_rad = 0;  ///< RMS of the fitted roofs around the smoothed ones
  double fit_jitter_m = 0, jitter_m = 0;    ///< of the roofs as found, and smoothed (tracking/smoother.h)
  /// RMS of the smoothed roofs around their mean place in the boxes as labelled: where labels are true, how
  /// far the object moves on its roof.
  double in_box_m = 0, in_box_rad = 0;
};

/// Frames by rising time. The roof's place in the labelled box is the median of the fitted ones, or of all if
/// none is fitted. Where a frame's roof is not fitted that place stands in for it, with a larger σ.
Ride ride(const std::vector<RideFrame>& frames);

}  // namespace mirage
