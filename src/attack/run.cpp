#include "attack/run.h"

#include <fmt/format.h>

#include <climits>
#include <set>

#include "attack/attack.h"
#include "base/disk_cache.h"
#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/names.h"
#include "detection/detector_words.h"
#include "detection/given_detector.h"
#include "exchange/gltf.h"
#include "scene/depth/learned_depth.h"
#include "sensors/raster/limits.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMostHosts = 1'000'000;
constexpr double kLargestEffect = 1e3;  // of any number of LidarEffects; check_effects() has their own bounds
constexpr const char* kMadeHere = "made-here";  // the cache's name for code that this user's runs wrote
constexpr const char* kAgain = "restore the file, or run mirage attack again into an empty folder";

bool is_plugin(const std::string& name) {
  return fs::path(name).extension() == ".so";
}

[[noreturn]] void refuse(const Run& run, const char* field, const char* what, const fs::path& file,
                         const char* option) {
  const std::string path = fs::absolute(file).lexically_normal().string();
  throw InputError((run.folder / "run.json").string(), field,
                   fmt::format("{} would be loaded, which is code: {}", what, path),
                   fmt::format("if you trust it, name it yourself ({} {}) or add --trust-run", option, path));
}

/// Runs parse(text), whose error speaks of an option, for a field of the file.
template <class Parse>
auto parsed(const JsonFields& fields, const char* key, const std::string& text, const Parse& parse) {
  try {
    return parse(text);
  } catch (const InputError& problem) {
    fields.fail(key, problem.what());
  }
}

/// The name of a file or folder, as escape_name wrote it.
std::string read_path(const JsonFields& json, const char* key) {
  std::string path = unescape_name(json.text(key));
  for (const auto& part : fs::path(path))
    if (part.native().size() > NAME_MAX || path.size() >= PATH_MAX) json.fail(key, "is too long for a path");
  return path;
}

std::vector<HostId> read_hosts(const JsonFields& run, const std::string& split) {
  std::vector<HostId> hosts;
  std::set<std::pair<std::string, int>> seen;
  for (const auto& entry : run.list(split, kMostHosts)) {
    const JsonFields host = run.inner(fmt::format("{}[{}]", split, hosts.size()), entry);
    HostId id{unescape_name(host.text("frame")), static_cast<int>(host.integer("label", 0, 1'000'000))};
    if (const std::string problem = frame_id_problem(id.frame); !problem.empty()) host.fail("frame", problem);
    if (!seen.emplace(id.frame, id.label).second) host.fail("label", "names a host for the second time");
    hosts.push_back(std::move(id));
  }
  return hosts;
}

LidarEffects read_lidar_effects(const JsonFields& json) {
  const auto vector = [&](const char* key, std::size_t count) {
    return json.numbers(key, count, -kLargestEffect, kLargestEffect);
  };
  LidarEffects effects;
  effects.range_sigma = json.number("range_sigma", 0, kLargestEffect);
  effects.drop_out = json.number("drop_out", 0, 1);
  effects.signal_floor = json.number("signal_floor", 0, kLargestEffect);
  effects.divergence = Vec2d(vector("divergence", 2).data());
  effects.pulse_length = json.number("pulse_length", 0, kLargestEffect);
  effects.albedo = json.truth("albedo");
  effects.velocity = Vec3d(vector("velocity", 3).data());
  effects.yaw_rate = json.number("yaw_rate", -kLargestEffect, kLargestEffect);
  effects.seed = json.counter("seed");
  try {
    check_effects(effects);
  } catch (const InputError& problem) {
    json.fail("range_sigma", problem.what());
  }
  return effects;
}

