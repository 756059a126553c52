// One attacked vehicle against the reference renderer: the steps of `mirage validate`.
#pragma once

#include <cmath>

#include "base/image.h"
#include "validation/fidelity/vehicle_result.h"
#include "validation/reference/host_scene.h"

namespace mirage {

/// Matched light: the reference at the pixels' centres against the rasteriser at its hard limit (σ → 0, γ →
/// 0), nothing in front of the object. Pictures are composites over the photograph.
struct MatchedLight : MatchedResult {
  PixelRect rect;
  ImageF raster, cycles;            ///< RGB
  ImageF raster_mask, cycles_mask;  ///< 1 channel, 0 or 1
};
MatchedLight matched_light(ReferenceRenderer& renderer, const HostScene& scene);

/// LiDAR: the simulated returns, and every ray of the sensor model that passes near the object, against
/// the reference's. The figures of rays alone.
MatchedResult check_lidar(ReferenceRenderer& renderer, const HostScene& scene, const Simulated& simulated);

/// Monte Carlo noise of the full render over the object's pixels: mean |Δ| from its expectation over the mean
/// radiance, told from two independent renders of `samples` samples.
struct Noise {
  int samples = 8;
  double relative = 0;
  /// As it falls with the root of the samples (Cycles' quasi-random ones fall faster).
  double at(int other) const { return relative * std::sqrt(static_cast<double>(samples) / other); }
};
/// Of two renders of 8 samples for the purpose, before it is known how many are wanted.
Noise measure_noise(ReferenceRenderer& renderer, const HostScene& scene, const Simulated& simulated);
/// Of two renders at hand. `mask`: the object's pixels.
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

/// Over the pixels that either draws the object in, even in part; shares of the object's mean radiance in
/// `reference` over full.mask. Nothing is clamped. `coverage`: of what is drawn.
SquaredError error_to(const Halves& reference, const Halves& drawn, const ImageF& coverage,
                      const FullLight& full);
/// The rasteriser's picture as attacked against this full light's.
SquaredError raster_error(const HostScene& scene, const Simulated& simulated, const FullLight& full);

FullLight full_light(ReferenceRenderer& renderer, const HostScene& scene, const Simulated& simulated);

}  // namespace mirage
