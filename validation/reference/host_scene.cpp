#include "validation/reference/host_scene.h"

#include <algorithm>

#include "base/sizes.h"
#include "sensors/raster/limits.h"

namespace mirage {

SimulationSettings hard_limit(SimulationSettings settings, bool occluded) {
  settings.raster.sigma = kHardSigma;
  settings.raster.gamma = 1e-6;
  settings.exact_coverage = false;  // which has no σ, no γ and no samples
  settings.light = LightModel::plain;
  settings.supersampling = 1;  // Cycles' matched render samples pixel centres
  if (!occluded) settings.occlusion_margin = 1e9;
  return settings;
}

HostScene scene_of(const HostInWorld& host, const TexturedMesh& adversary) {
  HostScene scene;
  scene.prepared = &host.prepared;
  scene.host = &label_of(host.prepared.frame, host.host);
  scene.placement = host.placement;
  scene.adversary = adversary;
  scene.placed = place(adversary, host.placement);
  scene.simulation = host.simulation;
  return scene;
}

Simulated simulate_host(const HostScene& scene, const SimulationSettings& settings) {
  return simulate(*scene.prepared, scene.placement, scene.adversary, settings);
}

namespace {

/// Of a label, once `camera` and the first have changed places.
void renumber(Label& label, std::size_t camera) {
  const int turned = static_cast<int>(camera);
  label.camera = label.camera == turned ? 0 : label.camera == 0 ? turned : label.camera;
}

}  // namespace

PreparedFrame facing(const PreparedFrame& prepared, std::size_t camera) {
  PreparedFrame turned = prepared;
  if (camera == 0) return turned;
  Frame& frame = turned.frame;
  const Frame& from = prepared.frame;
  frame.image = from.image_of(camera);
  frame.calibration = from.calibration_of(camera);
  frame.camera = from.name_of(camera);
  turned.depth = prepared.depth_of(camera);
  frame.others[camera - 1] = {from.camera, from.calibration,
                              Lazy<ImageF>([image = from.image] { return image; })};
  turned.other_depths[camera - 1] = Lazy<ImageF>([depth = prepared.depth] { return depth; });
  for (Label& label : frame.labels) renumber(label, camera);
  return turned;
}

HostScene facing(const HostScene& scene, const PreparedFrame& turned, std::size_t camera) {
  HostScene there = scene;
  there.prepared = &turned;
  there.host = &turned.frame.labels[as_size(scene.host - scene.prepared->frame.labels.data())];
  if (there.placement.carrier) renumber(there.placement.carrier->label, camera);
  for (Label& target : there.placement.targets) renumber(target, camera);
  return there;
}

ImageF coverage_of(const Simulated& simulated, const PixelRect& rect) {
  ImageF coverage(rect.width(), rect.height(), 1);
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u)
      coverage.at(u - rect.u0, v - rect.v0) = static_cast<float>(rgba_at(simulated, u, v, 3));
  return coverage;
}

void composite(const Rendered& render, const ImageF& visible, ImageF& picture) {
  for (int v = 0; v < picture.height; ++v)
    for (int u = 0; u < picture.width; ++u) {
      const float shown = visible.empty() ? 1 : visible.at(u, v);
      const float alpha = std::clamp(render.rgba.at(u, v, 3), 0.0f, 1.0f);
      for (int c = 0; c < 3; ++c) {
        const float shadow = render.catcher.empty() ? 1 : 1 + shown * (render.catcher.at(u, v, c) - 1);
        picture.at(u, v, c) =
            shown * render.rgba.at(u, v, c) + (1 - shown * alpha) * picture.at(u, v, c) * shadow;
      }
    }
}

ImageF alpha_mask(const ImageF& rgba) {
  ImageF mask(rgba.width, rgba.height, 1);
  for (int v = 0; v < rgba.height; ++v)
    for (int u = 0; u < rgba.width; ++u) mask.at(u, v) = rgba.at(u, v, 3) > 0.5f ? 1.0f : 0.0f;
  return mask;
}

ImageF visible_share(const HostScene& scene, const PixelRect& rect) {
  const Simulated all = simulate_host(scene, hard_limit(scene.simulation, false));
  const Simulated seen = simulate_host(scene, hard_limit(scene.simulation, true));
  ImageF share(rect.width(), rect.height(), 1, 1.0f);
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u)
      for (int reach = 0; reach <= 1; ++reach) {
        double whole = 0, left = 0;
        for (int dv = -reach; dv <= reach; ++dv)
          for (int du = -reach; du <= reach; ++du) {
            whole += rgba_at(all, u + du, v + dv, 3);
            left += rgba_at(seen, u + du, v + dv, 3);
          }
        if (whole < 0.5) continue;
        share.at(u - rect.u0, v - rect.v0) = static_cast<float>(std::clamp(left / whole, 0.0, 1.0));
        break;
      }
  return share;
}

RenderJob job_for(const HostScene& scene, const PixelRect& rect) {
  RenderJob job;
  job.scene = scene.glb;
  job.output = scene.scratch / "render.exr";
  job.rect = rect;
  job.samples = scene.samples;
  job.seed = scene.seed;
  return job;
}

RenderedHalves render_halves(ReferenceRenderer& renderer, RenderJob job, std::uint64_t seed,
                             RenderStream stream) {
  job.samples = (job.samples + 1) / 2;
  job.seed = seed + static_cast<std::uint64_t>(stream);
  RenderedHalves halves;
  halves.first = renderer.render(job);
  ++job.seed;
  halves.second = renderer.render(job);
  halves.seconds = halves.first.seconds + halves.second.seconds;
  return halves;
}

ImageF coverage_of(const RenderedHalves& rendered, const ImageF& visible) {
  const ImageF &a = rendered.first.rgba, &b = rendered.second.rgba;
  ImageF coverage(a.width, a.height, 1);
  for (int v = 0; v < a.height; ++v)
    for (int u = 0; u < a.width; ++u)
      coverage.at(u, v) = (visible.empty() ? 1 : visible.at(u, v)) * 0.5f * (a.at(u, v, 3) + b.at(u, v, 3));
  return coverage;
}

Halves over(const RenderedHalves& rendered, const ImageF& visible, const ImageF& photograph) {
  Halves halves{photograph, photograph};
  composite({rendered.first.rgba, {}, 0}, visible, halves.first);
  composite({rendered.second.rgba, {}, 0}, visible, halves.second);
  return halves;
}

PixelRect grown(const PixelRect& rect, int by, const ImageF& image) {
  return {std::max(0, rect.u0 - by), std::max(0, rect.v0 - by), std::min(image.width, rect.u1 + by),
          std::min(image.height, rect.v1 + by)};
}

PixelRect full_rect(const Simulated& simulated, const ImageF& photograph) {
  const PixelRect& touched = simulated.rect;
  return grown(touched, std::max(8, std::max(touched.width(), touched.height()) / 4), photograph);
}

ImageF with_window(const ImageF& image, const ImageF& window, const PixelRect& rect) {
  ImageF out = image;
  for (int v = 0; v < window.height; ++v)
    std::copy_n(window.pixel(0, v), as_size(window.width) * as_size(window.channels),
                out.pixel(rect.u0, rect.v0 + v));
  return out;
}

void saturate(ImageF& image) {
  for (float& value : image.data) value = std::clamp(value, 0.0f, 1.0f);
}

RenderEffects full_effects(RenderEffects::Surroundings surroundings) {
  return {.shadows = true, .sky = true, .bounces = 4, .specular = true, .surroundings = surroundings};
}

}  // namespace mirage
