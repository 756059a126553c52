// A frame without all that an object inside a box could have changed.
//
// What is left of an attacked frame is then, to the bit, what is left of the frame as recorded, whatever the
// object is. Assumed of the world, and true of mirage::simulate with ideal returns: the object stays inside
// the box; a pixel changes only where the box is within `pixels` of it; a return changes or appears only on a
// ray that meets the box, and a new one lies in the box. Not covered: the object's shadow and its reflection
// in the car's paint, glare, jamming, and anything done to the frame elsewhere.
#pragma once

#include "attack/adversary.h"
#include "base/image.h"
#include "geometry/box.h"
#include "scene/frame.h"
#include "sensors/lidar_model.h"

namespace mirage {

/// How far from the box a frame is masked.
struct MaskMargin {
  double pixels = 4;     ///< around its projection: soft edges, the pixel filter
  double metres = 0.02;  ///< around the box, for returns: range noise, half a beam's width there
  /// m: no beam leaves from further away from the `velo` origin (beam_origin_spread).
  double beam_origin = 0;
};

/// Largest distance (m) of a beam's origin from the `velo` origin.
double beam_origin_spread(const LidarModel& lidar);

/// What any object of these limits can fill at this pose: |x| ≤ half.x, |y| ≤ half.y along and across its
/// heading, and up to 2 half.z over its origin, at whose height the lowest vertex stands.
Box3 object_box(const Transform& velo_from_adversary, const AdversaryLimits& limits);

/// Whether a ray from within `margin.beam_origin` of the `velo` origin to the point meets the box grown by
/// `margin.metres` (before the point or at it). False for a point that is not finite.
bool passes_through(const Vec3d& point_velo, const Box3& box, const MaskMargin& margin);

/// What a detector is shown in place of the frame.
struct MaskedFrame {
  ImageF image;             ///< inside `hidden`: the mean of the pixels around it
  Sweep sweep;              ///< without the returns whose rays meet the box, in their order
  PixelRect hidden;         ///< empty if the box is not in view
  std::size_t removed = 0;  ///< returns
};

/// The picture (H×W, linear RGB) and the sweep (`velo`) without what an object in `box` may have changed. A
/// box that reaches behind the camera hides the whole picture.
MaskedFrame masked(const ImageF& image, std::span<const LidarPoint> sweep, const Calibration& calibration,
                   const Box3& box, const MaskMargin& margin);

}  // namespace mirage
