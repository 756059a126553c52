#include "validation/tradeoff/tradeoff.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <set>

#include "attack/adversary.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/progress.h"
#include "frames/hosts.h"
#include "scene/data/data_rig.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "simulation/depth_score.h"
#include "simulation/quality.h"
#include "validation/blender/blender_process.h"
#include "validation/process.h"
#include "validation/tradeoff/attack_study.h"
#include "validation/tradeoff/cycles_study.h"
#include "validation/tradeoff/detector_study.h"
#include "validation/tradeoff/lidar_study.h"
#include "validation/tradeoff/points.h"
#include "validation/tradeoff/variants.h"

namespace mirage {
namespace {

using nlohmann::json;

constexpr std::array<double, 4> kRegion = {0, 70, -40, 40};  // m, of the hosts: ahead, left
constexpr double kInView = 0.7;                              // share of the object that a host leaves in view

/// Bounds the threads for as long as it lives.
class OneThread {
 public:
  OneThread() : before_(thread_count()) { set_thread_count(1); }
  ~OneThread() { set_thread_count(before_); }
  OneThread(const OneThread&) = delete;
  OneThread& operator=(const OneThread&) = delete;

 private:
  int before_;
};

void check(const TradeoffSettings& s) {
  const auto demand = [](bool good, const char* option, double value, const char* fix) {
    if (!good) throw InputError(option, fmt::format("{:g}", value), "out of range", fix);
  };
  demand(s.hosts >= 1, "--hosts", s.hosts, "use 1 or more");
  demand(s.frames >= 0, "--frames", s.frames, "use 0 (all) or more");
  demand(s.repeats >= 1, "--repeats", s.repeats, "use 1 or more");
  demand(s.reference_samples >= 2 && s.reference_samples <= 32, "--reference-samples", s.reference_samples,
         "use 2 to 32");
  demand(s.directions >= 2, "--directions", s.directions, "use 2 or more");
  demand(s.detector_hosts >= 0, "--detector-hosts", s.detector_hosts, "use 0 (none) or more");
  demand(s.cycles_samples >= 4, "--cycles-samples", s.cycles_samples, "use 4 or more");
  demand(s.cycles_hosts >= 1, "--cycles-hosts", s.cycles_hosts, "use 1 or more");
  demand(std::isfinite(s.attack_seconds) && s.attack_seconds >= 0, "--attack-seconds", s.attack_seconds,
         "use seconds, 0 for none");
}

/// `count` of the list, evenly over it.
template <class T>
std::vector<T> evenly(const std::vector<T>& list, std::size_t count) {
  if (count == 0 || count >= list.size()) return list;
  std::vector<T> spread;
  for (std::size_t i = 0; i < count; ++i)
    spread.push_back(list[count == 1 ? list.size() / 2 : i * (list.size() - 1) / (count - 1)]);
  return spread;
}

struct Subjects {
  TexturedMesh adversary;
  std::vector<HostId> hosts;  ///< by distance
};

Subjects choose(const TradeoffSettings& settings, const Run* run, FrameStore& store) {
  Subjects subjects;
  subjects.adversary = run ? run->adversary : random_adversary(settings.seed);
  std::vector<HostId> all;
  if (run) {
    all = run->test;
    all.insert(all.end(), run->train.begin(), run->train.end());
    all = evenly(all, static_cast<std::size_t>(4 * settings.hosts));
  } else {
    const auto frames = evenly(list_frames(settings.source.data), static_cast<std::size_t>(settings.frames));
    for (const Host& host : find_all_hosts(store, frames, kRegion, {}, kInView)) all.push_back(host.id);
  }
  if (all.empty())
    throw InputError(
        settings.source.data.string(), "label_2",
        fmt::format("no car with {:.0f} % of the object in view in the frames looked at", 100 * kInView),
        "give --frames 0 or another data set");
  const auto distance = [&](const HostId& id) {
    const auto held = store.get(id.frame);
    const BevBox& box = label_of(held->frame, id).box.bev;
    return std::hypot(box.x, box.y);
  };
  std::stable_sort(all.begin(), all.end(),
                   [&](const HostId& a, const HostId& b) { return distance(a) < distance(b); });
  subjects.hosts = evenly(all, static_cast<std::size_t>(settings.hosts));
  return subjects;
}

/// Means over hosts, in whatever order they come.
class Mean {
 public:
  void add(const std::map<std::string, double>& errors, double ratio, double baseline_ms) {
    for (const auto& [name, value] : errors) sums_[name] += value;
    log_ratio_ += std::log(std::max(ratio, 1e-9));
    baseline_.push_back(baseline_ms);
    ++count_;
  }
  void finish(TradeoffPoint& point) const {
    const double n = std::max(1, count_);
    for (const auto& [name, value] : sums_) point.errors[name] = value / n;
    point.ratio = std::exp(log_ratio_ / n);
    double sum = 0;
    for (double ms : baseline_) sum += ms;
    point.baseline_ms = sum / n;
    point.ms = point.ratio * point.baseline_ms;
  }

