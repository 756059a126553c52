#include "validation/tradeoff/tradeoff.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <iterator>
#include <memory>
#include <set>

#include "attack/attack.h"
#include "attack/attack_step.h"
#include "attack/evaluation.h"
#include "attack/run.h"
#include "base/child_process.h"
#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/schedule.h"
#include "base/sizes.h"
#include "detection/detector_settings.h"
#include "exchange/gltf.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "simulation/depth_score.h"
#include "simulation/insertion.h"
#include "validation/fidelity/picture_errors.h"
#include "validation/reference/host_scene.h"

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

struct Way {
  std::string axis, label;
  RenderEffects effects;
  int samples = 0;
  bool raster = false;
};

constexpr auto kUnseen = RenderEffects::Surroundings::unseen;

std::vector<Way> ways(int reference_samples) {
  constexpr int kRungSamples = 64;
  std::vector<Way> list = {{"rung", "rasteriser", {}, 0, true}, {"rung", "matched light", {}, kRungSamples}};
  RenderEffects effects{.shadows = true, .surroundings = kUnseen};
  list.push_back({"rung", "+ shadows", effects, kRungSamples});
  effects.sky = true;
  list.push_back({"rung", "+ occluded sky", effects, kRungSamples});
  effects.bounces = 1;
  list.push_back({"rung", "+ 1 bounce", effects, kRungSamples});
  effects.bounces = 4;
  list.push_back({"rung", "+ 4 bounces", effects, kRungSamples});
  list.push_back({"rung", "+ specular (all)", full_effects(kUnseen), kRungSamples});
  for (int samples = 1; samples < reference_samples; samples *= 4)
    list.push_back({"samples", fmt::format("{} samples", samples), full_effects(kUnseen), samples});
  return list;
}

/// As a camera sees it.
ImageF over(const Rendered& rendered, ImageF picture) {
  composite({rendered.rgba, {}, 0}, {}, picture);
  saturate(picture);
  return picture;
}

/// Null if there is none.
const TradeoffPoint* quality_point(const std::vector<TradeoffPoint>& points, const std::string& name) {
  for (const TradeoffPoint& point : points)
    if (point.group == "camera" && point.axis == "quality" && point.label == name) return &point;
  return nullptr;
}

/// Of the group's first point; 0 if it has none.
double measured_baseline_ms(const std::vector<TradeoffPoint>& points, const char* group) {
  for (const TradeoffPoint& point : points)
    if (point.group == group) return point.baseline_ms;
  return 0;
}

nlohmann::json figures_json(const TradeoffPoint& point) {
  return {{"settings", point.settings},
          {"ratio", point.ratio},
          {"ms", point.ms},
          {"errors", point.errors},
          {"on_front", point.front}};
}

nlohmann::json reference_json(const TradeoffResult& result) {
  const TradeoffSettings& asked = result.settings;
  nlohmann::json json = {
      {"image",
       fmt::format("hard edges, plain loop in double, {0}×{0} samples a pixel", asked.reference_samples)},
      {"gradient",
       fmt::format("plain loop in double, σ 1e-7, γ 1e-3, {0}×{0} samples a pixel", asked.sharp_samples)},
      {"gradient_cosine", result.reference.sharp.cosine},
      {"gradient_norm", result.reference.sharp.norm},
      {"finite_differences",
       {{"directions", asked.directions},
        {"step_m", CameraStudy::kStep},
        {"self_cosine", result.reference.self_cosine}}},
      {"depth", nullptr}};
  if (!result.depth_reference.empty()) json["depth"] = result.depth_reference;
  return json;
}

