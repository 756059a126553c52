#include "attack/run.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>

#include "base/disk_cache.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/names.h"
#include "base/ranks.h"
#include "detection/detector_settings.h"
#include "detection/process_detector.h"
#include "exchange/gltf.h"
#include "frames/frame_store.h"
#include "scene/data/data_rig.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "simulation/insertion.h"
#include "simulation/sensor_plugin.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxHosts = 1'000'000;
constexpr const char* kMadeHere = "made-here";  // the cache's name for code that this user's runs wrote
constexpr const char* kPlaced = "placed";       // content of the run's placement when it was made
constexpr const char* kGamut = "gamut";
constexpr const char* kGamutColours = "gamut_colours";  // colours of the run's gamut when it was made
constexpr const char* kAgain = "restore the file, or run mirage attack again into an empty folder";

bool is_plugin(const std::string& name) {
  return is_plugin_path(name) || is_program(name);
}

/// Hashes of user-supplied plugins and their inputs, by their keys in run.json. Shipped plugins are excluded:
/// a run resumes with a newer program.
nlohmann::json plugin_hashes(const AttackSettings& settings) {
  nlohmann::json hashes = nlohmann::json::object();
  if (is_plugin_path(settings.detector.detector))
    hashes["plugin_hash"] = file_hash(plugin_file(settings.detector));
  if (is_plugin_path(settings.depth))  // independent of the number of threads
    hashes["depth_hash"] = content_hash(depth_identity({.backend = settings.depth, .threads = 1}));
  std::string sensors;
  for (const std::string& word : listed_words(settings.sensors))
    if (is_plugin_path(word)) sensors += (sensors.empty() ? "" : ",") + word;
  if (!sensors.empty()) hashes["sensors_hash"] = content_hash(sensors_identity(sensors));
  return hashes;
}

[[noreturn]] void refuse(const Run& run, const char* field, const char* what, const fs::path& file,
                         const char* option) {
  const std::string path =
      is_program(file) ? "\"" + file.string() + "\"" : fs::absolute(file).lexically_normal().string();
  throw InputError((run.folder / "run.json").string(), field,
                   fmt::format("{} would be loaded, which is code: {}", what, path),
                   fmt::format("if you trust it, name it yourself ({} {}) or add --trust-run", option, path));
}

std::vector<HostId> read_hosts(const JsonFields& run, const std::string& split) {
  std::vector<HostId> hosts;
  std::set<std::pair<std::string, int>> seen;
  for (const auto& entry : run.list(split, kMaxHosts)) {
    const JsonFields host = run.inner(fmt::format("{}[{}]", split, hosts.size()), entry);
    HostId id{unescape_name(host.text("frame")), static_cast<int>(host.integer("label", 0, 1'000'000))};
    if (const std::string problem = frame_id_problem(id.frame); !problem.empty()) host.fail("frame", problem);
    if (!seen.emplace(id.frame, id.label).second) host.fail("label", "names a host for the second time");
    hosts.push_back(std::move(id));
  }
  return hosts;
}

/// Refuses code among detector, weights, depth completion and sensors: words of shipped parts, or paths.
void refuse_code(const JsonFields& json, Run& run) {
  DetectorOptions& options = run.settings.detector;
  std::string& depth = run.settings.depth;
  if (!is_shipped_detector(options.detector) && options.detector != kInProcessDetector &&
      !is_plugin(options.detector))
    json.fail("detector", fmt::format("\"{}\" is not a detector", options.detector));
  if (!is_shipped_depth(depth) && !is_plugin(depth))
    json.fail("depth", fmt::format("\"{}\" is not a depth completion", depth));
  std::string& sensors = run.settings.sensors;
  bool other_sensors = false;
  for (const std::string& word : listed_words(sensors)) {
    if (!is_shipped_sensor(word) && !is_plugin(word))
      json.fail("sensors", fmt::format("\"{}\" is not a sensor", word));
    other_sensors = other_sensors || is_plugin(word);
  }
  if (run.trust == TrustRun::yes) return;
  if (other_sensors) std::swap(sensors, run.refused.sensors);
  if (weights_are_code(options.detector)) std::swap(options.weights, run.refused.weights);
  if (is_plugin(options.detector)) std::swap(options.detector, run.refused.detector);
  if (is_plugin(depth)) std::swap(depth, run.refused.depth);
}

/// Uses the run's copy (code) of a network that lived in a Python program.
void use_copy_of_in_process(const Run& run, DetectorOptions& options) {
  const auto copy = run.folder / kInProcessDetectorCopy;
  if (!std::filesystem::exists(copy))
    throw InputError(run.folder.string(), "detector",
                     "the run attacked a network inside a Python program, of which it has no copy",
                     "use mirage.evaluate(RUN, detector=…) there, or judge another detector: --detector "
                     "fusion, lidar, or torchscript with --weights FILE.pt");
  if (run.trust != TrustRun::yes && !is_code_made_here(copy))
    refuse(run, "detector", "a TorchScript model", copy, "--detector torchscript --weights");
  options.detector = "torchscript";
  options.weights = copy;
  if (options.defense.empty()) options.defense = run.settings.detector.defense;
}

}  // namespace

