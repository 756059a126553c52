// Where the sun stands, as --sun names it:
//
//   frame                    the frame's own lighting: lighting/ID.json of a generated frame, else a default
//                            as bright as the photographed road says (scene/recorded_light.h)
//   AZIMUTH,ELEVATION        degrees in `velo`: azimuth counter-clockwise from x (forward; 90: left),
//                            elevation above the ground, (0, 90]
//   photo                    from the shadows of the labelled objects (scene/recorded_light.h); a frame whose
//                            photograph does not tell keeps its own lighting
//   LAT,LON,TIME,HEADING     place (degrees north and east), time YYYY-MM-DDTHH:MM:SSZ (UTC; fractions of a
//                            second may follow), and heading of `velo`'s x axis, degrees counter-clockwise
//                            from east, as the yaw of KITTI's OXTS packets (0 is east, 90 north)
//
// Only the direction changes; the strengths of sun and sky stay the frame's. A direction or a heading holds
// for every frame of the data set; photo is asked for each. `velo` is taken as level.
#pragma once

#include <optional>
#include <string>

#include "base/fields.h"
#include "scene/frame.h"

namespace mirage {

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

/// The frame's lighting with the sun where `choice` says. `photo` wants the frame's whole sweep; the first
/// frame that does not tell is logged.
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