/// Adds points of group "depth", axis "back_end": every back-end that can be loaded on the data set's first
/// settings.depth_frames frames (0: none), against true depth where all of them have it, else on a fifth of
/// the returns, held back. Times are wall-clock, of one thread. Errors of score_depth.
void add_depth_points(TradeoffResult& result, const TexturedMesh& adversary) {
  const TradeoffSettings& settings = result.settings;
  if (settings.depth_frames == 0) return;
  std::vector<std::unique_ptr<DepthCompletion>> backends;
  for (const char* name : {"ip-basic", "ip-basic-bilateral", "ip-basic-multiscale",
                           "ip-basic-multiscale-bilateral", "ip-basic-extrapolated", "guided"}) {
    try {
      DepthOptions options;
      options.backend = name;
      backends.push_back(load_depth_completion(options));
    } catch (const InputError& error) {
      spdlog::warn("depth completion {} is left out: {}", name, error.what());
    }
  }
  DepthScoreOptions options;
  options.data = settings.source.data;
  options.frames = as_size(settings.depth_frames);
  options.seed = settings.seed;
  const auto ids = list_frames(settings.source.data, options.frames);
  const bool truth = std::all_of(ids.begin(), ids.end(), [&](const std::string& id) {
    return std::filesystem::exists(true_depth_file(settings.source.data, id));
  });
  options.hidden = truth ? 0 : 0.2;
  result.depth_reference = truth ? "true depth" : "a fifth of the returns, held back";
  Progress progress("depth completion", ids.size(), settings.quiet);
  const OneThread bound;
  const auto scores = score_depth(options, backends, adversary,
                                  [&](std::size_t done, std::size_t) { progress.update(done); });
  for (const DepthScore& score : scores) {
    TradeoffPoint point{"depth", "back_end", score.name, {{"depth", score.name}}};
    point.ms = 1e3 * score.seconds;
    point.baseline_ms = 1e3 * scores.front().seconds;
    point.ratio = point.ms / point.baseline_ms;
    const DepthErrors& e = truth ? score.common : score.consistent;
    point.errors = {{"rmse_mm", e.rmse}, {"mae_mm", e.mae}, {"coverage", score.coverage}};
    if (truth && score.roof.pixels > 0) {
      const double pixels = static_cast<double>(score.roof.pixels);
      point.errors["wrongly_kept"] = static_cast<double>(score.roof.wrongly_kept) / pixels;
      point.errors["wrongly_dropped"] = static_cast<double>(score.roof.wrongly_dropped) / pixels;
    }
    result.points.push_back(std::move(point));
  }
}

/// Every face in the mean of its colours: what the gradient would be without a texture that moves.
TexturedMesh in_plain_faces(TexturedMesh textured) {
  const std::size_t texels = textured.atlas.per_face();
  for (auto first = textured.atlas.texels.begin(); first != textured.atlas.texels.end();) {
    const auto end = first + static_cast<std::ptrdiff_t>(texels);
    Vec3d sum = Vec3d::Zero();
    for (auto t = first; t != end; ++t) sum += *t;
    std::fill(first, end, Vec3d(sum / static_cast<double>(texels)));
    first = end;
  }
  return textured;
}

/// Adds the reference and the points of groups "camera" and "lidar": draws and traces every host in every way
/// (subjects.h, sensor_studies.h), one thread at a time. Off the grid the camera's points also have the
/// gradient of the adversary with each face in the mean of its colours, "plain_faces_cosine" and
/// "plain_faces_norm". Interrupted between drawings.
void add_sensor_points(TradeoffResult& result, const Subjects& subjects, FrameStore& store) {
  const TradeoffSettings& settings = result.settings;
  const SimulationSettings baseline;
  std::vector<CameraVariant> variants = axis_variants(baseline);
  if (settings.grid)
    for (CameraVariant& variant : grid_variants(baseline)) variants.push_back(std::move(variant));
  std::vector<std::vector<TradeoffPoint>> camera(variants.size()), lidar;  // by setting and host
  Progress progress("trade-off", subjects.hosts.size() * (variants.size() + 2), settings.quiet);
  std::size_t done = 0;
  for (const HostId& id : subjects.hosts) {
    const auto frame_handle = store.get(id.frame);
    const PreparedFrame& prepared = *frame_handle;
    const Placement placement = store.placement(id);
    const TexturedMesh placed = place(subjects.adversary, placement);
    const CameraStudy study(prepared, placement, placed, settings),
        plain(prepared, placement, in_plain_faces(placed), settings);
    const double n = static_cast<double>(subjects.hosts.size());
    result.reference.self_cosine += study.self_cosine() / n;
    result.reference.sharp.cosine += study.sharp_agreement().cosine / n;
    result.reference.sharp.norm += study.sharp_agreement().norm / n;
    result.reference.pixels.push_back(study.pixels());
    progress.update(++done, host_name(id));
    const OneThread bound;
    for (std::size_t i = 0; i < variants.size(); ++i) {
      throw_if_interrupted("a study writes nothing until it is done; run it again");
      const CameraVariant& v = variants[i];
      TradeoffPoint point{"camera", v.axis, v.label, settings_json(v), v.simulation};
      point.errors = study.errors(v);
      if (v.axis != "grid") {
        const auto in_plain = plain.errors(v);
        point.errors["plain_faces_cosine"] = in_plain.at("gradient_cosine");
        point.errors["plain_faces_norm"] = in_plain.at("gradient_norm");
      }
      study.time(v, point);
      camera[i].push_back(std::move(point));
      progress.update(++done, host_name(id) + " " + v.label);
    }
    std::vector<TradeoffPoint> traced = lidar_study(prepared, placed, baseline, settings.repeats);
    lidar.resize(std::max(lidar.size(), traced.size()));
    for (std::size_t i = 0; i < traced.size(); ++i) lidar[i].push_back(std::move(traced[i]));
    progress.update(++done, host_name(id) + " LiDAR");
  }
  for (const auto* settings_of : {&camera, &lidar})
    for (const std::vector<TradeoffPoint>& hosts : *settings_of) result.points.push_back(mean_over(hosts));
}

