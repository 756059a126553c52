// Brightness of a recorded frame's light, from the road in its photograph.
//
// KITTI does not record its light. The road ahead is the one surface of known colour in nearly every frame:
// worn asphalt, kRoadAlbedo. The light model's strengths are scaled, channel by channel, until level asphalt
// is as bright as in the photograph, so that an object, its host's paint and the exported ground fit the
// picture. The sun's direction does not change.
#pragma once

#include <optional>
#include <string>

#include "base/fields.h"
#include "scene/carrier.h"
#include "scene/frame.h"
#include "sensors/visible_light.h"

namespace mirage {

/// Median radiance (linear RGB, 1: white) of the road's returns: x 5 to 20 m ahead, |y| ≤ 1.5 m, within 0.15
/// m of the ground there, in view and in no labelled box. Nullopt for fewer than 50 such returns.
std::optional<Vec3d> road_radiance(const Frame& frame);

/// `frame.lighting` scaled so that level ground of kRoadAlbedo has that radiance, each channel by 1/2 to 3
/// (beyond, the road is shaded or glares and tells little about the rest); unchanged if the road is not
/// visible.
Lighting with_road_exposure(const Frame& frame);

// The sun's direction from the shadows that labelled objects cast in the photograph.
//
// Ground returns near vehicles are the samples: visible ground of known height, each with the log luminance
// of its pixel. For each sun direction on a grid (azimuth 10°, elevation 15 … 60°) the labelled boxes shade
// some samples. Its score is the likelihood of the luminances if all shadows of the frame darken by one
// factor. The fit includes the LiDAR's reflectance, which does not depend on the sun, and a gradient around
// each vehicle. Shadows of other objects (buildings, trees) are not modelled and mislead it.

/// The sun (unit, `velo`) whose shadows best explain the dark ground beside the labelled vehicles. Nullopt if
/// ambiguous: another sun, more than 40° of azimuth away, fits nearly as well, or the shadows are hardly
/// darker than the rest.
std::optional<Vec3d> sun_from_shadows(const Frame& frame);

// The surroundings of an object on a vehicle's roof, for the light model with visibility.

/// Linear albedo of the road, if unknown.
inline constexpr double kRoadAlbedo = 0.18;

/// Paint (linear albedo) of a labelled vehicle from the photograph: the median of the label's 2-D box away
/// from roof and road, divided by the plain model's light on an upright face.
Vec3d vehicle_paint(const Frame& frame, const Label& host);

/// Roof, outline and road of the fitted vehicle if there is one, otherwise of the saloon in the label's box.
LightSurroundings light_surroundings(const Frame& frame, const Carrier& carrier);

// The sun's direction, as --sun names it:
//
//   frame                    the frame's own lighting: lighting/ID.json of a generated frame, otherwise a
//                            default scaled to the photographed road
//   AZIMUTH,ELEVATION        degrees in `velo`: azimuth counter-clockwise from x (forward; 90: left),
//                            elevation above the ground, (0, 90]
//   photo                    from the shadows of the labelled objects; the frame's own if ambiguous
//   LAT,LON,TIME,HEADING     place (degrees north and east), time YYYY-MM-DDTHH:MM:SSZ (UTC; fractions of a
//                            second may follow), and heading of `velo`'s x axis, degrees counter-clockwise
//                            from east, as the yaw of KITTI's OXTS packets (0 is east, 90 north)
//
// Only the direction changes; the strengths of sun and sky stay the frame's. A direction or a heading holds
// for every frame of the data set; photo is evaluated for each. `velo` is assumed level.

/// The frame's own lighting.
inline constexpr const char* kDefaultSun = "frame";

/// The parsed word.
struct SunChoice {
  std::string word = kDefaultSun;
  std::optional<Vec3d> to_sun_velo = {};  ///< unit; nullopt: the frame's own, or the photograph's
  bool photo = false;
};

/// FieldError for any other word, numbers out of range and a sun below the horizon.
SunChoice parse_sun(const std::string& word);

/// The frame's lighting with the sun of `choice`. `photo` needs the frame's whole sweep. Logs the first frame
/// whose shadows give no reliable sun.
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

/// `latitude`, `longitude` in radians, north and east positive. By libnova (VSOP87). In the example of the
/// solar position algorithm (Reda & Andreas, NREL/TP-560-34302) it differs by 0.001° in azimuth and 0.006° in
/// elevation: it assumes standard air (1010 mbar, 10 °C) and omits the parallax (≤ 0.0025°).
SunPosition sun_position(double latitude, double longitude, const UtcTime& time);

}  // namespace mirage
