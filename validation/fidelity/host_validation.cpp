#include "validation/fidelity/host_validation.h"

#include <algorithm>
#include <cmath>

#include "sensors/ray_caster.h"
#include "simulation/render_scene.h"
#include "validation/fidelity/picture_errors.h"

namespace mirage {
namespace {

constexpr double kSameReturn = 0.01;  // m; returns of neighbouring rays lie further apart

/// Every ray of the sweep that may meet the mesh, with or without a measured return.
std::vector<LidarRay> rays_near(const PreparedFrame& prepared, const Mesh& mesh) {
  const Eigen::AlignedBox3d box = bounds(mesh);
  std::vector<LidarRay> rays;
  for (const SweepRay& sent : prepared.index.rays_through(box.center(), box.diagonal().norm() / 2))
    rays.push_back(sent.ray);
  return rays;
}

/// Rasteriser's depth at the pixels' centres against the reference's rays through them.
void check_depth(ReferenceRenderer& renderer, const HostScene& scene, MatchedLight& of) {
  const Calibration& calibration = scene.prepared->frame.calibration;
  RenderScene drawn;
  drawn.things.push_back({"adversary", "adversary", scene.placed});
  drawn.camera = calibration.camera;
  drawn.camera_from_velo = calibration.camera_from_velo;
  SceneRenderSettings settings;
  settings.samples = 1;
  settings.rect = of.rect;
  const ImageF depth =
      render_scene(drawn, ImageF(drawn.camera.width, drawn.camera.height, 3), settings).depth;
  const Transform velo_from_camera = calibration.camera_from_velo.inverse();
  std::vector<LidarRay> rays;
  std::vector<std::pair<double, double>> expected;  // depth, and depth per distance
  for (int v = 0; v < depth.height; ++v)
    for (int u = 0; u < depth.width; ++u) {
      if (of.raster_mask.at(u, v) < 0.5f || of.cycles_mask.at(u, v) < 0.5f || !(depth.at(u, v) > 0)) continue;
      const Vec3d towards((u + of.rect.u0 - drawn.camera.cx) / drawn.camera.fx,
                          (v + of.rect.v0 - drawn.camera.cy) / drawn.camera.fy, 1);
      rays.push_back({velo_from_camera.translation(), velo_from_camera.linear() * towards.normalized()});
      expected.emplace_back(depth.at(u, v), 1 / towards.norm());
    }
  const std::vector<double> distances = renderer.raycast(scene.glb, rays, scene.scratch);
  for (std::size_t i = 0; i < distances.size(); ++i) {
    if (distances[i] < 0) continue;  // the pixel's centre lies on the silhouette; the mask IoU has it
    const double off = std::abs(distances[i] * expected[i].second - expected[i].first);
    of.depth_error = std::max(of.depth_error, off);
    of.depth_error_mean += off / static_cast<double>(distances.size());
  }
}

}  // namespace

MatchedLight matched_light(ReferenceRenderer& renderer, const HostScene& scene) {
  const ImageF& photograph = scene.prepared->frame.image;
  const Simulated hard = simulate_host(scene, hard_limit(scene.simulation, false));
  MatchedLight result;
  result.rect = grown(hard.rect, 2, photograph);
  RenderJob job = job_for(scene, result.rect);
  job.samples = 1;
  job.pixel_centre = true;
  const Rendered rendered = renderer.render(job);
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
  check_depth(renderer, scene, result);
  return result;
}

MatchedResult check_lidar(ReferenceRenderer& renderer, const HostScene& scene, const Simulated& simulated) {
  MatchedResult result;
  result.returns = simulated.adversary_points;
  const std::vector<LidarRay> rays = rays_near(*scene.prepared, scene.placed.mesh);
  result.rays = static_cast<int>(rays.size());
  const std::vector<double> distances = renderer.raycast(scene.glb, rays, scene.scratch);
  const RayCaster caster(std::span<const Mesh>(&scene.placed.mesh, 1));
  std::vector<Vec3d> hits;  // the reference's
  for (std::size_t i = 0; i < rays.size(); ++i) {
    Ray ray;
    ray.origin = rays[i].origin.cast<float>();
    ray.direction = rays[i].direction.cast<float>();
    const Hit hit = caster.intersect(ray);
    if (distances[i] >= 0) hits.push_back(rays[i].origin + distances[i] * rays[i].direction);
    if ((distances[i] < 0) == hit.hit())
      ++result.hit_disagreements;
    else if (hit.hit())
      result.range_error = std::max(result.range_error, std::abs(distances[i] - static_cast<double>(hit.t)));
  }
  // Each return that the simulation put into the sweep is a place that the reference's rays hit as well.
  const std::size_t first = simulated.sweep.size() - static_cast<std::size_t>(simulated.adversary_points);
  for (std::size_t i = first; i < simulated.sweep.size(); ++i) {
    double nearest = kSameReturn;
    for (const Vec3d& hit : hits)
      nearest = std::min(nearest, (hit - simulated.sweep[i].position().cast<double>()).norm());
    if (nearest < kSameReturn)
      result.range_error = std::max(result.range_error, nearest);
    else
      ++result.hit_disagreements;
  }
  return result;
}

Noise measure_noise(ReferenceRenderer& renderer, const HostScene& scene, const Simulated& simulated) {
  constexpr int kSamples = 8;
  RenderJob job = job_for(scene, full_rect(simulated, scene.prepared->frame.image));
  job.effects = full_effects();
  job.samples = 2 * kSamples;
  const RenderedHalves rendered = render_halves(renderer, job, scene.seed, RenderStream::noise);
  const ImageF mask = alpha_mask(rendered.second.rgba);
  return noise_of(over(rendered, {}, ImageF(mask.width, mask.height, 3)), mask, kSamples);
}

Noise noise_of(const Halves& halves, const ImageF& mask, int samples) {
  Noise noise;
  noise.samples = samples;
  const double mean = mean_absolute_error(halves.mean(), ImageF(mask.width, mask.height, 3), mask);
  // Two independent renders differ by √2 times what one is off.
  if (mean > 0)
    noise.relative = mean_absolute_error(halves.first, halves.second, mask) / std::sqrt(2.0) / mean;
  return noise;
}

int samples_for(const Noise& noise, double target) {
  const double wanted = std::ceil(noise.samples * std::pow(noise.relative / target, 2));
  return static_cast<int>(std::clamp<double>(wanted, 4, 4096));
}

FullLight full_light(ReferenceRenderer& renderer, const HostScene& scene, const Simulated& simulated) {
  const ImageF& photograph = scene.prepared->frame.image;
  FullLight result;
  result.rect = full_rect(simulated, photograph);
  RenderJob job = job_for(scene, result.rect);
  job.effects = full_effects();
  const RenderedHalves rendered = render_halves(renderer, job, scene.seed, RenderStream::full);
  result.visible = visible_share(scene, result.rect);
  const ImageF window = crop(photograph, result.rect);
  result.radiance = over(rendered, result.visible, window);
  Halves seen{window, window};
  composite(rendered.first, result.visible, seen.first);
  composite(rendered.second, result.visible, seen.second);
  result.cycles = seen.mean();
  saturate(result.cycles);
  result.raster = crop(simulated.image, result.rect);
  result.coverage = coverage_of(rendered, result.visible);
  result.mask = result.coverage;
  for (float& value : result.mask.data) value = value > 0.5f ? 1.0f : 0.0f;
  result.image = with_window(photograph, result.cycles, result.rect);
  result.samples = 2 * ((job.samples + 1) / 2);
  result.seconds = rendered.seconds;
  return result;
}

SquaredError error_to(const Halves& reference, const Halves& drawn, const ImageF& coverage,
                      const FullLight& full) {
  constexpr float kDrawn = 1.0f / 255;  // of a pixel; less changes nothing in a picture of 8 bits
  ImageF region = full.mask;
  double pixels = 0;
  for (std::size_t i = 0; i < region.data.size(); ++i) {
    pixels += full.mask.data[i] > 0.5f;
    region.data[i] = full.coverage.data[i] > 0 || coverage.data[i] > kDrawn ? 1.0f : 0.0f;
  }
  const ImageF picture = reference.mean();
  const double mean =
      mean_absolute_error(picture, ImageF(picture.width, picture.height, picture.channels), full.mask);
  return squared_error(drawn, reference, region, pixels, mean);
}

SquaredError raster_error(const HostScene& scene, const Simulated& simulated, const FullLight& full) {
  return error_to(full.radiance, {radiance_of(simulated, scene.prepared->frame.image, full.rect), {}},
                  coverage_of(simulated, full.rect), full);
}

}  // namespace mirage