nlohmann::json to_json(const std::vector<HostId>& hosts) {
  auto list = nlohmann::json::array();
  for (const HostId& host : hosts)
    list.push_back({{"frame", escape_name(host.frame)}, {"label", host.label}});
  return list;
}

RunIdentity identity(const AttackSettings& settings) {
  nlohmann::json id = fields_json(settings), lacking = lacking_json<AttackSettings>();
  id["rooftop_model_hash"] = rooftop_model_hash(settings.rooftop);
  lacking["rooftop_model_hash"] = "";
  if (settings.rig.ends_with(".toml")) id["rig_hash"] = file_hash(settings.rig);
  if (content_of(settings.placement).is_object()) id[kPlaced] = to_json(settings.placement);
  const PrintGamut& gamut = settings.buildable.gamut;
  if (!gamut.is_box() && (settings.buildable.on || gamut.name() != kDefaultGamut))
    id[kGamutColours] = to_json(gamut);
  const nlohmann::json plugins = plugin_hashes(settings);
  id.update(plugins), lacking.update(plugins);  // missing in runs of earlier versions
  return {id, lacking};
}

bool is_other_data(const Run& run, const std::filesystem::path& data) {
  return std::filesystem::weakly_canonical(data) != std::filesystem::weakly_canonical(run.settings.data);
}

std::set<std::string> frames_shared(const fs::path& data, const fs::path& other,
                                    std::span<const std::string> ids, std::size_t* unknown) {
  std::map<std::uintmax_t, std::vector<fs::path>> sweeps;  // by file size, which few other sweeps share
  std::set<std::string> gone;
  for (const std::string& id : ids) try {
      const fs::path sweep = open_data_set(other)->source_files(id).at(0).file;
      sweeps[fs::file_size(sweep)].push_back(sweep);
    } catch (const std::exception&) {  // the frame or the data set is missing
      gone.insert(id);
    }
  std::set<std::string> shared;
  const auto set = open_data_set(data);
  for (const std::string& id : set->frames()) {
    const fs::path sweep = set->source_files(id).at(0).file;
    std::error_code error;
    const auto same = sweeps.find(fs::file_size(sweep, error));
    if (!error && same != sweeps.end()) {
      const std::string hash = file_hash(sweep, kMaxFileBytes);
      if (std::ranges::any_of(same->second,
                              [&](const fs::path& file) { return file_hash(file, kMaxFileBytes) == hash; }))
        shared.insert(id);
    }
    if (unknown != nullptr) *unknown += gone.contains(id);
  }
  return shared;
}

std::set<std::string> frames_learned_on(const Run& run, const fs::path& data) {
  const std::vector<std::string> train = host_frames(run.train);
  if (train.empty() || !is_other_data(run, data)) return {train.begin(), train.end()};
  std::size_t unknown = 0;
  auto learned = frames_shared(data, run.settings.data, train, &unknown);
  if (unknown > 0 && rank() == 0)
    spdlog::warn(
        "{} frames of {} have the names of training frames of {}. Whether they are the same frames cannot be "
        "checked, because {} is missing",
        unknown, data.string(), run.folder.string(), run.settings.data.string());
  return learned;
}

void require_own_data(const Run& run, const std::filesystem::path& data) {
  if (is_other_data(run, data))
    throw FieldError("data", data.string(), "is not the data set of the run",
                     "leave --data out, or attack that data set");
}

void remember_code_made_here(const fs::path& file) {
  DiskCache::from_environment()->write(kMadeHere, read_file(file), "");
}

bool is_code_made_here(const fs::path& file) {
  return DiskCache::from_environment()->read(kMadeHere, read_file(file)).has_value();
}

DetectorOptions detector_of_the_run() {
  DetectorOptions open;
  open.detector.clear();
  open.defense.clear();
  open.precision.clear();
  open.locality = -1;
  return open;
}

