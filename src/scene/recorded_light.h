// How bright a recorded frame's light is, from the road in its photograph.
//
// KITTI says nothing of its light. The road ahead is the one surface of known colour that nearly every frame
// shows: worn asphalt, kRoadAlbedo. The light model's strengths are scaled, channel by channel, until it
// draws level asphalt as bright as the photograph has it, so that an object, the paint of its host and the
// exported ground fit the picture. The direction of the sun is not touched.
#pragma once

#include <optional>
#include <string>

#include "base/fields.h"
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

/// The sun (unit, `velo`) under whose shadows the ground beside the labelled vehicles is as dark as it is in
/// the photograph; none where that does not tell: another sun, more than 40° of azimuth away, does nearly as
/// well, or the shadows are hardly darker than the rest.
std::optional<Vec3d> sun_from_shadows(const Frame& frame);

// What a vehicle puts around the object on its roof for the light model with visibility.

/// Linear albedo of the road, where nothing tells it.
inline constexpr double kRoadAlbedo = 0.18;

/// Paint (linear albedo) of a labelled vehicle from the photograph: the median of the label's 2-D box away
/// from roof and road, divided by the plain model's light on an upright face.
Vec3d vehicle_paint(const Frame& frame, const Label& host);

/// Roof, outline and road of the fitted vehicle where there is one, else of the saloon in the label's box.
LightSurroundings light_surroundings(const Frame& frame, const Carrier& carrier);

// Where the sun stands, as --sun names it:
//
//   frame                    the frame's own lighting: lighting/ID.json of a generated frame, else a default
//                            as bright as the photographed road says
//   AZIMUTH,ELEVATION        degrees in `velo`: azimuth counter-clockwise from x (forward; 90: left),
//                            elevation above the ground, (0, 90]
//   photo                    from the shadows of the labelled objects; a frame whose
//                            photograph does not tell keeps its own lighting
//   LAT,LON,TIME,HEADING     place (degrees north and east), time YYYY-MM-DDTHH:MM:SSZ (UTC; fractions of a
//                            second may follow), and heading of `velo`'s x axis, degrees counter-clockwise
//                            from east, as the yaw of KITTI's OXTS packets (0 is east, 90 north)
//
// Only the direction changes; the strengths of sun and sky stay the frame's. A direction or a heading holds
// for every frame of the data set; photo is asked for each. `velo` is taken as level.

/// The frame's own.
inline constexpr const char* kDefaultSun = "frame";

/// The word, understood.
struct SunChoice {
  std::string word = kDefaultSun;
  std::optional<Vec3d> to_sun_velo = {};  ///< unit; none: the frame's own, or the photograph's
  bool photo = false;
};

/// FieldError for any other word, numbers out of range and a sun below the horizon.
SunChoice parse_sun(const std::string& word);

/// The frame's lighting with the sun where `choice` says. `photo` needs the frame's whole sweep. The first
/// frame whose shadows give no reliable sun is logged.
Lighting with_sun(const Frame& frame, const SunChoice& choice);

/// Direction of the sun for an observer at sea level.
struct SunPosition {
  double azimuth = 0;    ///< radians, clockwise (eastward) from north
  double elevation = 0;  ///< radians above the horizon, with the refraction of standard air
};

/// Calendar date and time of day, UTC.
struct UtcTime {
  int year = 0, month = 0, day = 0, hour = 0, minute = 0;
  double second = 0;
};

/// `latitude`, `longitude` in radians, north and east positive. By libnova (VSOP87). At the example of the
/// solar position algorithm (Reda & Andreas, NREL/TP-560-34302) it differs by 0.001° in azimuth and 0.006° in
/// elevation: it has standard air (1010 mbar, 10 °C) and leaves out the parallax (≤ 0.0025°).
SunPosition sun_position(double latitude, double longitude, const UtcTime& time);

}  // namespace mirage
