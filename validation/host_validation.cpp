#include "validation/host_validation.h"

#include <algorithm>
#include <cmath>

#include "sensors/ray_caster.h"
#include "validation/fidelity.h"

namespace mirage {
namespace {

constexpr double kSameReturn = 0.01;  // m; returns of neighbouring rays lie further apart

/// The rasteriser at its hard limit. `occluded`: behind the photograph's depth, as in an attack.
SimulationSettings hard_limit(SimulationSettings settings, bool occluded) {
  settings.raster.sigma =
      1e-18;  // blends over 1e-6 px; 1e-12 would over 2e-3 px, which is visible in the mean
  settings.raster.gamma = 1e-6;
  settings.supersampling = 1;  // Cycles' matched render samples pixel centres
  if (!occluded) settings.occlusion_margin = 1e9;
  return settings;
}

Simulated simulate_host(const HostScene& scene, const SimulationSettings& settings) {
  return simulate(*scene.prepared, *scene.host, scene.rooftop, scene.adversary, settings);
}

/// Value of a channel of `simulated` at a pixel of the photograph; 0 outside its window.
double rgba_at(const Simulated& simulated, int u, int v, int c) {
  const PixelRect& r = simulated.rect;
  if (u < r.u0 || u >= r.u1 || v < r.v0 || v >= r.v1) return 0;
  return simulated.rgba.at(u - r.u0, v - r.v0, c);
}

/// foreground + (1 − α) background · shadow, in linear light. `visible` scales the object; where it is hidden
/// (something of the photograph is in front) there is no shadow either.
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

ImageF alpha_mask(const ImageF& rgba, const ImageF& visible = {}) {
  ImageF mask(rgba.width, rgba.height, 1);
  for (int v = 0; v < rgba.height; ++v)
    for (int u = 0; u < rgba.width; ++u)
      mask.at(u, v) = rgba.at(u, v, 3) * (visible.empty() ? 1 : visible.at(u, v)) > 0.5f ? 1.0f : 0.0f;
  return mask;
}

/// Share of the object that the photograph's depth lets through at each pixel of the window. Pixels that the
/// object covers in part only, and so not at their centre, take their neighbours' share.
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

/// Every ray of the sweep that may meet the mesh, with or without a measured return.
std::vector<LidarRay> rays_near(const PreparedFrame& prepared, const Mesh& mesh) {
  const Eigen::AlignedBox3d box = bounds(mesh);
  std::vector<LidarRay> rays;
  for (const SweepRay& sent : prepared.index.rays_through(box.center(), box.diagonal().norm() / 2))
    rays.push_back(sent.ray);
  return rays;
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

}  // namespace

ImageF crop(const ImageF& image, const PixelRect& rect) {
  ImageF out(rect.width(), rect.height(), image.channels);
  for (int v = 0; v < out.height; ++v)
    std::copy_n(image.pixel(rect.u0, rect.v0 + v), static_cast<std::size_t>(out.width) * image.channels,
                out.pixel(0, v));
  return out;
}

PixelRect grown(const PixelRect& rect, int by, const ImageF& image) {
  return {std::max(0, rect.u0 - by), std::max(0, rect.v0 - by), std::min(image.width, rect.u1 + by),
          std::min(image.height, rect.v1 + by)};
}

MatchedLight matched_light(BlenderWorker& blender, const HostScene& scene) {
  const ImageF& photograph = scene.prepared->frame.image;
  const Simulated hard = simulate_host(scene, hard_limit(scene.simulation, false));
  MatchedLight result;
  result.rect = grown(hard.rect, 2, photograph);
  RenderJob job = job_for(scene, result.rect);
  job.samples = 1;
  job.pixel_centre = true;
  const Rendered rendered = render(blender, job);
  result.raster = result.cycles = crop(photograph, result.rect);
  composite(rendered, {}, result.cycles);
  result.cycles_mask = alpha_mask(rendered.rgba);
  result.raster_mask = ImageF(result.rect.width(), result.rect.height(), 1);
  ImageF either = result.raster_mask;
  for (int v = result.rect.v0; v < result.rect.v1; ++v)
    for (int u = result.rect.u0; u < result.rect.u1; ++u) {
      const int x = u - result.rect.u0, y = v - result.rect.v0;
      const bool in_raster = rgba_at(hard, u, v, 3) > 0.5, in_cycles = result.cycles_mask.at(x, y) > 0.5f;
      if (in_raster)
        for (int c = 0; c < 3; ++c) result.raster.at(x, y, c) = static_cast<float>(rgba_at(hard, u, v, c));
      result.raster_mask.at(x, y) = in_raster ? 1.0f : 0.0f;
      either.at(x, y) = in_raster || in_cycles ? 1.0f : 0.0f;
      result.mask_both += in_raster && in_cycles;
      result.mask_either += in_raster || in_cycles;
    }
  result.mask_iou = mask_iou(result.raster_mask, result.cycles_mask);
  result.mae = mean_absolute_error(result.raster, result.cycles, either);
  result.max_error = max_absolute_error(result.raster, result.cycles, either);
  for (int v = 0; v < either.height; ++v)
    for (int u = 0; u < either.width; ++u) {
      float worst = 0;
      for (int c = 0; c < 3; ++c)
        worst = std::max(worst, std::abs(result.raster.at(u, v, c) - result.cycles.at(u, v, c)));
      result.pixels_off += either.at(u, v) > 0.5f && worst > 1e-3f;
    }
  return result;
}

LidarCheck check_lidar(BlenderWorker& blender, const HostScene& scene, const Simulated& simulated) {
  LidarCheck result;
  result.returns = simulated.adversary_points;
  const std::vector<LidarRay> rays = rays_near(*scene.prepared, scene.placed.mesh);
  result.rays = static_cast<int>(rays.size());
  const std::vector<double> found = raycast(blender, scene.glb, rays, scene.scratch);
  const RayCaster caster(std::span<const Mesh>(&scene.placed.mesh, 1));
  std::vector<Vec3d> hits;  // Blender's
  for (std::size_t i = 0; i < rays.size(); ++i) {
    Ray ray;
    ray.origin = rays[i].origin.cast<float>();
    ray.direction = rays[i].direction.cast<float>();
    const Hit hit = caster.intersect(ray);
    if (found[i] >= 0) hits.push_back(rays[i].origin + found[i] * rays[i].direction);
    if ((found[i] < 0) == hit.hit())
      ++result.disagreements;
    else if (hit.hit())
      result.range_error = std::max(result.range_error, std::abs(found[i] - static_cast<double>(hit.t)));
  }
  // Each return that the simulation put into the sweep is a place that Blender's rays hit as well.
  const std::size_t first = simulated.sweep.size() - static_cast<std::size_t>(simulated.adversary_points);
  for (std::size_t i = first; i < simulated.sweep.size(); ++i) {
    double nearest = kSameReturn;
    for (const Vec3d& hit : hits)
      nearest = std::min(nearest, (hit - simulated.sweep[i].position().cast<double>()).norm());
    if (nearest < kSameReturn)
      result.range_error = std::max(result.range_error, nearest);
    else
      ++result.disagreements;
  }
  return result;
}

FullLight full_light(BlenderWorker& blender, const HostScene& scene, const Simulated& simulated) {
  const ImageF& photograph = scene.prepared->frame.image;
  FullLight result;
  const PixelRect& touched = simulated.rect;
  // The object's shadow falls on the roof around it.
  result.rect = grown(touched, std::max(8, std::max(touched.width(), touched.height()) / 4), photograph);
  RenderJob job = job_for(scene, result.rect);
  job.effects = {.shadows = true,
                 .sky = true,
                 .bounces = 4,
                 .specular = true,
                 .surroundings = RenderEffects::Surroundings::catcher};
  const Rendered rendered = render(blender, job);
  const ImageF visible = visible_share(scene, result.rect);
  result.cycles = crop(photograph, result.rect);
  composite(rendered, visible, result.cycles);
  for (float& value : result.cycles.data)
    value = std::clamp(value, 0.0f, 1.0f);  // as the photograph saturates
  result.raster = crop(simulated.image, result.rect);
  result.mask = alpha_mask(rendered.rgba, visible);
  result.image = photograph;
  for (int v = 0; v < result.cycles.height; ++v)
    std::copy_n(result.cycles.pixel(0, v), static_cast<std::size_t>(result.cycles.width) * 3,
                result.image.pixel(result.rect.u0, result.rect.v0 + v));
  result.seconds = rendered.seconds;
  return result;
}

std::vector<LadderRung> light_ladder(BlenderWorker& blender, const HostScene& scene) {
  using Surroundings = RenderEffects::Surroundings;
  const auto unseen = Surroundings::unseen;
  const std::vector<std::pair<std::string, RenderEffects>> rungs = {
      {"+pixel area", {}},  // against the pixels' centres: what point sampling does to small texels and edges
      {"+shadows", {true, false, 0, false, unseen}},
      {"+occlusion", {false, true, 0, false, unseen}},
      {"+shadows+occlusion", {true, true, 0, false, unseen}},
      {"+bounces1", {true, true, 1, false, unseen}},
      {"+bounces4", {true, true, 4, false, unseen}},
      {"+specular", {false, false, 0, true, Surroundings::none}},
      {"all", {true, true, 4, true, unseen}},
  };
  const ImageF& photograph = scene.prepared->frame.image;
  const Simulated hard = simulate_host(scene, hard_limit(scene.simulation, false));
  RenderJob job = job_for(scene, grown(hard.rect, 8, photograph));
  RenderJob centres = job;
  centres.samples = 1;
  centres.pixel_centre = true;
  const Rendered sharp = render(blender, centres), base = render(blender, job);
  const auto over_photograph = [&](const Rendered& rendered) {
    ImageF picture = crop(photograph, job.rect);
    composite(rendered, {}, picture);
    return picture;
  };
  const ImageF mask = alpha_mask(base.rgba), sharp_picture = over_photograph(sharp),
               base_picture = over_photograph(base);
  const double mean = mean_absolute_error(base_picture, ImageF(mask.width, mask.height, 3), mask);
  std::vector<LadderRung> ladder;
  for (const auto& [effect, effects] : rungs) {
    const bool first = ladder.empty();
    job.effects = effects;
    const Rendered rendered = first ? base : render(blender, job);
    const ImageF picture = over_photograph(rendered), &from = first ? sharp_picture : base_picture;
    const ImageF seen = encoded(picture), seen_from = encoded(from);
    LadderRung rung;
    rung.effect = effect;
    rung.mae = mean_absolute_error(from, picture, mask);
    rung.relative = mean > 0 ? rung.mae / mean : 0;
    rung.ssim = ssim(grey(seen_from), grey(seen), mask);
    rung.flip = flip(seen_from, seen, mask);
    rung.seconds = rendered.seconds;
    ladder.push_back(rung);
  }
  return ladder;
}

}  // namespace mirage
