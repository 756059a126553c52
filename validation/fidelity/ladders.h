// The change that each effect of light and camera makes on one attacked vehicle, alone and together, and the
// error of each light-weight picture against the full one.
#pragma once

#include <cmath>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "base/image.h"
#include "simulation/insertion.h"
#include "validation/fidelity/vehicle_result.h"
#include "validation/reference/host_scene.h"

namespace mirage {

// One attacked vehicle against the reference renderer: the steps of `mirage validate`.

/// Matched light: the reference at the pixels' centres against the rasteriser at its hard limit (σ → 0, γ →
/// 0), nothing in front of the object. Pictures are composites over the photograph.
struct MatchedLight : MatchedResult {
  PixelRect rect;
  ImageF raster, cycles;            ///< RGB
  ImageF raster_mask, cycles_mask;  ///< 1 channel, 0 or 1
};
MatchedLight matched_light(ReferenceRenderer& renderer, const HostScene& scene);

/// LiDAR: the simulated returns, and every ray of the sensor model that passes near the object, against the
/// reference's. Only the figures of rays are set.
MatchedResult check_lidar(ReferenceRenderer& renderer, const HostScene& scene, const Simulated& simulated);

/// Monte Carlo noise of the full render over the object's pixels: mean |Δ| from its expectation over the mean
/// radiance, estimated from two independent renders of `samples` samples.
struct Noise {
  int samples = 8;
  double relative = 0;
  /// The noise at another number of samples: it falls with their root (Cycles' falls faster).
  double at(int other) const { return relative * std::sqrt(static_cast<double>(samples) / other); }
};
/// From two extra renders of 8 samples, before the number of samples is chosen.
Noise measure_noise(ReferenceRenderer& renderer, const HostScene& scene, const Simulated& simulated);
/// From two renders that exist already. `mask`: the object's pixels.
Noise noise_of(const Halves& halves, const ImageF& mask, int samples);
/// Samples, 4 to 4096, that bring the noise down to `target`.
int samples_for(const Noise& noise, double target);

/// The physically based picture: sun with shadows, occluded sky, 4 bounces, specular, shadow and reflected
/// light of host and road; composited over the photograph behind the photograph's own occluders.
struct FullLight {
  PixelRect rect;
  ImageF image;           ///< the whole photograph with the object in it
  ImageF raster, cycles;  ///< rect-sized RGB, as the photograph saturates
  Halves radiance;        ///< rect-sized: before it saturates, and without the shadow that the object casts
  ImageF coverage;        ///< rect-sized: how much of each pixel the visible object covers in Cycles
  ImageF mask;            ///< rect-sized: visible object pixels of Cycles, where it covers more than half
  ImageF visible;         ///< rect-sized: share of the object that the photograph's occluders leave
  int samples = 0;        ///< of the picture, in both halves together
  double seconds = 0;
};

/// The error over the pixels in which either picture shows the object, even in part, as shares of the
/// object's mean radiance in `reference` over full.mask. Nothing is clamped. `coverage`: of `drawn`.
SquaredError error_to(const Halves& reference, const Halves& drawn, const ImageF& coverage,
                      const FullLight& full);
/// The rasteriser's picture as attacked against this full light's.
SquaredError raster_error(const HostScene& scene, const Simulated& simulated, const FullLight& full);

FullLight full_light(ReferenceRenderer& renderer, const HostScene& scene, const Simulated& simulated);

/// Without what the detector makes of it.
struct LadderRung : LightRungResult {
  ImageF picture;  ///< full.rect-sized composite over the photograph
};

struct LightLadder {
  std::vector<LadderRung> rungs;
  ReferenceResult reference;  ///< the reference of `to_full`
};

/// Raster rungs, which Mirage draws itself. "hard": hard edges, the plain light. "soft": the picture as
/// attacked, with the scene's own settings. Then the hard one with the lighting done on sRGB numbers ("sRGB
/// shading"), with the hemisphere's light spread evenly ("uniform ambient"), with the light model with
/// visibility ("visible light"), and with the effects of the lens ("lens") and the sensor ("sensor"). Cycles
/// rungs: matched light over the pixels' area, then that with each effect alone and with several. Samples:
/// the full render (`full`) and that with fewer samples. Every rung of Cycles is drawn as two independent
/// halves. Rungs share their seeds, so that Monte Carlo noise cancels in `change`; the reference has others,
/// and two halves of twice the samples, so that it does not in `to_full`.
LightLadder light_ladder(ReferenceRenderer& renderer, const HostScene& scene, const FullLight& full);

/// The raster rungs that scene_features draws.
inline const std::set<std::string> kFeatureRungs = {"hard", "soft", "visible light"};

// Features of a scene that predict, in milliseconds, which effects of light it needs (budget.h).

/// By name: the sun's elevation (rad), its azimuth against the camera (cosine; 1: it stands behind the
/// camera) and against the vehicle's heading, its share of the light, the roof's height over the road (m),
/// the vehicle's range (m), the camera's elevation seen from the roof (rad), log of the object's pixels, its
/// visible share; and, from three light-weight renders, soft_change and light_change: the relative change of
/// the object's visible pixels from hard edges to soft ones and from the plain light model to the one with
/// visibility. `simulated`: the scene's object, with the scene's settings; an object of no pixel changes
/// nothing.
std::map<std::string, double> scene_features(const HostScene& scene, const Simulated& simulated);

// The change that each effect of the LiDAR makes in the returns on one attacked vehicle.

/// Without what the detector makes of it.
struct LidarRung : LidarRungResult {
  Sweep sweep;  ///< the frame's sweep with the object in it, for the detector
};

/// The effects of all rungs together, as a unit of the frame's kind adds them to thin noiseless rays. The
/// scene's seed draws random effects.
LidarEffects realistic_returns(const HostScene& scene);

/// "ideal" (thin noiseless rays), then range noise (2 cm, an HDL-64E's), drop-out (10 %), divergence (the
/// unit's, or 2 mrad where its file has none), motion (15 m/s ahead, a yaw rate of 0.2 rad/s) and all
/// together. Returns are matched by beam and firing; one counts as moved beyond 1 mm.
std::vector<LidarRung> lidar_ladder(const HostScene& scene);

}  // namespace mirage