std::vector<TradeoffPoint> pass_points(const TradeoffSettings& settings, const Subjects& subjects,
                                       FrameStore& store) {
  std::vector<std::shared_ptr<const PreparedFrame>> frame_handles;
  std::vector<StepHost> hosts;
  if (settings.detector_hosts > 0)
    for (const HostId& id : evenly(subjects.hosts, as_size(settings.detector_hosts))) {
      frame_handles.push_back(store.get(id.frame));
      hosts.push_back({*frame_handles.back(), id, store.placement(id)});
    }
  if (hosts.empty()) return {};
  const DetectorOptions options = for_data(settings.detector, settings.source);
  const OneThread bound;
  return detector_points(options, hosts, subjects.adversary, settings.repeats);
}

/// Blender Cycles: samples a pixel and light effects, against all effects at many samples; and where the
/// rasteriser's own picture lies on that scale. Group "cycles", axes "rung" and "samples". Times are
/// wall-clock: Cycles uses all cores. Errors over the object's pixels, nothing in front of it: image_levels,
/// image_mae, image_relative (image_mae over the mean radiance).
std::vector<TradeoffPoint> cycles_points(const TradeoffSettings& settings, const Subjects& subjects,
                                         FrameStore& store, const StartReference& start) {
  const std::unique_ptr<ReferenceRenderer> renderer = start(settings.out);
  const std::vector<HostId> hosts = evenly(subjects.hosts, as_size(settings.cycles_hosts));
  const std::vector<Way> list = ways(settings.cycles_samples);
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
  const auto scratch = settings.out / kScratchFolder;
  std::filesystem::create_directories(scratch);
  SimulationSettings unoccluded;
  unoccluded.occlusion_margin = 1e9;  // the scene file holds nothing that could be in front
  for (const HostId& id : hosts) {
    throw_if_interrupted("a study writes nothing until it is done; run it again");
    const auto frame_handle = store.get(id.frame);
    const PreparedFrame& prepared = *frame_handle;
    const Placement placement = store.placement(id);
    const ImageF& photograph = prepared.frame.image;
    RenderJob job;
    job.scene = scratch / (host_name(id) + ".glb");
    job.output = scratch / "render.exr";
    job.seed = settings.seed;
    write_scene(job.scene, host_scene(prepared.frame, placement, subjects.adversary, host_name(id)));
    const auto draw = [&] {
      Simulated drawn;
      draw_in_camera(prepared, placement, place(subjects.adversary, placement), unoccluded, drawn);
      return drawn;
    };
    const Simulated drawn = draw();
    job.rect = grown(drawn.rect, 4, photograph);
    job.samples = settings.cycles_samples;
    job.effects = full_effects(kUnseen);
    const Rendered reference = renderer->render(job);
    ++job.seed;  // another seed than the compared render's, so that noise does not cancel
    const ImageF background = crop(photograph, job.rect), right = over(reference, background);
    const ImageF mask = alpha_mask(reference.rgba);
    const double mean = mean_of(right, mask), share = 1.0 / static_cast<double>(hosts.size());
    for (std::size_t i = 0; i < list.size(); ++i) {
      ImageF picture;
      double ms = 0;
      if (list[i].raster) {
        const auto began = Clock::now();
        picture = crop(draw().image, job.rect);
        ms = 1e3 * seconds_since(began);
      } else {
        job.samples = list[i].samples;
        job.effects = list[i].effects;
        const Rendered rendered = renderer->render(job);
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
  std::error_code ignored;
  std::filesystem::remove_all(scratch, ignored);
  return points;
}

/// Names of the plots that validation/tradeoff/plot.py made beside its page.
std::vector<std::string> plot(const std::filesystem::path& out) {
  const std::vector<std::string> plots = {"tradeoff.png", "tradeoff.svg"};
  // If Python fails, no plot of an earlier study stays.
  std::filesystem::remove(out / "tradeoff.html");
  for (const std::string& name : plots) std::filesystem::remove(out / name);
  std::string output;
  if (run_script("validation/tradeoff/plot.py", out, &output) == 0) return plots;
  spdlog::warn("no page: {} (the points are in {})", output.empty() ? "install python3-matplotlib" : output,
               (out / "tradeoff.json").string());
  return {};
}

void mark_fronts(std::vector<TradeoffPoint>& points) {
  for (const auto& [group, error] :
       std::vector<std::pair<const char*, const char*>>{{"camera", "image_levels"},
                                                        {"camera", "gradient"},
                                                        {"lidar", "range_error_m"},
                                                        {"lidar", "gradient"},
                                                        {"depth", "mae_mm"},
                                                        {"detector", "gradient"},
                                                        {"cycles", "image_levels"}})
    mark_front(points, group, error);
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
  attack.iterations = kMaxIterations;
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
    timed.vehicles = judged.rates.vehicles;
    timed.fn_asr = judged.rates.fn_asr, timed.fp_asr = judged.rates.fp_asr, timed.asr = judged.rates.asr;
  }
  std::error_code ignored;
  std::filesystem::remove_all(scratch, ignored);
  return list;
}

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

std::vector<Recommendation> TradeoffResult::recommended() const {
  if (!settings.grid) return {};
  std::vector<Recommendation> list = recommend(points, *quality_point(points, "default"));
  for (Recommendation& advice : list) advice.shipped = quality_point(points, advice.name);
  return list;
}

nlohmann::json to_json(const Recommendation& advice) {
  nlohmann::json json = advice.point ? figures_json(*advice.point) : nlohmann::json::object();
  json["name"] = advice.name;
  json["rule"] = advice.rule;
  json["shipped"] = figures_json(*advice.shipped);
  return json;
}

nlohmann::json to_json(const TradeoffResult& result) {
  const TradeoffSettings& asked = result.settings;
  nlohmann::json json = {{"frames", result.frames},
                         {"vehicles", result.hosts.size()},
                         {"hosts", list_json(result.hosts, host_name)},
                         {"pixels", result.reference.pixels},
                         {"seed", asked.seed},
                         {"repeats", asked.repeats},
                         {"data", asked.source.data.filename().string()},
                         {"depth", escape_name(asked.source.depth)},
                         {"rooftop", escape_name(asked.source.rooftop)},
                         {"placement", text_of(asked.source.placement)},
                         {"reference", reference_json(result)},
                         {"baseline",
                          {{"camera_ms", measured_baseline_ms(result.points, "camera")},
                           {"lidar_ms", measured_baseline_ms(result.points, "lidar")}}},
                         {"points", list_json(result.points)},
                         {"recommended", list_json(result.recommended())},
                         {"attack", list_json(result.attacks)}};
  if (result.plots) json["plots"] = *result.plots;
  if (!result.page.empty()) json["page"] = result.page.string();
  return json;
}

TradeoffResult tradeoff(const TradeoffSettings& requested, const StartReference& start) {
  check_fields(requested);
  TradeoffResult result;
  TradeoffSettings& settings = result.settings = requested;
  std::unique_ptr<Run> run;
  if (!settings.run.empty()) {
    run = std::make_unique<Run>(read_run(settings.run, settings.trust));
    override_settings(*run, settings.overrides, settings.seed);
    settings.source = run->settings;
  } else {
    AttackSettings plain;
    override_settings(plain, settings.overrides, settings.seed);
    settings.source = plain;
  }
  if (settings.source.data.empty())
    throw FieldError("data", "", "no data set", "give --data, or --run of a finished mirage attack");
  make_output_folder(settings.out);
  FrameStore store(settings.source);
  const Subjects subjects = choose_subjects(settings, run.get(), store);
  result.hosts = subjects.hosts;
  std::set<std::string> frames;
  for (const HostId& id : subjects.hosts) frames.insert(id.frame);
  result.frames = frames.size();

  add_sensor_points(result, subjects, store);
  add_depth_points(result, subjects.adversary);
  const auto append = [&](std::vector<TradeoffPoint> more) {
    std::move(more.begin(), more.end(), std::back_inserter(result.points));
  };
  append(pass_points(settings, subjects, store));
  if (settings.cycles) append(cycles_points(settings, subjects, store, start));
  mark_fronts(result.points);
  result.attacks = attack_study(settings);

  write_json(settings.out / "tradeoff.json", to_json(result));
  result.plots = plot(settings.out);
  if (!result.plots->empty()) result.page = settings.out / "tradeoff.html";
  return result;
}

}  // namespace mirage
