#include "validation/fidelity/ladders.h"

#include <algorithm>
#include <stdexcept>
#include <tuple>

#include "base/schedule.h"
#include "base/sizes.h"
#include "sensors/ray_caster.h"
#include "simulation/adversary_lidar.h"
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
      const Vec3d towards = drawn.camera.unproject(u + of.rect.u0, v + of.rect.v0, 1);
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

constexpr double kFilterWidth = 1.5;  // px, the default of Blender's filter
constexpr int kReferenceFactor = 4;   // samples of the reference over the rungs'

/// A Cycles rung.
struct Recipe {
  std::string effect, group, base;
  RenderEffects effects;
  int samples = 0;  ///< 0: the scene's
  double filter_width = 0;
  bool blurred = false;
};

std::vector<Recipe> recipes(int samples) {
  using Surroundings = RenderEffects::Surroundings;
  const auto none = Surroundings::none;
  const auto unseen = Surroundings::unseen;
  const RenderEffects all = full_effects(unseen);
  RenderEffects painted = all, clear = all;
  painted.paint = true;
  clear.clear_sky = true;
  const RenderEffects shadows{.shadows = true, .surroundings = unseen};
  RenderEffects cast = shadows;
  cast.surroundings = Surroundings::catcher;
  std::vector<Recipe> list = {
      {"+pixel area", "cycles", "centres", {}},
      {"+pixel filter", "cycles", "+pixel area", {}, 0, kFilterWidth},
      {"+camera blur", "cycles", "+pixel area", {}, 0, 0, true},
      {"+shadows", "cycles", "+pixel area", shadows},
      {"+cast shadow", "cycles", "+shadows", cast},
      {"+occlusion", "cycles", "+pixel area", {.sky = true, .surroundings = unseen}},
      {"+shadows+occlusion", "cycles", "+pixel area", {.shadows = true, .sky = true, .surroundings = unseen}},
      {"+bounces1",
       "cycles",
       "+pixel area",
       {.shadows = true, .sky = true, .bounces = 1, .surroundings = unseen}},
      {"+bounces4",
       "cycles",
       "+pixel area",
       {.shadows = true, .sky = true, .bounces = 4, .surroundings = unseen}},
      {"+specular", "cycles", "+pixel area", {.specular = true, .surroundings = none}},
      {"all", "cycles", "+pixel area", all},
      {"+car paint", "cycles", "all", painted},
      {"+clear sky", "cycles", "all", clear},
  };
  for (const int fewer : {4, 16})
    if (fewer < samples)
      list.push_back(
          {"full, " + std::to_string(fewer) + " samples", "samples", "reference", full_effects(), fewer});
  return list;
}

/// Composites both halves, with the object's shadow, over the photograph; returns their mean, clipped as the
/// photograph clips.
ImageF picture_of(const RenderedHalves& rendered, const ImageF& visible, const ImageF& photograph) {
  Halves seen{photograph, photograph};
  composite(rendered.first, visible, seen.first);
  composite(rendered.second, visible, seen.second);
  ImageF picture = seen.mean();
  saturate(picture);
  return picture;
}

constexpr double kMoved = 1e-3;       // m
constexpr double kRangeSigma = 0.02;  // m, HDL-64E's data sheet
constexpr double kDropOut = 0.1;      // share

/// The key of a ray: its beam and firing, and its direction if another return shares both.
using RayKey = std::tuple<int, int, long, long>;

std::map<RayKey, Vec3d> by_ray(const LidarTape& tape, const Sweep& sweep) {
  std::map<RayKey, Vec3d> points;
  for (std::size_t i = 0; i < tape.returns.size(); ++i) {
    const LidarTape::Return& back = tape.returns[i];
    RayKey key{back.beam, back.firing, 0, 0};
    if (back.firing < 0)
      key = {back.beam, back.firing,
             std::lround(1e6 * std::atan2(back.ray.direction.y(), back.ray.direction.x())),
             std::lround(1e6 * back.ray.direction.z())};
    points[key] = sweep[tape.first + i].position().cast<double>();
  }
  return points;
}

