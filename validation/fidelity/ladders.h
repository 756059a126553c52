// What each effect of light and of the camera changes on one attacked vehicle, one at a time and together,
// and how far each light-weight picture is from the full one.
#pragma once

#include <string>
#include <vector>

#include "base/image.h"
#include "simulation/insertion.h"
#include "validation/fidelity/host_validation.h"
#include "validation/reference/host_scene.h"

namespace mirage {

/// How far two pictures are apart: mean |Δ| of scene-linear radiance, the same over the mean radiance, PSNR
/// of scene-linear values (infinite where equal), SSIM and FLIP of the sRGB-encoded ones.
struct Change {
  double mae = 0, relative = 0, psnr = 0, ssim = 1, flip = 0;
};
template <class Visitor, FieldsOf<Change> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "mae"}, s.mae);
  visit({.name = "relative"}, s.relative);
  visit({.name = "psnr", .endless = true}, s.psnr);
  visit({.name = "ssim"}, s.ssim);
  visit({.name = "flip"}, s.flip);
}
/// `from` is the reference, whose mean radiance `relative` divides by. `mask` may be empty: all pixels.
Change change(const ImageF& from, const ImageF& to, const ImageF& mask);

struct LadderRung {
  std::string effect;
  std::string group;   ///< "raster": ours; "cycles": effects in Cycles; "samples": the full render with fewer
  std::string base;    ///< the rung (or "centres", "reference") that `change` is against
  Change change;       ///< over the object's visible pixels
  Change crop;         ///< over the whole window: the shadow that the object casts shows here
  Change to_full;      ///< error against the reference over the object's visible pixels, as a camera sees it
  SquaredError error;  ///< of the object alone, before anything saturates (unbiased_error.h, error_to)
  double seconds = 0;
  ImageF picture;  ///< full.rect-sized composite over the photograph
};

struct LightLadder {
  std::vector<LadderRung> rungs;
  int reference_samples = 0;  ///< of the full render that `to_full` is against, in both halves together
  double reference_seconds = 0;
  double reference_noise = 0;  ///< its own error, a share of the object's mean radiance (root mean square)
};

/// Raster rungs: raster_rungs.h. Cycles rungs: matched light over the pixels' area, then that with each
/// effect alone and with several. Samples: the full render (`full`) and that with fewer samples. Every rung
/// of Cycles is drawn as two independent halves. Rungs share their seeds, so that Monte Carlo noise cancels
/// in `change`; the reference has others, and two halves of twice the samples, so that it does not in
/// `to_full`.
LightLadder light_ladder(ReferenceRenderer& renderer, const HostScene& scene, const FullLight& full);

// What each effect of the LiDAR changes in the returns on one attacked vehicle.

struct LidarRung {
  std::string effect;
  int returns = 0;  ///< on the object
  double changed =
      0;  ///< share of the ideal returns that are lost or moved, and new ones, over the ideal count
  double returns_change = 0;  ///< relative change of their number
  double seconds = 0;         ///< of the whole insertion
  Sweep sweep;                ///< the frame's sweep with the object in it, for the detector
};

/// The effects of all rungs together: what a unit of the frame's kind adds to thin noiseless rays. Random
/// ones are drawn by the scene's seed.
LidarEffects realistic_returns(const HostScene& scene);

/// "ideal" (thin noiseless rays), then range noise (2 cm, an HDL-64E's), drop-out (10 %), divergence (the
/// unit's, or 2 mrad where its file has none), motion (15 m/s ahead, a yaw rate of 0.2 rad/s) and all
/// together. Returns are matched by beam and firing; one counts as moved beyond 1 mm.
std::vector<LidarRung> lidar_ladder(const HostScene& scene);

}  // namespace mirage
