#include "attack/run.h"

#include "base/error.h"
#include "base/files.h"
#include "detection/given_detector.h"
#include "exchange/gltf.h"

namespace mirage {

nlohmann::json to_json(const std::vector<HostId>& hosts) {
  auto list = nlohmann::json::array();
  for (const HostId& host : hosts) list.push_back({{"frame", host.frame}, {"label", host.label}});
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
  if (settings.light != LightModel::plain) json["light"] = to_string(settings.light);
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

/// A network of a Python program, outside that program: the copy that the run has of it.
void use_copy_of_given(const Run& run, DetectorOptions& options) {
  const auto copy = run.folder / kGivenDetectorCopy;
  if (!std::filesystem::exists(copy))
    throw InputError(
        run.folder.string(), "detector",
        "the run attacked a network inside a Python program, of which it has no copy",
        "use mirage.evaluate(RUN, detector=…) there, or judge another detector: --detector fusion, "
        "lidar, or torchscript with --weights FILE.pt");
  options.detector = "torchscript";
  options.weights = copy;
  if (options.defense.empty()) options.defense = run.defense;
}

}  // namespace

void use_detector_of(const Run& run, DetectorOptions& options) {
  if (options.detector.empty() && run.detector == kGivenDetector && !given_detector())
    return use_copy_of_given(run, options);
  if (options.detector.empty()) options.detector = run.detector;
  const bool same = options.detector == run.detector;
  if (options.defense.empty())
    options.defense =
        same && (options.weights.empty() || run.defense.starts_with("jpeg:")) ? run.defense : "none";
  if (options.weights.empty() && same && options.defense == run.defense) options.weights = run.weights;
}

Run read_run(const std::filesystem::path& folder) {
  const auto file = folder / "run.json";
  if (!std::filesystem::exists(file))
    throw InputError(folder.string(), "run.json", "missing, so this is not a run folder",
                     "give the --out folder of a finished mirage attack");
  if (!std::filesystem::exists(folder / "adversary.glb"))
    throw InputError(folder.string(), "adversary.glb", "missing: the attack has not finished",
                     "run the same mirage attack again; it resumes");
  const nlohmann::json json = read_json(file);
  Run run;
  run.folder = folder;
  try {
    run.data = json.at("data").get<std::string>();
    run.detector = json.at("detector");
    run.weights = json.at("weights").get<std::string>();
    run.defense = json.value("defense", run.defense);
    run.target = json.at("target");
    run.depth = json.value("depth", run.depth);
    run.rooftop = json.value("rooftop", run.rooftop);
    run.sun = json.value("sun", run.sun);
    const auto read_hosts = [](const nlohmann::json& list) {
      std::vector<HostId> hosts;
      for (const auto& host : list) hosts.push_back({host.at("frame"), host.at("label")});
      return hosts;
    };
    run.train = read_hosts(json.at("train"));
    run.test = read_hosts(json.at("test"));
    run.min_view = json.at("min_view");
    run.seed = json.value("seed", run.seed);
    if (json.contains("limits"))
      for (int c = 0; c < 3; ++c) run.limits.half[c] = json.at("limits").at(static_cast<std::size_t>(c));
    if (json.contains("buildable")) {
      const auto& rules = json.at("buildable");
      run.buildable = {true, rules.at(0), rules.at(1), rules.at(2), rules.at(3)};
    }
    const auto& simulation = json.at("simulation");
    run.simulation.raster.sigma = simulation.at("sigma");
    run.simulation.raster.gamma = simulation.at("gamma");
    run.simulation.raster.epsilon = simulation.at("epsilon");
    run.simulation.raster.dist_eps = simulation.at("dist_eps");
    run.simulation.supersampling = simulation.at("supersampling");
    run.simulation.lidar_reflectivity = simulation.at("lidar_reflectivity");
    run.simulation.occlusion_margin = simulation.at("occlusion_margin");
    run.simulation.grazing_cosine = simulation.at("grazing_cosine");
    run.simulation.reference = simulation.value("double", false);
    run.simulation.light = parse_light_model(simulation.value("light", "plain"));
  } catch (const nlohmann::json::exception& error) {
    throw InputError(file.string(), "", error.what(), "run mirage attack again into an empty folder");
  }
  run.adversary = read_adversary(folder / "adversary.glb");
  run.random = read_adversary(folder / "random.glb");
  return run;
}

}  // namespace mirage