// The rungs that Mirage draws itself, and the features that predict which effects a scene needs.

/// The frame and the mesh with sRGB numbers in the place of radiances: as in a renderer that multiplies light
/// into the texture's bytes.
Simulated simulate_in_srgb(const HostScene& scene, const SimulationSettings& settings) {
  PreparedFrame prepared = *scene.prepared;
  for (float& value : prepared.frame.image.data) value = srgb_from_linear(value);
  HostScene bytes = scene;
  bytes.prepared = &prepared;
  for (Vec3d& texel : bytes.adversary.atlas.texels)
    for (double& channel : texel) channel = srgb_from_linear(static_cast<float>(channel));
  Simulated simulated = simulate_host(bytes, settings);
  for (float& value : simulated.image.data) value = linear_from_srgb(value);
  for (int v = 0; v < simulated.rgba.height; ++v)
    for (int u = 0; u < simulated.rgba.width; ++u)
      for (int c = 0; c < 3; ++c)
        simulated.rgba.at(u, v, c) = linear_from_srgb(static_cast<float>(simulated.rgba.at(u, v, c)));
  return simulated;
}

Simulated simulate_uniform(const HostScene& scene, const SimulationSettings& settings) {
  PreparedFrame prepared = *scene.prepared;
  Lighting& light = prepared.frame.lighting;
  light.ambient += light.hemisphere / 2;
  light.hemisphere.setZero();
  HostScene uniform = scene;
  uniform.prepared = &prepared;
  return simulate_host(uniform, settings);
}

/// In order (ladders.h).
const char* const kRasterRungs[] = {"hard",
                                    "soft",
                                    "sRGB shading",
                                    "uniform ambient",
                                    "visible light",
                                    "visible light, exact areas",
                                    "fine light, exact areas",
                                    "lens",
                                    "sensor"};

Simulated draw_raster_rung(const std::string& rung, const HostScene& scene) {
  if (rung == "soft") return simulate_host(scene, scene.simulation);
  SimulationSettings settings = hard_limit(scene.simulation, true);
  settings.supersampling = scene.simulation.supersampling;
  if (rung == "sRGB shading") return simulate_in_srgb(scene, settings);
  if (rung == "uniform ambient") return simulate_uniform(scene, settings);
  if (rung.ends_with(", exact areas")) settings.exact_coverage = true;
  if (rung.starts_with("visible light"))
    settings.light = LightModel::visible;
  else if (rung == "fine light, exact areas")
    settings.light = LightModel::fine;
  else if (rung == "lens")
    settings.camera_effects = parse_camera_effects("blur");
  else if (rung == "sensor")
    settings.camera_effects = parse_camera_effects("noise");
  else if (rung != "hard")
    throw std::logic_error("no rung of the rasteriser: " + rung);
  return simulate_host(scene, settings);
}

/// From the rung "hard" to two others, as a camera sees them.
void add_changes(const HostScene& scene, const PixelRect& rect, std::map<std::string, double>& features) {
  const ImageF& photograph = scene.prepared->frame.image;
  const auto picture = [&](const Simulated& drawn) {
    ImageF window = radiance_of(drawn, photograph, rect);
    saturate(window);
    return window;
  };
  const Simulated hard = draw_raster_rung("hard", scene);
  ImageF mask = coverage_of(hard, rect);
  const ImageF from = picture(hard);
  features["soft_change"] = relative_error(from, picture(draw_raster_rung("soft", scene)), mask);
  features["light_change"] = relative_error(from, picture(draw_raster_rung("visible light", scene)), mask);
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
  const std::size_t first = simulated.sweep.size() - as_size(simulated.adversary_points);
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
  const double mean = mean_of(halves.mean(), mask);
  // Two independent renders differ by √2 times what one is off.
  if (mean > 0)
    noise.relative = mean_absolute_error(halves.first, halves.second, mask) / std::sqrt(2.0) / mean;
  return noise;
}

