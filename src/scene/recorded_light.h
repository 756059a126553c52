// How bright a recorded frame's light is, from the road in its photograph.
//
// KITTI says nothing of its light. The road ahead is the one surface of known colour that nearly every frame
// shows: worn asphalt, kRoadAlbedo. The light model's strengths are scaled, channel by channel, until it
// draws level asphalt as bright as the photograph has it, so that an object, the paint of its host and the
// exported ground fit the picture. The direction of the sun is not touched.
#pragma once

#include <optional>

#include "scene/carrier.h"
#include "scene/frame.h"
#include "sensors/visible_light.h"

namespace mirage {

/// Median radiance (linear RGB, 1: white) of the road's returns: x 5 to 20 m ahead, |y| ≤ 1.5 m, within 0.15
/// m of the ground there, in view and in no labelled box. None where fewer than 50 returns tell.
std::optional<Vec3d> road_radiance(const Frame& frame);

/// `frame.lighting` scaled so that level ground of kRoadAlbedo has that radiance, each channel by 1/2 to 3
/// (beyond, the road is shaded or glares and says little of the rest); as it is where the road is not seen.
Lighting with_road_exposure(const Frame& frame);

// The sun's direction from the shadows that labelled objects cast in the photograph.
//
// Ground returns of the sweep near vehicles are the samples: ground that is really seen, with its own height.
// Each has the log luminance of its pixel. A direction on a grid (azimuth 10°, elevation 15 … 60°) says which
// samples the labelled boxes shade, and how likely the luminances are if all shades of the frame darken by
// one factor. The LiDAR's reflectance, which no sun changes, and a gradient around each vehicle are fitted
// along. What else casts shadows (buildings, trees) is not known here and misleads.

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

// What a vehicle puts around the object on its roof for the light model with visibility.

/// Linear albedo of the road, where nothing tells it.
inline constexpr double kRoadAlbedo = 0.18;

/// Paint (linear albedo) of a labelled vehicle from the photograph: the median of the label's 2-D box away
/// from roof and road, divided by the plain model's light on an upright face.
Vec3d vehicle_paint(const Frame& frame, const Label& host);

/// Roof, outline and road of the fitted vehicle where there is one, else of the saloon in the label's box.
LightSurroundings light_surroundings(const Frame& frame, const Carrier& carrier);

}  // namespace mirage
