// The sun's direction from the shadows that labelled objects cast in the photograph.
//
// Ground returns of the sweep near vehicles are the samples: ground that is really seen, with its own height.
// Each has the log luminance of its pixel. A direction on a grid (azimuth 10°, elevation 15 … 60°) says which
// samples the labelled boxes shade, and how likely the luminances are if all shades of the frame darken by
// one factor. The LiDAR's reflectance, which no sun changes, and a gradient around each vehicle are fitted
// along. What else casts shadows (buildings, trees) is not known here and misleads.
#pragma once

#include "scene/frame.h"

namespace mirage {

/// Where the sun stands, read off the photograph.
struct SunEstimate {
  bool known = false;  ///< false where the photograph does not tell
  Vec3d to_sun_velo = Vec3d::UnitZ();
  double contrast = 0;  ///< log luminance outside less inside the shadows, one of a few levels
  /// Log likelihood over that of no shadows; n samples of a vehicle count as √n, being neighbours.
  double score = 0;
  double confidence = 0;  ///< score less the best one more than 40° of azimuth away
  int vehicles = 0;       ///< with ground in view around them
};

/// Compares ground returns in and beside the shadows that the labelled vehicles would cast under each sun of
/// a grid.
SunEstimate sun_from_shadows(const Frame& frame);

}  // namespace mirage