SimulationSettings read_simulation(const JsonFields& json) {
  SimulationSettings settings;
  settings.raster.sigma = json.number("sigma", kSmallestSigma, kLargestSigma);
  settings.raster.gamma = json.number("gamma", kSmallestSigma, kLargestGamma);
  settings.raster.epsilon = json.number("epsilon", -1e6, 1e6);
  settings.raster.dist_eps = json.number("dist_eps", 1e-12, 0.49);
  settings.supersampling = static_cast<int>(json.integer("supersampling", 1, 32));
  settings.lidar_reflectivity = json.number("lidar_reflectivity", 0, 1e3);
  settings.occlusion_margin = json.number("occlusion_margin", -1e3, 1e3);
  settings.grazing_cosine = json.number("grazing_cosine", 1e-9, 1);
  settings.reference = json.has("double") && json.truth("double");
  settings.exact_coverage = json.has("exact_coverage") && json.truth("exact_coverage");
  if (json.has("light")) settings.light = parsed(json, "light", json.text("light"), parse_light_model);
  if (json.has("lidar_effects")) settings.lidar_effects = read_lidar_effects(json.object("lidar_effects"));
  return settings;
}

/// Detector, weights and depth completion: words of shipped parts and paths of data; code is refused.
void read_parts(const JsonFields& json, TrustRun trust, Run& run) {
  run.detector = read_path(json, "detector");
  run.weights = read_path(json, "weights");
  run.defense = json.text("defense");
  run.depth = read_path(json, "depth");
  if (!is_shipped_detector(run.detector) && run.detector != kGivenDetector && !is_plugin(run.detector))
    json.fail("detector", fmt::format("\"{}\" is no detector", run.detector));
  if (!is_shipped_depth(run.depth) && !is_plugin(run.depth))
    json.fail("depth", fmt::format("\"{}\" is no depth completion", run.depth));
  if (trust == TrustRun::yes) return;
  if (weights_are_code(run.detector)) std::swap(run.weights, run.refused.weights);
  if (is_plugin(run.detector)) std::swap(run.detector, run.refused.detector);
  if (is_plugin(run.depth)) std::swap(run.depth, run.refused.depth);
}

}  // namespace

nlohmann::json with_unnamed_settings(nlohmann::json run) {
  if (!run.is_object()) return run;
  for (const auto& [name, meant] :
       {std::pair("defense", "none"), std::pair("depth", "ip-basic"), std::pair("rooftop", "box"),
        std::pair("sun", "frame"), std::pair("parts", "both"), std::pair("renderer", kRasterRenderer)})
    if (!run.contains(name)) run[name] = meant;
  return run;
}

nlohmann::json to_json(const std::vector<HostId>& hosts) {
  auto list = nlohmann::json::array();
  for (const HostId& host : hosts)
    list.push_back({{"frame", escape_name(host.frame)}, {"label", host.label}});
  return list;
}

nlohmann::json to_json(const SimulationSettings& settings) {
  nlohmann::json json = {{"sigma", settings.raster.sigma},
                         {"gamma", settings.raster.gamma},
                         {"epsilon", settings.raster.epsilon},
                         {"dist_eps", settings.raster.dist_eps},
                         {"supersampling", settings.supersampling},
                         {"lidar_reflectivity", settings.lidar_reflectivity},
                         {"occlusion_margin", settings.occlusion_margin},
                         {"grazing_cosine", settings.grazing_cosine}};
  if (settings.reference) json["double"] = true;  // only then: runs of before the choice go on
  if (settings.exact_coverage) json["exact_coverage"] = true;
  if (settings.light != LightModel::plain) json["light"] = to_string(settings.light);
  if (const LidarEffects& e = settings.lidar_effects; e.any())
    json["lidar_effects"] = {{"range_sigma", e.range_sigma},
                             {"drop_out", e.drop_out},
                             {"signal_floor", e.signal_floor},
                             {"divergence", {e.divergence.x(), e.divergence.y()}},
                             {"pulse_length", e.pulse_length},
                             {"albedo", e.albedo},
                             {"velocity", {e.velocity.x(), e.velocity.y(), e.velocity.z()}},
                             {"yaw_rate", e.yaw_rate},
                             {"seed", e.seed}};
  return json;
}

bool is_other_data(const Run& run, const std::filesystem::path& data) {
  return std::filesystem::weakly_canonical(data) != std::filesystem::weakly_canonical(run.data);
}

void require_own_data(const Run& run, const std::filesystem::path& data) {
  if (is_other_data(run, data))
    throw InputError("--data", data.string(), "is not the data set of the run",
                     "leave --data out, or attack that data set");
}