 private:
  std::map<std::string, double> sums_;
  std::vector<double> baseline_;
  double log_ratio_ = 0;
  int count_ = 0;
};

std::map<std::string, double> errors_of(const CameraFigures& f) {
  return {{"image_levels", f.image_levels},   {"image_mae", f.image_mae},
          {"image_max", f.image_max},         {"gradient_cosine", f.gradient_cosine},
          {"gradient_norm", f.gradient_norm}, {"gradient", 1 - f.gradient_cosine},
          {"double_cosine", f.double_cosine}, {"double_norm", f.double_norm},
          {"texel_cosine", f.texel_cosine},   {"texel_norm", f.texel_norm}};
}

std::map<std::string, double> errors_of(const LidarFigures& f) {
  std::map<std::string, double> errors = {
      {"range_error_m", f.range_error}, {"range_max_m", f.range_max}, {"disagreements", f.disagreements}};
  if (f.has_gradient) {
    errors["gradient_cosine"] = f.gradient_cosine;
    errors["gradient_norm"] = f.gradient_norm;
    errors["gradient"] = 1 - f.gradient_cosine;
  }
  return errors;
}

/// What the camera's and the LiDAR's points share: one entry of `means` for each of `points`.
void finish(std::vector<TradeoffPoint>& points, const std::vector<Mean>& means) {
  for (std::size_t i = 0; i < points.size(); ++i) means[i].finish(points[i]);
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

struct SensorPoints {
  std::vector<TradeoffPoint> camera, lidar;
  double self_cosine = 0, sharp_cosine = 0, sharp_norm = 0;
  std::vector<int> pixels;  ///< of the hosts' objects
};

SensorPoints sensors(const TradeoffSettings& settings, const Subjects& subjects, FrameStore& store) {
  CameraStudySettings how;
  how.seed = settings.seed;
  how.repeats = settings.repeats;
  how.reference_samples = settings.reference_samples;
  how.sharp_samples = settings.sharp_samples;
  how.directions = settings.directions;
  std::vector<CameraVariant> variants = axis_variants(how.baseline);
  if (settings.grid)
    for (CameraVariant& variant : grid_variants(how.baseline)) variants.push_back(std::move(variant));
  SensorPoints out;
  for (const CameraVariant& v : variants)
    out.camera.push_back({"camera", v.axis, v.label, settings_json(v), 0, 0, 1, {}, {}});
  std::vector<Mean> camera(variants.size()), lidar;
  Progress progress("trade-off", subjects.hosts.size() * (variants.size() + 2), settings.quiet);
  std::size_t done = 0;
  for (const HostId& id : subjects.hosts) {
    const auto held = store.get(id.frame);
    const PreparedFrame& prepared = *held;
    const TexturedMesh placed = place(subjects.adversary, store.rooftop(id));
    const Label& host = label_of(prepared.frame, id);
    const CameraStudy study(prepared, host, placed, how), plain(prepared, host, in_plain_faces(placed), how);
    const double n = static_cast<double>(subjects.hosts.size());
    out.self_cosine += study.self_cosine() / n;
    out.sharp_cosine += study.sharp_agreement().cosine / n;
    out.sharp_norm += study.sharp_agreement().norm / n;
    out.pixels.push_back(study.pixels());
    progress.update(++done, host_name(id));
    const OneThread bound;
    for (std::size_t i = 0; i < variants.size(); ++i) {
      throw_if_interrupted("a study writes nothing until it is done; run it again");
      const CameraFigures figures = study.measure(variants[i]);
      auto errors = errors_of(figures);
      if (variants[i].axis != "grid") {
        const CameraFigures in_plain = plain.measure(variants[i], false);
        errors["plain_faces_cosine"] = in_plain.gradient_cosine;
        errors["plain_faces_norm"] = in_plain.gradient_norm;
      }
      camera[i].add(errors, figures.ratio, figures.baseline_ms);
      progress.update(++done, host_name(id) + " " + variants[i].label);
    }
    const auto traced = lidar_study(prepared, placed, how.baseline, settings.repeats);
    for (std::size_t i = 0; i < traced.size(); ++i) {
      if (i == out.lidar.size()) {
        out.lidar.push_back({"lidar", traced[i].axis, traced[i].label, traced[i].settings, 0, 0, 1, {}, {}});
        lidar.emplace_back();
      }
      lidar[i].add(errors_of(traced[i]), traced[i].ratio, traced[i].baseline_ms);
    }
    progress.update(++done, host_name(id) + " LiDAR");
  }
  finish(out.camera, camera);
  finish(out.lidar, lidar);
  return out;
}

/// Depth completion, against true depth where the set has it, else on a fifth of the returns, held back.
std::vector<TradeoffPoint> depth_points(const TradeoffSettings& settings, const TexturedMesh& adversary,
                                        json& reference) {
  std::vector<TradeoffPoint> points;
  if (settings.depth_frames == 0) return points;
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
  options.frames = static_cast<std::size_t>(settings.depth_frames);
  options.seed = settings.seed;
  auto ids = list_frames(settings.source.data);
  if (ids.size() > options.frames) ids.resize(options.frames);
  const bool truth = std::all_of(ids.begin(), ids.end(), [&](const std::string& id) {
    return std::filesystem::exists(true_depth_file(settings.source.data, id));
  });
  options.hidden = truth ? 0 : 0.2;
  reference = truth ? "true depth" : "a fifth of the returns, held back";
  Progress progress("depth completion", ids.size(), settings.quiet);
  const OneThread bound;
  const auto scores = score_depth(options, backends, adversary,
                                  [&](std::size_t done, std::size_t) { progress.update(done); });
  for (const DepthScore& score : scores) {
    TradeoffPoint point{"depth", "back_end", score.name, {{"depth", score.name}}, 0, 0, 1, {}, {}};
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
    points.push_back(std::move(point));
  }
  return points;
}

std::vector<TradeoffPoint> pass_points(const TradeoffSettings& settings, const Subjects& subjects,
                                       FrameStore& store) {
  std::vector<std::shared_ptr<const PreparedFrame>> held;
  std::vector<DetectorHost> hosts;
  if (settings.detector_hosts > 0)
    for (const HostId& id : evenly(subjects.hosts, static_cast<std::size_t>(settings.detector_hosts))) {
      held.push_back(store.get(id.frame));
      hosts.push_back({held.back().get(), {id, store.rooftop(id)}});
    }
  if (hosts.empty()) return {};
  DetectorOptions options = settings.detector;
  options.rig = data_rig(settings.source.data);
  const OneThread bound;
  return detector_points(options, hosts, subjects.adversary, settings.repeats);
}

std::vector<TradeoffPoint> cycles_points(const TradeoffSettings& settings, const Subjects& subjects,
                                         FrameStore& store) {
  BlenderWorker blender(settings.out / "blender.log");
  std::vector<std::shared_ptr<const PreparedFrame>> held;
  std::vector<CyclesHost> hosts;
  for (const HostId& id : evenly(subjects.hosts, static_cast<std::size_t>(settings.cycles_hosts))) {
    held.push_back(store.get(id.frame));
    const PreparedFrame& prepared = *held.back();
    hosts.push_back(
        {&prepared, &label_of(prepared.frame, id), store.rooftop(id), subjects.adversary, host_name(id)});
  }
  const auto scratch = settings.out / "scratch";
  const auto points = cycles_study(blender, hosts, {}, settings.cycles_samples, settings.seed, scratch);
  std::error_code ignored;
  std::filesystem::remove_all(scratch, ignored);
  return points;
}

json recommended_json(const std::vector<TradeoffPoint>& points) {
  const auto find = [&](const char* axis, const std::string& label) -> const TradeoffPoint* {
    for (const TradeoffPoint& point : points)
      if (point.group == "camera" && point.axis == axis && point.label == label) return &point;
    return nullptr;
  };
  json list = json::array();
  const TradeoffPoint* standard = find("quality", "default");
  const auto figures = [](const TradeoffPoint& p) -> json {
    return {{"settings", p.settings},
            {"ratio", p.ratio},
            {"ms", p.ms},
            {"errors", p.errors},
            {"on_front", p.front}};
  };
  for (const Recommendation& advice : recommend(points, *standard)) {
    json entry = advice.point ? figures(*advice.point) : json::object();
    entry["name"] = advice.name;
    entry["rule"] = advice.rule;
    entry["shipped"] = figures(*find("quality", advice.name));
    list.push_back(std::move(entry));
  }
  return list;
}

/// Names of the files that validation/tradeoff/plot.py made.
json plot(const std::filesystem::path& out) {
  const std::string python = plotting_python().string();
  if (python.empty() ||
      run_program({python, shipped_file("validation/tradeoff/plot.py").string(), out.string()}) != 0) {
    spdlog::warn("no page: install python3-matplotlib (the points are in {})",
                 (out / "tradeoff.json").string());
    return json::array();
  }
  return {"tradeoff.png", "tradeoff.svg"};
}

}  // namespace

json tradeoff(const TradeoffSettings& given) {
  check(given);
  TradeoffSettings settings = given;
  if (settings.cycles) require_text_path(settings.out);
  std::unique_ptr<Run> run;
  if (!settings.run.empty()) {
    run = std::make_unique<Run>(read_run(settings.run, settings.trust));
    override_settings(*run, settings.asked, settings.seed);
    settings.source = run->settings;
  } else {
    AttackSettings plain;
    override_settings(plain, settings.asked, settings.seed);
    settings.source = plain;
  }
  if (settings.source.data.empty())
    throw InputError("--data", "", "no data set", "give --data, or --run of a finished mirage attack");
  make_output_folder(settings.out);
  FrameStore store(settings.source);
  const Subjects subjects = choose(settings, run.get(), store);
  SensorPoints measured = sensors(settings, subjects, store);
  std::vector<TradeoffPoint> points = std::move(measured.camera);
  const auto append = [&](std::vector<TradeoffPoint> more) {
    points.insert(points.end(), std::make_move_iterator(more.begin()), std::make_move_iterator(more.end()));
  };
  append(std::move(measured.lidar));
  json depth_reference;
  append(depth_points(settings, subjects.adversary, depth_reference));
  append(pass_points(settings, subjects, store));
  if (settings.cycles) append(cycles_points(settings, subjects, store));
  for (const auto& [group, error] :
       std::vector<std::pair<const char*, const char*>>{{"camera", "image_levels"},
                                                        {"camera", "gradient"},
                                                        {"lidar", "range_error_m"},
                                                        {"lidar", "gradient"},
                                                        {"depth", "mae_mm"},
                                                        {"detector", "gradient"},
                                                        {"cycles", "image_levels"}})
    mark_front(points, group, error);

  json names = json::array(), list = json::array();
  std::set<std::string> frames;
  for (const HostId& id : subjects.hosts) names.push_back(host_name(id)), frames.insert(id.frame);
  for (const TradeoffPoint& point : points) list.push_back(to_json(point));
  const auto baseline = [&](const char* group) {
    for (const TradeoffPoint& point : points)
      if (point.group == group) return point.baseline_ms;
    return 0.0;
  };
  json result = {{"frames", frames.size()},
                 {"vehicles", subjects.hosts.size()},
                 {"hosts", names},
                 {"pixels", measured.pixels},
                 {"seed", settings.seed},
                 {"repeats", settings.repeats},
                 {"data", settings.source.data.filename().string()},
                 {"depth", escape_name(settings.source.depth)},
                 {"rooftop", escape_name(settings.source.rooftop)},
                 {"reference",
                  {{"image", fmt::format("hard edges, plain loop in double, {0}×{0} samples a pixel",
                                         settings.reference_samples)},
                   {"gradient", fmt::format("plain loop in double, σ 1e-7, γ 1e-3, {0}×{0} samples a pixel",
                                            settings.sharp_samples)},
                   {"gradient_cosine", measured.sharp_cosine},
                   {"gradient_norm", measured.sharp_norm},
                   {"finite_differences",
                    {{"directions", settings.directions},
                     {"step_m", CameraStudySettings().step},
                     {"self_cosine", measured.self_cosine}}},
                   {"depth", depth_reference}}},
                 {"baseline", {{"camera_ms", baseline("camera")}, {"lidar_ms", baseline("lidar")}}},
                 {"points", list},
                 {"recommended", settings.grid ? recommended_json(points) : json::array()},
                 {"attack", settings.attack_seconds > 0 ? attack_study(settings) : json::array()}};
  write_json(settings.out / "tradeoff.json", result);
  result["plots"] = plot(settings.out);
  if (!result["plots"].empty()) result["page"] = (settings.out / "tradeoff.html").string();
  return result;
}

}  // namespace mirage
