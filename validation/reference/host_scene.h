// One attacked vehicle as the validation's steps see it, and how a render is laid over the photograph.
#pragma once

#include <cstdint>
#include <filesystem>

#include "attack/observation.h"
#include "base/image.h"
#include "simulation/insertion.h"
#include "simulation/render_scene.h"
#include "validation/reference/reference_renderer.h"
#include "validation/reference/unbiased_error.h"

namespace mirage {

/// The data that a vehicle's steps share.
struct HostScene {
  const PreparedFrame* prepared = nullptr;
  const Label* host = nullptr;
  Placement placement;
  TexturedMesh adversary, placed;  ///< in the adversary's frame; in `velo`
  SimulationSettings simulation;
  std::filesystem::path glb, scratch;  ///< the exported scene; a folder for temporary files
  int samples = 64;
  std::uint64_t seed = 0;
};

/// The adversary on a host of an attack; no files.
HostScene scene_of(const HostInWorld& host, const TexturedMesh& adversary);

/// The rasteriser at its hard limit (σ → 0, γ → 0) at the pixels' centres, with the plain light model.
/// `occluded`: behind the photograph's depth, as in an attack.
SimulationSettings hard_limit(SimulationSettings settings, bool occluded);
Simulated simulate_host(const HostScene& scene, const SimulationSettings& settings);

/// The frame with `camera` and the first camera swapped; the labels' cameras are numbered accordingly.
PreparedFrame facing(const PreparedFrame& prepared, std::size_t camera);
/// The scene in the frame `turned`, which it refers to. Its files are the same.
HostScene facing(const HostScene& scene, const PreparedFrame& turned, std::size_t camera);

/// The object's silhouette: the share of each pixel of the window that it covers.
ImageF coverage_of(const Simulated& simulated, const PixelRect& rect);

/// Share of the object that the photograph's depth lets through at each pixel of the window. Pixels that the
/// object covers in part only, and so not at their centre, take their neighbours' share.
ImageF visible_share(const HostScene& scene, const PixelRect& rect);

/// A job with the scene's files, samples and seed.
RenderJob job_for(const HostScene& scene, const PixelRect& rect);

/// The random numbers of a render: each stream has its own seeds, and so is independent of the others.
enum class RenderStream : std::uint64_t {
  full = 0,       ///< the picture in full light, which the detector sees
  rungs = 2,      ///< the ladder's rungs: noise cancels between them
  reference = 4,  ///< the reference of their errors
  noise = 6
};
/// The job's picture as two independent renders of half of its samples each (rounded up).
struct RenderedHalves {
  Rendered first, second;
  double seconds = 0;  ///< of both
};
RenderedHalves render_halves(ReferenceRenderer& renderer, RenderJob job, std::uint64_t seed,
                             RenderStream stream);
/// How much of each pixel the object covers, in the mean of the halves; scaled by `visible`.
ImageF coverage_of(const RenderedHalves& rendered, const ImageF& visible);
/// Each half over the photograph's window, not clamped, and without the shadow that the object casts.
Halves over(const RenderedHalves& rendered, const ImageF& visible, const ImageF& photograph);
/// Everything: sun with shadows, occluded sky, 4 bounces, specular; by default the shadow on host and road.
RenderEffects full_effects(RenderEffects::Surroundings surroundings = RenderEffects::Surroundings::catcher);

/// foreground + (1 − α) background · shadow, in linear light, onto `picture` (the photograph's window).
/// `visible` scales the object; where it is hidden behind the photograph there is no shadow either. Empty:
/// all visible.
void composite(const Rendered& render, const ImageF& visible, ImageF& picture);
/// Pixels of which the object covers more than half.
ImageF alpha_mask(const ImageF& rgba);

/// The image with the window laid over it.
ImageF with_window(const ImageF& image, const ImageF& window, const PixelRect& rect);
/// Values into [0, 1], as the photograph saturates.
void saturate(ImageF& image);
/// `rect` grown by `by` pixels to every side, kept inside the image.
PixelRect grown(const PixelRect& rect, int by, const ImageF& image);
/// Window of a render in full light: the object, and the roof around it, where its shadow falls.
PixelRect full_rect(const Simulated& simulated, const ImageF& photograph);

}  // namespace mirage