namespace {

/// A network of a Python program, outside that program: the copy that the run has of it, which is code.
void use_copy_of_given(const Run& run, DetectorOptions& options) {
  const auto copy = run.folder / kGivenDetectorCopy;
  if (!std::filesystem::exists(copy))
    throw InputError(
        run.folder.string(), "detector",
        "the run attacked a network inside a Python program, of which it has no copy",
        "use mirage.evaluate(RUN, detector=…) there, or judge another detector: --detector fusion, "
        "lidar, or torchscript with --weights FILE.pt");
  if (run.trust != TrustRun::yes && !is_code_made_here(copy))
    refuse(run, "detector", "a TorchScript model", copy, "--detector torchscript --weights");
  options.detector = "torchscript";
  options.weights = copy;
  if (options.defense.empty()) options.defense = run.defense;
}

}  // namespace

void remember_code_made_here(const fs::path& file) {
  DiskCache::from_environment()->write(kMadeHere, read_file(file), "");
}

bool is_code_made_here(const fs::path& file) {
  return DiskCache::from_environment()->read(kMadeHere, read_file(file)).has_value();
}

void use_detector_of(const Run& run, DetectorOptions& options) {
  if (options.detector.empty() && run.detector == kGivenDetector && !given_detector())
    return use_copy_of_given(run, options);
  const Run::Refused& refused = run.refused;
  if (options.detector.empty() && !refused.detector.empty())
    refuse(run, "detector", "a plugin", refused.detector, "--detector");
  if (options.detector.empty()) options.detector = run.detector;
  const bool same = options.detector == (refused.detector.empty() ? run.detector : refused.detector);
  if (options.defense.empty())
    options.defense =
        same && (options.weights.empty() || run.defense.starts_with("jpeg:")) ? run.defense : "none";
  if (!options.weights.empty() || !same || options.defense != run.defense) return;
  if (!refused.weights.empty())
    refuse(run, "weights",
           options.detector == "torchscript" ? "a TorchScript model" : "a plugin's weights file",
           refused.weights, "--weights");
  options.weights = run.weights;
}

std::string depth_of(const Run& run, const std::string& asked) {
  if (!asked.empty()) return asked;
  if (!run.refused.depth.empty()) refuse(run, "depth", "a plugin", run.refused.depth, "--depth");
  return run.depth;
}

Run read_run(const fs::path& folder, TrustRun trust) {
  const auto file = folder / "run.json";
  if (!fs::exists(file))
    throw InputError(folder.string(), "run.json", "missing, so this is not a run folder",
                     "give the --out folder of a finished mirage attack");
  if (!fs::exists(folder / "adversary.glb"))
    throw InputError(folder.string(), "adversary.glb", "missing: the attack has not finished",
                     "run the same mirage attack again; it resumes");
  const nlohmann::json whole = with_unnamed_settings(read_json(file));
  const JsonFields json(file, whole, kAgain);
  Run run;
  run.folder = folder;
  run.trust = trust;
  run.data = read_path(json, "data");
  read_parts(json, trust, run);
  run.target = json.text("target");
  parsed(json, "target", run.target, parse_target);
  run.rooftop = read_path(json, "rooftop");
  run.sun = json.text("sun");
  parsed(json, "sun", run.sun, parse_sun);
  run.train = read_hosts(json, "train");
  run.test = read_hosts(json, "test");
  run.min_view = json.number("min_view", 0, 1);
  if (json.has("seed")) run.seed = json.counter("seed");
  if (json.has("limits")) {
    const auto half = json.numbers("limits", 3, kSmallestSize, kLargestSize);
    run.limits.half = Vec3d(half[0], half[1], half[2]);
  }
  if (json.has("buildable")) {
    const auto rules = json.numbers("buildable", 4, 0, kLargestSize);
    run.buildable = {true, rules[0], rules[1], rules[2], rules[3]};
  }
  run.simulation = read_simulation(json.object("simulation"));
  run.adversary = read_adversary(folder / "adversary.glb");
  run.random = read_adversary(folder / "random.glb");
  return run;
}

}  // namespace mirage
