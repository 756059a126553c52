// One attacked vehicle against Blender: the steps of `mirage validate`.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/image.h"
#include "scene/insertion.h"
#include "validation/blender_process.h"

namespace mirage {

/// What a vehicle's steps share.
struct HostScene {
  const PreparedFrame* prepared = nullptr;
  const Label* host = nullptr;
  Rooftop rooftop;
  TexturedMesh adversary, placed;  ///< in the adversary's frame; in `velo`
  SimulationSettings simulation;
  std::filesystem::path glb, scratch;  ///< the exported scene; a folder for temporary files
  int samples = 64;
  std::uint64_t seed = 0;
};

/// Matched light: Cycles at the pixels' centres against the rasteriser at its hard limit (σ → 0, γ → 0),
/// nothing in front of the object. Pictures are composites over the photograph.
struct MatchedLight {
  PixelRect rect;
  ImageF raster, cycles;                        ///< RGB
  ImageF raster_mask, cycles_mask;              ///< 1 channel, 0 or 1
  double mask_iou = 1, mae = 0, max_error = 0;  ///< errors over the union of the masks, scene-linear
  int mask_both = 0, mask_either = 0;           ///< pixels
  /// Pixels that are off by more than 1e-3: their centre lies within float32 of a border between texels or
  /// faces.
  int pixels_off = 0;
};
MatchedLight matched_light(BlenderWorker& blender, const HostScene& scene);

/// LiDAR: the simulated returns, and every ray of the sensor model that passes near the object, against
/// Blender's.
struct LidarCheck {
  int returns = 0, rays = 0;
  double range_error = 0;  ///< m, largest over rays that both hit
  int disagreements = 0;   ///< rays that only one of the two sees hit the object
};
LidarCheck check_lidar(BlenderWorker& blender, const HostScene& scene, const Simulated& simulated);

/// The physically based picture: sun with shadows, occluded sky, 4 bounces, specular, shadow and reflected
/// light of host and road; composited over the photograph behind the photograph's own occluders.
struct FullLight {
  PixelRect rect;
  ImageF image;           ///< the whole photograph with the object in it
  ImageF raster, cycles;  ///< rect-sized RGB
  ImageF mask;            ///< rect-sized: visible object pixels of Cycles
  double seconds = 0;
};
FullLight full_light(BlenderWorker& blender, const HostScene& scene, const Simulated& simulated);

/// One effect against matched light, over the object's pixels. The first rung is matched light over the
/// pixels' area against matched light at their centres; the others add light and compare at the same samples.
struct LadderRung {
  std::string effect;
  double mae = 0, relative = 0;  ///< mean |Δ| of scene-linear radiance; the same over the mean radiance
  double ssim = 1, flip = 0;     ///< of the sRGB-encoded composites over the photograph
  double seconds = 0;
};
std::vector<LadderRung> light_ladder(BlenderWorker& blender, const HostScene& scene);

/// Photograph window as float RGB.
ImageF crop(const ImageF& image, const PixelRect& rect);
/// `rect` grown by `by` pixels to every side, kept inside the image.
PixelRect grown(const PixelRect& rect, int by, const ImageF& image);

}  // namespace mirage