int samples_for(const Noise& noise, double target) {
  const double needed = std::ceil(noise.samples * std::pow(noise.relative / target, 2));
  return static_cast<int>(std::clamp<double>(needed, 4, 4096));
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
  result.cycles = picture_of(rendered, result.visible, window);
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
  return squared_error(drawn, reference, region, pixels, mean_of(reference.mean(), full.mask));
}

SquaredError raster_error(const HostScene& scene, const Simulated& simulated, const FullLight& full) {
  return error_to(full.radiance, {radiance_of(simulated, scene.prepared->frame.image, full.rect), {}},
                  coverage_of(simulated, full.rect), full);
}

LightLadder light_ladder(ReferenceRenderer& renderer, const HostScene& scene, const FullLight& full) {
  const ImageF photograph = crop(scene.prepared->frame.image, full.rect);
  LightLadder result;
  std::vector<LadderRung>& ladder = result.rungs;
  RenderJob job = job_for(scene, full.rect);
  job.samples = result.reference.samples = kReferenceFactor * scene.samples;
  job.effects = full_effects();
  std::map<std::string, ImageF> pictures;
  Halves reference;
  {
    const RenderedHalves rendered = render_halves(renderer, job, scene.seed, RenderStream::reference);
    result.reference.seconds = rendered.seconds;
    reference = over(rendered, full.visible, photograph);
    pictures["reference"] = picture_of(rendered, full.visible, photograph);
    // Without noise of its own and with no error, what is left is the reference's.
    const Halves itself{reference.mean(), {}};
    result.reference.noise = std::sqrt(error_to(reference, itself, full.coverage, full).floor);
  }
  const auto add = [&](const std::string& effect, const std::string& group, const std::string& base,
                       double seconds, ImageF picture, const Halves& object, const ImageF& coverage) {
    pictures[effect] = picture;
    const ImageF& from = pictures.at(base);
    ladder.push_back({{effect, group, base, change(from, picture, full.mask), change(from, picture, {}),
                       change(pictures.at("reference"), picture, full.mask),
                       error_to(reference, object, coverage, full), seconds, std::nullopt},
                      std::move(picture)});
  };

  for (const std::string effect : kRasterRungs) {
    const auto start = Clock::now();
    const Simulated simulated = draw_raster_rung(effect, scene);
    const double seconds = seconds_since(start);
    const ImageF radiance = radiance_of(simulated, scene.prepared->frame.image, full.rect);
    ImageF picture = radiance;
    saturate(picture);
    if (effect == "hard") pictures["hard"] = picture;
    add(effect, "raster", "hard", seconds, std::move(picture), {radiance, {}},
        coverage_of(simulated, full.rect));
  }

  RenderJob centres = job;
  centres.effects = {};
  centres.samples = 1;
  centres.pixel_centre = true;
  centres.seed = scene.seed + static_cast<std::uint64_t>(RenderStream::rungs);
  ImageF matched = photograph;
  composite(renderer.render(centres), full.visible, matched);
  saturate(matched);
  pictures["centres"] = std::move(matched);
  for (const Recipe& recipe : recipes(scene.samples)) {
    job.effects = recipe.effects;
    job.samples = recipe.samples > 0 ? recipe.samples : scene.samples;
    job.filter_width = recipe.filter_width;
    RenderedHalves rendered = render_halves(renderer, job, scene.seed, RenderStream::rungs);
    if (recipe.blurred)
      for (Rendered* half : {&rendered.first, &rendered.second})  // its shadow is smooth already
        soften(half->rgba, kLensBlur);
    add(recipe.effect, recipe.group, recipe.base, rendered.seconds,
        picture_of(rendered, full.visible, photograph), over(rendered, full.visible, photograph),
        coverage_of(rendered, full.visible));
  }
  add("full", "samples", "reference", full.seconds, full.cycles, full.radiance, full.coverage);
  return result;
}

LidarEffects realistic_returns(const HostScene& scene) {
  LidarEffects all = parse_lidar_effects("divergence,motion", scene.prepared->lidar.divergence);
  all.range_sigma = kRangeSigma;
  all.drop_out = kDropOut;
  all.seed = scene.seed;
  return all;
}

