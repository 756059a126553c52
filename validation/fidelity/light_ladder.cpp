#include "validation/fidelity/light_ladder.h"

#include <chrono>
#include <cmath>
#include <map>

#include "base/color.h"
#include "validation/fidelity/picture_errors.h"

namespace mirage {
namespace {

constexpr double kFilterWidth = 1.5;  // px, Blender's default
constexpr int kReferenceFactor = 4;   // samples of the reference over the rungs'

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
  const double mean = mean_absolute_error(from, ImageF(from.width, from.height, from.channels), mask);
  Change result;
  result.mae = mean_absolute_error(from, to, mask);
  result.relative = mean > 0 ? result.mae / mean : 0;
  result.psnr = psnr(from, to, mask);
  result.ssim = ssim(grey(seen_from), grey(seen), mask);
  result.flip = flip(seen_from, seen, mask);
  return result;
}

LightLadder light_ladder(BlenderWorker& blender, const HostScene& scene, const FullLight& full) {
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
    const RenderedHalves rendered = render_halves(blender, job, scene.seed, RenderStream::reference);
    result.reference_seconds = rendered.seconds;
    reference = over(rendered, full.visible, photograph);
    pictures["reference"] = picture_of(rendered);
    // Without noise of its own and with no error, what is left is the reference's.
    const Halves itself{reference.mean(), {}};
    result.reference_noise = std::sqrt(error_to(reference, itself, full.coverage, full, scene.seed).floor);
  }
  const auto add = [&](const std::string& effect, const std::string& group, const std::string& base,
                       double seconds, ImageF picture, const Halves& object, const ImageF& coverage) {
    pictures[effect] = picture;
    const ImageF& from = pictures.at(base);
    ladder.push_back({effect, group, base, change(from, picture, full.mask), change(from, picture, {}),
                      change(pictures.at("reference"), picture, full.mask),
                      error_to(reference, object, coverage, full, scene.seed), seconds, std::move(picture)});
  };

  const auto timed = [&](const auto& simulate) {
    const auto start = std::chrono::steady_clock::now();
    const Simulated simulated = simulate();
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    return std::pair(simulated, seconds.count());
  };
  SimulationSettings hard = hard_limit(scene.simulation, true), visible = hard;
  hard.supersampling = visible.supersampling = scene.simulation.supersampling;
  visible.light = LightModel::visible;
  const auto drawn = [&](const std::string& effect, const auto& simulate) {
    const auto [simulated, seconds] = timed(simulate);
    const ImageF radiance = radiance_of(simulated, scene.prepared->frame.image, full.rect);
    ImageF picture = as_seen(radiance);
    if (effect == "hard") pictures["hard"] = picture;
    add(effect, "raster", "hard", seconds, std::move(picture), {radiance, {}},
        coverage_of(simulated, full.rect));
  };
  drawn("hard", [&] { return simulate_host(scene, hard); });
  drawn("soft", [&] { return simulate_host(scene, scene.simulation); });
  drawn("sRGB shading", [&] { return simulate_in_srgb(scene, hard); });
  drawn("uniform ambient", [&] { return simulate_uniform(scene, hard); });
  drawn("visible light", [&] { return simulate_host(scene, visible); });
  for (const auto& [effect, words] : {std::pair("lens", "blur"), std::pair("sensor", "noise")}) {
    SimulationSettings seen = hard;
    seen.camera_effects = parse_camera_effects(words);
    drawn(effect, [&] { return simulate_host(scene, seen); });
  }

  RenderJob centres = job;
  centres.effects = {};
  centres.samples = 1;
  centres.pixel_centre = true;
  centres.seed = scene.seed + static_cast<std::uint64_t>(RenderStream::rungs);
  ImageF matched = photograph;
  composite(render(blender, centres), full.visible, matched);
  pictures["centres"] = as_seen(std::move(matched));
  for (const Recipe& recipe : recipes(scene.samples)) {
    job.effects = recipe.effects;
    job.samples = recipe.samples > 0 ? recipe.samples : scene.samples;
    job.filter_width = recipe.filter_width;
    RenderedHalves rendered = render_halves(blender, job, scene.seed, RenderStream::rungs);
    if (recipe.blurred)
      for (Rendered* half : {&rendered.first, &rendered.second})  // its shadow is smooth already
        soften(half->rgba, kLensBlur);
    add(recipe.effect, recipe.group, recipe.base, rendered.seconds, picture_of(rendered),
        over(rendered, full.visible, photograph), coverage_of(rendered, full.visible));
  }
  add("full", "samples", "reference", full.seconds, full.cycles, full.radiance, full.coverage);
  return result;
}

}  // namespace mirage
