// Masks a frame: removes everything that an object inside a box could have changed.
//
// The rest of an attacked frame is then bit-identical to the rest of the frame as recorded, whatever the
// object is. This assumes the following, which holds for mirage::simulate with ideal returns: the object
// stays inside the box, and changes only pixels within `pixels` of the box. A return changes or appears only
// on a ray that meets the box, and a new one lies in the box. Not covered: the object's shadow and its
// reflection in the car's paint, glare, jamming, and any manipulation elsewhere in the frame.
#pragma once

#include "attack/adversary.h"
#include "base/image.h"
#include "geometry/box.h"
#include "scene/frame.h"
#include "sensors/lidar_model.h"

namespace mirage {

/// Margins of the mask around the box.
struct MaskMargin {
  double pixels = 4;     ///< around its projection: soft edges, the pixel filter
  double metres = 0.02;  ///< around the box, for returns: range noise, half a beam's width there
  /// m: largest distance of a beam's origin from the `velo` origin (beam_origin_spread).
  double beam_origin = 0;
};

/// Largest distance (m) of a beam's origin from the `velo` origin.
double beam_origin_spread(const LidarModel& lidar);

/// The box that any object of these limits stays in at this pose: |x| ≤ half.x along its heading, |y| ≤
/// half.y across, and 0 to 2 half.z over its origin. The lowest vertex is at the origin's height.
Box3 object_box(const Transform& velo_from_adversary, const AdversaryLimits& limits);

/// Whether a ray from within `margin.beam_origin` of the `velo` origin to the point meets the box grown by
/// `margin.metres` (before the point or at it). False for a point that is not finite.
bool passes_through(const Vec3d& point_velo, const Box3& box, const MaskMargin& margin);

/// The masked frame for a detector.
struct MaskedFrame {
  ImageF image;             ///< inside `hidden`: the mean of the pixels around it
  Sweep sweep;              ///< without the returns whose rays meet the box, in their order
  PixelRect hidden;         ///< empty if the box is not in view
  std::size_t removed = 0;  ///< returns
};

/// Masks the pixels (H×W, linear RGB) and returns (`velo`) that an object in `box` may have changed. A box
/// that extends behind the camera hides the whole picture.
MaskedFrame masked(const ImageF& image, std::span<const LidarPoint> sweep, const Calibration& calibration,
                   const Box3& box, const MaskMargin& margin);

}  // namespace mirage