std::vector<LidarRung> lidar_ladder(const HostScene& scene) {
  const LidarEffects ideal, all = realistic_returns(scene);
  LidarEffects noise, drop_out, divergence, motion;
  noise.range_sigma = all.range_sigma;
  drop_out.drop_out = all.drop_out;
  divergence.divergence = all.divergence;
  motion.velocity = all.velocity;
  motion.yaw_rate = all.yaw_rate;
  std::map<RayKey, Vec3d> reference;
  std::vector<LidarRung> ladder;
  for (const auto& [name, effects] :
       {std::pair("ideal", ideal), std::pair("noise", noise), std::pair("drop-out", drop_out),
        std::pair("divergence", divergence), std::pair("motion", motion), std::pair("all", all)}) {
    SimulationSettings settings = scene.simulation;
    settings.lidar_effects = effects;
    settings.lidar_effects.seed = scene.seed;
    LidarRung rung;
    rung.effect = name;
    Simulated simulated;
    const auto start = Clock::now();
    const LidarTape tape = draw_in_lidar(*scene.prepared, scene.placed, settings, simulated);
    rung.seconds = seconds_since(start);
    const auto points = by_ray(tape, simulated.sweep);
    if (ladder.empty()) reference = points;
    std::size_t changed = 0, either = reference.size();
    for (const auto& [ray, point] : points) {
      const auto same = reference.find(ray);
      either += same == reference.end();
      changed += same == reference.end() || (same->second - point).norm() > kMoved;
    }
    for (const auto& [ray, point] : reference) changed += !points.contains(ray);
    const double count = std::max<double>(1, static_cast<double>(reference.size()));
    rung.returns = static_cast<int>(points.size());
    rung.changed = static_cast<double>(changed) / std::max<double>(1, static_cast<double>(either));
    rung.returns_change =
        (static_cast<double>(points.size()) - static_cast<double>(reference.size())) / count;
    rung.sweep = std::move(simulated.sweep);
    ladder.push_back(std::move(rung));
  }
  return ladder;
}

std::map<std::string, double> scene_features(const HostScene& scene, const Simulated& simulated) {
  const Frame& frame = scene.prepared->frame;
  const Lighting& light = frame.lighting;
  const Vec3d roof = bounds(scene.placed.mesh).center();
  const Vec3d to_camera = frame.calibration.camera_from_velo.inverse().translation() - roof;
  const double yaw = scene.host->box.bev.yaw;
  const auto cosine = [](const Vec3d& a, const Vec3d& b) {
    const double lengths = a.head<2>().norm() * b.head<2>().norm();
    return lengths > 1e-9 ? a.head<2>().dot(b.head<2>()) / lengths : 0;
  };
  const auto brightness = [](const Vec3d& rgb) { return rgb.mean(); };
  const double sun = brightness(light.sun) * std::max(0.0, light.to_sun_velo.z()),
               sky = brightness(light.ambient + light.hemisphere);
  std::map<std::string, double> features = {
      {"sun_elevation", std::asin(std::clamp(light.to_sun_velo.z(), -1.0, 1.0))},
      {"sun_behind_camera", cosine(light.to_sun_velo, to_camera)},
      {"sun_along_heading", cosine(light.to_sun_velo, Vec3d(std::cos(yaw), std::sin(yaw), 0))},
      {"sun_share", sun + sky > 0 ? sun / (sun + sky) : 0},
      {"roof_height", bounds(scene.placed.mesh).min().z() - scene.host->box.bottom},
      {"range", horizontal_distance(scene.host->box.bev)},
      {"camera_elevation", std::atan2(to_camera.z(), to_camera.head<2>().norm())},
      {"log_pixels", std::log(1.0 + simulated.adversary_pixels)},
      {"visible_share", simulated.visible_share},
      {"soft_change", 0},
      {"light_change", 0}};
  if (const PixelRect rect = full_rect(simulated, frame.image); !simulated.rect.empty())
    add_changes(scene, rect, features);
  return features;
}

}  // namespace mirage
