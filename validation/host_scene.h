// One attacked vehicle as the validation's steps see it, and how a render is laid over the photograph.
#pragma once

#include <cstdint>
#include <filesystem>

#include "base/image.h"
#include "scene/insertion.h"
#include "scene/render_scene.h"
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

/// The rasteriser at its hard limit (σ → 0, γ → 0) at the pixels' centres, with the plain light model.
/// `occluded`: behind the photograph's depth, as in an attack.
SimulationSettings hard_limit(SimulationSettings settings, bool occluded);
Simulated simulate_host(const HostScene& scene, const SimulationSettings& settings);

/// Value of a channel of `simulated` at a pixel of the photograph; 0 outside its window.
double rgba_at(const Simulated& simulated, int u, int v, int c);

/// Share of the object that the photograph's depth lets through at each pixel of the window. Pixels that the
/// object covers in part only, and so not at their centre, take their neighbours' share.
ImageF visible_share(const HostScene& scene, const PixelRect& rect);

/// A job with the scene's files, samples and seed.
RenderJob job_for(const HostScene& scene, const PixelRect& rect);
/// Everything: sun with shadows, occluded sky, 4 bounces, specular, shadow on host and road.
RenderEffects full_effects();

/// foreground + (1 − α) background · shadow, in linear light, onto `picture` (the photograph's window).
/// `visible` scales the object; where it is hidden (something of the photograph is in front) there is no
/// shadow either. Empty: all visible.
void composite(const Rendered& render, const ImageF& visible, ImageF& picture);
/// Pixels of which the object covers more than half.
ImageF alpha_mask(const ImageF& rgba, const ImageF& visible = {});

/// The image with the window laid over it.
ImageF with_window(const ImageF& image, const ImageF& window, const PixelRect& rect);
/// Values into [0, 1], as the photograph saturates.
void saturate(ImageF& image);
/// `rect` grown by `by` pixels to every side, kept inside the image.
PixelRect grown(const PixelRect& rect, int by, const ImageF& image);

}  // namespace mirage
