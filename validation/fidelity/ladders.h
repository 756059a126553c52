// What each effect of light and of the camera changes on one attacked vehicle, one at a time and together,
// and how far each light-weight picture is from the full one.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "base/image.h"
#include "simulation/insertion.h"
#include "validation/fidelity/host_validation.h"
#include "validation/fidelity/vehicle_result.h"
#include "validation/reference/host_scene.h"

namespace mirage {

/// Without what the detector makes of it.
struct LadderRung : LightRungResult {
  ImageF picture;  ///< full.rect-sized composite over the photograph
};

struct LightLadder {
  std::vector<LadderRung> rungs;
  ReferenceResult reference;  ///< what `to_full` is against
};

/// Raster rungs: raster_rungs(). Cycles rungs: matched light over the pixels' area, then that with each
/// effect alone and with several. Samples: the full render (`full`) and that with fewer samples. Every rung
/// of Cycles is drawn as two independent halves. Rungs share their seeds, so that Monte Carlo noise cancels
/// in `change`; the reference has others, and two halves of twice the samples, so that it does not in
/// `to_full`.
LightLadder light_ladder(ReferenceRenderer& renderer, const HostScene& scene, const FullLight& full);

/// The rungs that Mirage draws itself. "hard": hard edges, the plain light. "soft": the picture as attacked,
/// with the scene's own settings. Then the hard one with the lighting done on sRGB numbers ("sRGB shading"),
/// with the hemisphere's light spread evenly ("uniform ambient"), with the light model with visibility
/// ("visible light"), and with what lens ("lens") and sensor ("sensor") add.
const std::vector<std::string>& raster_rungs();
/// Those that scene_features draws.
const std::set<std::string>& feature_rungs();
/// One of them.
Simulated draw_raster_rung(const std::string& rung, const HostScene& scene);

// What of a scene tells, for milliseconds, which effects of light it needs (budget.h).

/// By name: the sun's elevation (rad), its azimuth against the camera (cosine; 1: it stands behind the
/// camera) and against the vehicle's heading, its share of the light, the roof's height over the road (m),
/// the vehicle's range (m), the camera's elevation seen from the roof (rad), log of the object's pixels, its
/// visible share; and what three light-weight renders tell: soft_change and light_change, the relative change
/// of the object's visible pixels from hard edges to soft ones and from the plain light model to the one with
/// visibility. `simulated`: the scene's object, with the scene's settings; an object of no pixel changes
/// nothing.
std::map<std::string, double> scene_features(const HostScene& scene, const Simulated& simulated);
/// Their names, in order.
const std::vector<std::string>& scene_feature_names();

// What each effect of the LiDAR changes in the returns on one attacked vehicle.

/// Without what the detector makes of it.
struct LidarRung : LidarRungResult {
  Sweep sweep;  ///< the frame's sweep with the object in it, for the detector
};

/// The effects of all rungs together: what a unit of the frame's kind adds to thin noiseless rays. Random
/// ones are drawn by the scene's seed.
LidarEffects realistic_returns(const HostScene& scene);

/// "ideal" (thin noiseless rays), then range noise (2 cm, an HDL-64E's), drop-out (10 %), divergence (the
/// unit's, or 2 mrad where its file has none), motion (15 m/s ahead, a yaw rate of 0.2 rad/s) and all
/// together. Returns are matched by beam and firing; one counts as moved beyond 1 mm.
std::vector<LidarRung> lidar_ladder(const HostScene& scene);

}  // namespace mirage
