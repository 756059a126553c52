#include "validation/fidelity/ladders.h"

#include <chrono>
#include <cmath>
#include <map>
#include <tuple>

#include "simulation/adversary_lidar.h"
#include "validation/fidelity/picture_errors.h"
#include "validation/fidelity/raster_rungs.h"

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

Change change(const ImageF& from, const ImageF& to, const ImageF& mask) {
  const ImageF seen_from = encoded(from), seen = encoded(to);
  Change result;
  result.mae = mean_absolute_error(from, to, mask);
  result.relative = relative_error(from, to, mask);
  result.psnr = psnr(from, to, mask);
  result.ssim = ssim(grey(seen_from), grey(seen), mask);
  result.flip = flip(seen_from, seen, mask);
  return result;
}

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
  job.samples = result.reference_samples = kReferenceFactor * scene.samples;
  job.effects = full_effects();
  std::map<std::string, ImageF> pictures;
  Halves reference;
  {
    const RenderedHalves rendered = render_halves(renderer, job, scene.seed, RenderStream::reference);
    result.reference_seconds = rendered.seconds;
    reference = over(rendered, full.visible, photograph);
    pictures["reference"] = picture_of(rendered);
    // Without noise of its own and with no error, what is left is the reference's.
    const Halves itself{reference.mean(), {}};
    result.reference_noise = std::sqrt(error_to(reference, itself, full.coverage, full).floor);
  }
  const auto add = [&](const std::string& effect, const std::string& group, const std::string& base,
                       double seconds, ImageF picture, const Halves& object, const ImageF& coverage) {
    pictures[effect] = picture;
    const ImageF& from = pictures.at(base);
    ladder.push_back({effect, group, base, change(from, picture, full.mask), change(from, picture, {}),
                      change(pictures.at("reference"), picture, full.mask),
                      error_to(reference, object, coverage, full), seconds, std::move(picture)});
  };

  for (const std::string& effect : raster_rungs()) {
    const auto start = std::chrono::steady_clock::now();
    const Simulated simulated = draw_raster_rung(effect, scene);
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    const ImageF radiance = radiance_of(simulated, scene.prepared->frame.image, full.rect);
    ImageF picture = as_seen(radiance);
    if (effect == "hard") pictures["hard"] = picture;
    add(effect, "raster", "hard", seconds.count(), std::move(picture), {radiance, {}},
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
    const auto start = std::chrono::steady_clock::now();
    const LidarTape tape = draw_in_lidar(*scene.prepared, scene.placed, settings, simulated);
    rung.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
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

}  // namespace mirage
