#include "validation/tradeoff/studies.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <memory>

#include "attack/attack.h"
#include "attack/attack_step.h"
#include "attack/evaluation.h"
#include "attack/run.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "base/schedule.h"
#include "detection/detector_settings.h"
#include "exchange/gltf.h"
#include "exchange/host_proxy.h"
#include "simulation/quality.h"
#include "validation/fidelity/picture_errors.h"
#include "validation/reference/host_scene.h"
#include "validation/reference/reference_renderer.h"
#include "validation/tradeoff/sensor_studies.h"

namespace mirage {
namespace {

constexpr double kLocality = 4;  // m

/// The ways of spending the seconds.
std::vector<TimedAttack> ways_to_attack(const DetectorOptions& options) {
  std::vector<TimedAttack> attacks;
  for (const Quality& quality : qualities())
    attacks.push_back({std::string("quality ") + quality.name, quality.name, options});
  const auto add = [&](const char* name, const auto& change) {
    attacks.push_back({name, "default", options});
    change(attacks.back().detector);
  };
  add("whole passes", [](DetectorOptions& o) { o.clean_memory_mb = 0; });
  if (multiplies_bfloat16()) add("bfloat16", [](DetectorOptions& o) { o.precision = kBfloat16; });
  add("locality 4 m", [](DetectorOptions& o) { o.locality = kLocality; });
  return attacks;
}

}  // namespace

nlohmann::json to_json(const TimedAttack& attack) {
  return {{"name", attack.name},
          {"quality", attack.quality},
          {"precision", attack.detector.precision},
          {"locality", attack.detector.locality},
          {"clean_memory_mb", attack.detector.clean_memory_mb},
          {"seconds", attack.seconds},
          {"iterations", attack.iterations},
          {"loss", attack.loss},
          {"vehicles", attack.vehicles},
          {"asr", attack.asr.value},
          {"fn_asr", attack.fn_asr.value},
          {"fp_asr", attack.fp_asr.value},
          {"asr_interval", {attack.asr.low, attack.asr.high}}};
}

std::vector<TimedAttack> attack_study(const TradeoffSettings& settings) {
  if (settings.attack_seconds <= 0) return {};
  AttackSettings attack;
  static_cast<FrameSource&>(attack) = settings.source;
  attack.seed = settings.seed;
  attack.quiet = settings.quiet;
  attack.iterations = kMostIterations;
  attack.seconds = settings.attack_seconds;
  const DetectorOptions options = for_data(settings.detector, settings.source);
  const DetectorPool judges = load_detector_pool(options, attack.batch);
  SimulationSettings exact;
  apply_quality("exact", exact);
  const std::filesystem::path scratch = settings.out / kScratchFolder;
  std::vector<TimedAttack> list = ways_to_attack(options);
  for (TimedAttack& timed : list) {
    throw_if_interrupted("the study goes on from its beginning");
    attack.detector = timed.detector;
    attack.simulation = {};
    apply_quality(timed.quality, attack.simulation);
    std::string folder = "attack " + timed.name;
    std::replace(folder.begin(), folder.end(), ' ', '_');
    // An earlier study's attack stays until this one is finished, whatever ends it before.
    const std::filesystem::path place = settings.out / folder;
    attack.out = scratch / folder;
    std::filesystem::remove_all(attack.out);
    const AttackResult result = run_attack(attack, load_detector_pool(timed.detector, attack.batch));
    std::filesystem::remove_all(place);
    std::filesystem::rename(attack.out, place);
    const Run run = read_run(place);
    FrameStore store(attack);
    EvaluationSettings by;
    by.quiet = settings.quiet;
    const Evaluation judged = evaluate(judges, store, run.test, run.adversary, exact, by);
    timed.seconds = settings.attack_seconds;
    timed.iterations = result.iterations, timed.loss = result.loss;
    timed.vehicles = judged.vehicles;
    timed.fn_asr = judged.fn_interval, timed.fp_asr = judged.fp_interval, timed.asr = judged.asr_interval;
  }
  std::error_code ignored;
  std::filesystem::remove_all(scratch, ignored);
  return list;
}

namespace {

constexpr std::array<double, 4> kLocalities = {1, 2, 4, 8};  // m

struct PassVariant {
  std::string axis, label;
  DetectorOptions options;
};

std::vector<PassVariant> pass_variants(DetectorOptions options) {
  options.threads = 1;
  options.precision = kFloat;
  options.locality = 0;
  std::vector<PassVariant> list = {{"passes", "what the object changes", options}};
  const auto add = [&](const char* axis, std::string label, const auto& change) {
    list.push_back({axis, std::move(label), options});
    change(list.back().options);
  };
  add("passes", "the whole frame", [](DetectorOptions& o) { o.clean_memory_mb = 0; });
  if (multiplies_bfloat16()) add("precision", kBfloat16, [](DetectorOptions& o) { o.precision = kBfloat16; });
  for (const double metres : kLocalities)
    add("locality", fmt::format("{:g} m", metres), [&](DetectorOptions& o) { o.locality = metres; });
  return list;
}

std::vector<double> flat(const AdversaryGradient& gradient) {
  std::vector<double> values;
  for (const auto* list : {&gradient.vertices, &gradient.texels})
    for (const Vec3d& v : *list) values.insert(values.end(), {v.x(), v.y(), v.z()});
  return values;
}

}  // namespace

std::vector<TradeoffPoint> detector_points(const DetectorOptions& options, const std::vector<StepHost>& hosts,
                                           const TexturedMesh& adversary, int repeats) {
  const AttackSettings settings;
  const auto step = [&](Detector& detector, const StepHost& at) {
    return attack_host(detector, at, adversary, settings);
  };
  const auto variants = pass_variants(options);
  std::vector<std::vector<double>> references;
  {
    DetectorOptions slow = variants.front().options;
    slow.precision = kDouble;
    slow.clean_memory_mb = 0;
    const auto detector = load_detector(slow);
    for (const StepHost& at : hosts) references.push_back(flat(step(*detector, at).gradient));
  }
  const auto baseline = load_detector(variants.front().options);
  std::vector<TradeoffPoint> points;
  for (const PassVariant& variant : variants) {
    throw_if_interrupted("a study writes nothing until it is done; run it again");
    const auto detector = load_detector(variant.options);
    TradeoffPoint point{"detector",
                        variant.axis,
                        variant.label,
                        {{"detector", options.detector},
                         {"precision", variant.options.precision},
                         {"locality", variant.options.locality},
                         {"clean_memory_mb", variant.options.clean_memory_mb}}};
    std::vector<TradeoffPoint> of_hosts;
    double least = 1;
    for (std::size_t h = 0; h < hosts.size(); ++h) {
      HostStep taken = step(*detector, hosts[h]);  // and keeps the clean frame
      step(*baseline, hosts[h]);
      time_beside(
          point, repeats, [&] { step(*baseline, hosts[h]); }, [&] { taken = step(*detector, hosts[h]); });
      const Agreement with = agreement(flat(taken.gradient), references[h]);
      if (std::all_of(references[h].begin(), references[h].end(), [](double d) { return d == 0; })) continue;
      point.errors = {{"gradient_cosine", with.cosine}, {"gradient_norm", with.norm}};
      least = std::min(least, with.cosine);
      of_hosts.push_back(point);
    }
    if (of_hosts.empty()) {
      spdlog::warn("the detector's passes are left out: no host has a gradient");
      return {};
    }
    point = mean_over(of_hosts);
    point.errors["gradient"] = 1 - point.errors["gradient_cosine"];
    point.errors["gradient_cosine_least"] = least;
    points.push_back(std::move(point));
  }
  return points;
}

namespace {

struct Way {
  std::string axis, label;
  RenderEffects effects;
  int samples = 0;
  bool raster = false;
};

RenderEffects all_effects() {
  RenderEffects effects = full_effects();
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

/// As a camera sees it.
ImageF over(const Rendered& rendered, ImageF picture) {
  composite({rendered.rgba, {}, 0}, {}, picture);
  saturate(picture);
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
    const ImageF background = crop(photograph, job.rect), right = over(reference, background);
    const ImageF mask = alpha_mask(reference.rgba);
    const double mean = mean_absolute_error(right, ImageF(right.width, right.height, 3), mask);
    const double share = 1.0 / static_cast<double>(hosts.size());
    for (std::size_t i = 0; i < list.size(); ++i) {
      ImageF picture;
      double ms = 0;
      if (list[i].raster) {
        const auto start = Clock::now();
        picture = crop(draw().image, job.rect);
        ms = 1e3 * seconds_since(start);
      } else {
        job.samples = list[i].samples;
        job.effects = list[i].effects;
        const Rendered rendered = renderer.render(job);
        picture = over(rendered, background);
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