void use_detector_of(const Run& run, DetectorOptions& options) {
  const std::string& own =
      run.refused.detector.empty() ? run.settings.detector.detector : run.refused.detector;
  const DetectorOptions computed =
      options.detector.empty() || options.detector == own ? run.settings.detector : DetectorOptions();
  if (options.precision.empty()) options.precision = computed.precision;
  if (options.locality < 0) options.locality = computed.locality;
  if (options.matching == MatchBy::own) options.matching = computed.matching;
  if (options.detector.empty() && run.settings.detector.detector == kInProcessDetector &&
      !in_process_detector(run.settings.detector))
    return use_copy_of_in_process(run, options);
  const Run::Refused& refused = run.refused;
  if (options.detector.empty() && !refused.detector.empty())
    refuse(run, "detector", is_program(refused.detector) ? "a program" : "a plugin", refused.detector,
           "--detector");
  if (options.detector.empty()) options.detector = run.settings.detector.detector;
  const bool same = options.detector == own;
  if (options.defense.empty())
    options.defense =
        same && (options.weights.empty() || read_defense(run.settings.detector.defense).weights.empty())
            ? run.settings.detector.defense
            : "none";
  if (!options.weights.empty() || !same || options.defense != run.settings.detector.defense) return;
  if (!refused.weights.empty())
    refuse(run, "weights",
           options.detector == "torchscript" ? "a TorchScript model" : "a plugin's weights file",
           refused.weights, "--weights");
  options.weights = run.settings.detector.weights;
}

void override_settings(AttackSettings& settings, const Overrides& overrides, std::uint64_t seed) {
  for (const auto& [name, text] : overrides)
    if (name == "quality")
      apply_quality(text, settings.simulation);
    else if (name != "lidar_effects")
      set_field(settings, name, text);
  if (const auto words = overrides.find("lidar_effects");
      words != overrides.end()) {  // uses the recording unit's divergence
    settings.simulation.lidar_effects = parse_lidar_effects(
        words->second == kAsRecorded ? recorded_lidar_effects(settings.data, settings.rig) : words->second,
        lidar_of(settings.data, settings.rig).divergence);
    if (settings.simulation.lidar_effects.any()) settings.simulation.lidar_effects.seed = seed;
  }
  settings.simulation.camera_effects.seed = seed;
}

void override_settings(Run& run, const Overrides& overrides, std::uint64_t seed, bool other_data) {
  if (const auto data = overrides.find("data"); data != overrides.end() && !other_data)
    require_own_data(run, data->second);
  if (overrides.contains("depth")) run.refused.depth.clear();
  if (!run.refused.depth.empty()) refuse(run, "depth", "a plugin", run.refused.depth, "--depth");
  if (overrides.contains("sensors")) run.refused.sensors.clear();
  if (!run.refused.sensors.empty()) refuse(run, "sensors", "a plugin", run.refused.sensors, "--sensors");
  override_settings(run.settings, overrides, seed);
}

Run read_run(const fs::path& folder, TrustRun trust) {
  const auto file = folder / "run.json";
  if (!fs::exists(file))
    throw InputError(folder.string(), "run.json", "missing, so this is not a run folder",
                     "give the --out folder of a finished mirage attack");
  if (!fs::exists(folder / "adversary.glb"))
    throw InputError(folder.string(), "adversary.glb", "missing: the attack has not finished",
                     "run the same mirage attack again; it resumes");
  // A foreign run may be any text; a real one lists its hosts, at most the 28 742 cars of KITTI's benchmark.
  constexpr std::uintmax_t kMaxBytes = 1 << 22;
  constexpr std::size_t kMaxValues = 200000;
  const nlohmann::json whole = read_json(file, kMaxBytes, kMaxValues);
  const JsonFields json(file, whole, kAgain);
  Run run;
  run.folder = folder;
  run.trust = trust;
  nlohmann::json settings = whole;
  if (!json.has(kPlaced) && json.has("placement") && json.text("placement").ends_with(".toml"))
    json.fail(kPlaced, "is missing: the run says what its placement's file said");
  if (json.has(kPlaced)) settings.erase("placement");   // its file may have changed since, or be elsewhere
  if (json.has(kGamutColours)) settings.erase(kGamut);  // the same
  read_fields(JsonFields(file, settings, kAgain), run.settings);
  if (json.has(kGamutColours))
    run.settings.buildable.gamut =
        read_gamut(whole.at(kGamutColours), file, kGamutColours, json.text(kGamut));
  if (json.has(kPlaced)) {
    json.object(kPlaced);
    run.settings.placement = read_place(whole.at(kPlaced), file, kPlaced, json.text("placement"));
  }
  refuse_code(json, run);
  try {
    check_effects(run.settings.simulation.lidar_effects);
  } catch (const InputError& problem) {
    json.fail("simulation", problem.what());
  }
  run.train = read_hosts(json, "train");
  run.test = read_hosts(json, "test");
  if (json.has(kTrainFrames)) run.train_frames = json.text(kTrainFrames);
  if (json.has(kTestFrames)) run.test_frames = json.text(kTestFrames);
  run.adversary = read_adversary(folder / "adversary.glb");
  run.random = read_adversary(folder / "random.glb");
  return run;
}

}  // namespace mirage
