#include "validation/fidelity/ladders.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <tuple>

#include "base/color.h"
#include "base/schedule.h"
#include "simulation/adversary_lidar.h"
#include "validation/fidelity/picture_errors.h"

namespace mirage {
namespace {

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
  const RenderEffects all{
      .shadows = true, .sky = true, .bounces = 4, .specular = true, .surroundings = unseen};
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

}  // namespace

LightLadder light_ladder(ReferenceRenderer& renderer, const HostScene& scene, const FullLight& full) {
  const ImageF photograph = crop(scene.prepared->frame.image, full.rect);
  const auto as_seen = [](ImageF picture) {
    saturate(picture);
    return picture;
  };
  const auto picture_of = [&](const RenderedHalves& rendered) {  // with the shadow that the object casts
    Halves seen{photograph, photograph};
    composite(rendered.first, full.visible, seen.first);
    composite(rendered.second, full.visible, seen.second);
    return as_seen(seen.mean());
  };
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
    pictures["reference"] = picture_of(rendered);
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

  for (const std::string& effect : raster_rungs()) {
    const auto start = Clock::now();
    const Simulated simulated = draw_raster_rung(effect, scene);
    const double seconds = seconds_since(start);
    const ImageF radiance = radiance_of(simulated, scene.prepared->frame.image, full.rect);
    ImageF picture = as_seen(radiance);
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
  pictures["centres"] = as_seen(std::move(matched));
  for (const Recipe& recipe : recipes(scene.samples)) {
    job.effects = recipe.effects;
    job.samples = recipe.samples > 0 ? recipe.samples : scene.samples;
    job.filter_width = recipe.filter_width;
    RenderedHalves rendered = render_halves(renderer, job, scene.seed, RenderStream::rungs);
    if (recipe.blurred)
      for (Rendered* half : {&rendered.first, &rendered.second})  // its shadow is smooth already
        soften(half->rgba, kLensBlur);
    add(recipe.effect, recipe.group, recipe.base, rendered.seconds, picture_of(rendered),
        over(rendered, full.visible, photograph), coverage_of(rendered, full.visible));
  }
  add("full", "samples", "reference", full.seconds, full.cycles, full.radiance, full.coverage);
  return result;
}

namespace {

constexpr double kMoved = 1e-3;       // m
constexpr double kRangeSigma = 0.02;  // m, HDL-64E's data sheet
constexpr double kDropOut = 0.1;      // share

/// What tells a ray: its beam and firing, and where it points for a return that shares both with another.
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

}  // namespace

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
  for (auto& [name, effects] : std::vector<std::pair<std::string, LidarEffects>>{{"ideal", ideal},
                                                                                 {"noise", noise},
                                                                                 {"drop-out", drop_out},
                                                                                 {"divergence", divergence},
                                                                                 {"motion", motion},
                                                                                 {"all", all}}) {
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
    std::size_t changed = 0;
    for (const auto& [ray, point] : points) {
      const auto same = reference.find(ray);
      changed += same == reference.end() || (same->second - point).norm() > kMoved;
    }
    for (const auto& [ray, point] : reference) changed += !points.contains(ray);
    const double count = std::max<double>(1, static_cast<double>(reference.size()));
    rung.returns = static_cast<int>(points.size());
    rung.changed = static_cast<double>(changed) / count;
    rung.returns_change =
        (static_cast<double>(points.size()) - static_cast<double>(reference.size())) / count;
    rung.sweep = std::move(simulated.sweep);
    ladder.push_back(std::move(rung));
  }
  return ladder;
}

// The rungs that Mirage draws itself, and what tells of a scene which effects it needs.

namespace {

/// The frame and the mesh with sRGB numbers in the place of radiances: what a renderer does that multiplies
/// light into the texture's bytes.
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

}  // namespace

const std::vector<std::string>& raster_rungs() {
  static const std::vector<std::string> rungs = {"hard",
                                                 "soft",
                                                 "sRGB shading",
                                                 "uniform ambient",
                                                 "visible light",
                                                 "visible light, exact areas",
                                                 "fine light, exact areas",
                                                 "lens",
                                                 "sensor"};
  return rungs;
}

const std::set<std::string>& feature_rungs() {
  static const std::set<std::string> rungs = {"hard", "soft", "visible light"};
  return rungs;
}

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

namespace {

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

const std::vector<std::string>& scene_feature_names() {
  static const std::vector<std::string> names = {
      "camera_elevation",  "light_change",      "log_pixels",    "range",     "roof_height",  "soft_change",
      "sun_along_heading", "sun_behind_camera", "sun_elevation", "sun_share", "visible_share"};
  return names;
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
      {"range", std::hypot(scene.host->box.bev.x, scene.host->box.bev.y)},
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
