#include "validation/tradeoff/cycles_study.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>

#include "base/interrupt.h"
#include "exchange/gltf.h"
#include "exchange/host_proxy.h"
#include "validation/fidelity/picture_errors.h"
#include "validation/reference/host_scene.h"

namespace mirage {
namespace {

struct Way {
  std::string axis, label;
  RenderEffects effects;
  int samples = 0;
  bool raster = false;
};

RenderEffects all_effects() {
  RenderEffects effects;
  effects.shadows = effects.sky = effects.specular = true;
  effects.bounces = 4;
  effects.surroundings = RenderEffects::Surroundings::unseen;
  return effects;
}

std::vector<Way> ways(int reference_samples) {
  constexpr int kRungSamples = 64;
  std::vector<Way> list = {{"rung", "rasteriser", {}, 0, true}, {"rung", "matched light", {}, kRungSamples}};
  RenderEffects effects;
  effects.surroundings = RenderEffects::Surroundings::unseen;
  effects.shadows = true;
  list.push_back({"rung", "+ shadows", effects, kRungSamples});
  effects.sky = true;
  list.push_back({"rung", "+ occluded sky", effects, kRungSamples});
  effects.bounces = 1;
  list.push_back({"rung", "+ 1 bounce", effects, kRungSamples});
  effects.bounces = 4;
  list.push_back({"rung", "+ 4 bounces", effects, kRungSamples});
  list.push_back({"rung", "+ specular (all)", all_effects(), kRungSamples});
  for (int samples = 1; samples < reference_samples; samples *= 4)
    list.push_back({"samples", fmt::format("{} samples", samples), all_effects(), samples});
  return list;
}

/// rgba over the photograph.
ImageF over(const ImageF& rgba, ImageF picture) {
  for (int v = 0; v < picture.height; ++v)
    for (int u = 0; u < picture.width; ++u) {
      const float alpha = std::clamp(rgba.at(u, v, 3), 0.0f, 1.0f);
      for (int c = 0; c < 3; ++c)
        picture.at(u, v, c) = std::clamp(rgba.at(u, v, c) + (1 - alpha) * picture.at(u, v, c), 0.0f, 1.0f);
    }
  return picture;
}

}  // namespace

std::vector<TradeoffPoint> cycles_study(ReferenceRenderer& renderer, const std::vector<CyclesHost>& hosts,
                                        const SimulationSettings& baseline, int reference_samples,
                                        std::uint64_t seed, const std::filesystem::path& scratch) {
  const std::vector<Way> list = ways(reference_samples);
  std::vector<TradeoffPoint> points;
  for (const Way& way : list) {
    TradeoffPoint point{"cycles",
                        way.axis,
                        way.label,
                        {{"samples", way.samples},
                         {"renderer", way.raster ? "rasteriser" : "cycles"},
                         {"shadows", way.effects.shadows},
                         {"sky", way.effects.sky},
                         {"bounces", way.effects.bounces},
                         {"specular", way.effects.specular}}};
    point.errors = {{"image_levels", 0}, {"image_mae", 0}, {"image_relative", 0}};
    points.push_back(std::move(point));
  }
  std::filesystem::create_directories(scratch);
  SimulationSettings unoccluded = baseline;
  unoccluded.occlusion_margin = 1e9;  // the scene file holds nothing that could be in front
  for (const CyclesHost& host : hosts) {
    throw_if_interrupted("a study writes nothing until it is done; run it again");
    const PreparedFrame& prepared = *host.prepared;
    const ImageF& photograph = prepared.frame.image;
    RenderJob job;
    job.scene = scratch / (host.name + ".glb");
    job.output = scratch / "render.exr";
    job.seed = seed;
    write_scene(job.scene, host_scene(prepared.frame, host.placement, host.adversary, host.name));
    const auto draw = [&] {
      Simulated drawn;
      draw_in_camera(prepared, host.placement, place(host.adversary, host.placement), unoccluded, drawn);
      return drawn;
    };
    const Simulated drawn = draw();
    job.rect = grown(drawn.rect, 4, photograph);
    job.samples = reference_samples;
    job.effects = all_effects();
    const Rendered reference = renderer.render(job);
    const ImageF background = crop(photograph, job.rect), right = over(reference.rgba, background);
    ImageF mask(job.rect.width(), job.rect.height(), 1);
    for (int v = 0; v < mask.height; ++v)
      for (int u = 0; u < mask.width; ++u) mask.at(u, v) = reference.rgba.at(u, v, 3) > 0.5f ? 1.0f : 0.0f;
    const double mean = mean_absolute_error(right, ImageF(right.width, right.height, 3), mask);
    const double share = 1.0 / static_cast<double>(hosts.size());
    for (std::size_t i = 0; i < list.size(); ++i) {
      ImageF picture;
      double ms = 0;
      if (list[i].raster) {
        const auto start = std::chrono::steady_clock::now();
        picture = crop(draw().image, job.rect);
        ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
      } else {
        job.samples = list[i].samples;
        job.effects = list[i].effects;
        const Rendered rendered = renderer.render(job);
        picture = over(rendered.rgba, background);
        ms = 1e3 * rendered.seconds;
      }
      const double mae = mean_absolute_error(picture, right, mask);
      points[i].ms += share * ms;
      points[i].errors["image_mae"] += share * mae;
      points[i].errors["image_relative"] += mean > 0 ? share * mae / mean : 0;
      points[i].errors["image_levels"] +=
          share * 255 * mean_absolute_error(encoded(picture), encoded(right), mask);
    }
  }
  for (TradeoffPoint& point : points) {
    point.baseline_ms = points.front().ms;
    point.ratio = point.ms / point.baseline_ms;
  }
  return points;
}

}  // namespace mirage
