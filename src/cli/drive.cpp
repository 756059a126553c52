// mirage drive: an object on every vehicle of a drive, in seconds and metres.
#include "attack/drive.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "attack/baseline.h"
#include "attack/zoo.h"
#include "base/error.h"
#include "base/logging.h"
#include "base/ranks.h"
#include "cli/command.h"
#include "cli/options.h"
#include "detection/detector_settings.h"
#include "detection/process_detector.h"
#include "frames/frame_provenance.h"
#include "validation/blender/blender_process.h"

namespace mirage::cli {
namespace {

struct DriveOptions {
  std::filesystem::path run, mesh;
  Overrides overrides;
  TrustRun trust = TrustRun::no;
  DetectorOptions detector = detector_of_the_run();
  QualityOption quality;
  LidarEffectsOption effects;
  SequencePart part;
  DriveSettings settings;
  double score = EvaluationSettings().score_threshold;
  std::string tracker;
  int cycles = 0;  ///< vehicles
  CyclesRenderer::Settings blender;
};

/// The run, or one that has nothing but the mesh.
Run run_of(const DriveOptions& options) {
  if (options.run.empty() == options.mesh.empty())
    throw InputError("--run", "--mesh", options.run.empty() ? "are both missing" : "are both given",
                     "give a finished mirage attack or an object's mesh");
  if (!options.run.empty()) return read_run(options.run, options.trust);
  const std::vector<NamedObject> objects = read_objects({options.mesh});
  if (objects.size() > 1)
    throw FieldError("mesh", options.mesh.string(), "is several objects, and a drive has one", "name a file");
  return run_of_objects(objects);
}

void print_drive(const DriveResult& result, const nlohmann::json& json) {
  const auto value = [](const nlohmann::json& at) {
    const double low = at.at("low"), high = at.at("high");  // of few vehicles nothing is known
    const std::string text = fmt::format("{:.1f}", at.at("value").get<double>());
    return std::isfinite(low) && std::isfinite(high) ? fmt::format("{} ({:.1f} to {:.1f})", text, low, high)
                                                     : text;
  };
  print_table({{"frames", std::to_string(result.frames)},
               {"vehicles", std::to_string(result.vehicles.size())},
               {"tracker as recorded",
                fmt::format("MOTA {}, HOTA {}, {} identity switches", percent(result.clean.mota),
                            percent(result.clean.hota), result.clean.switches)}});
  Columns rows = {{"median over vehicles (95 %)", "clean", "attacked", "random of its size"}};
  for (const auto& [key, name] : {std::pair("gap_s", "longest gap of detection, s"),
                                  std::pair("track_gap_s", "longest gap of a confirmed track, s"),
                                  std::pair("confirmed_m", "distance at first confirmation, m")}) {
    const nlohmann::json& of = json.at(key);
    rows.push_back({name, value(of.at("clean")), value(of.at("attacked")), value(of.at("random"))});
  }
  const nlohmann::json& never = json.at("never_confirmed");
  rows.push_back({"vehicles never confirmed", never.at("clean").dump(), never.at("attacked").dump(),
                  never.at("random").dump()});
  print_columns(rows);
}

void add_options(CLI::App& app, DriveOptions& options) {
  app.add_option("--run", options.run, "run folder of mirage attack: its adversary is the object");
  app.add_option("--mesh", options.mesh, "object in place of a run's, in metres (.glb, .gltf, .obj or .ply)");
  add_trust_option(app, options.trust);
  add_overrides<FrameSource>(app, options.overrides);
  app.get_option("--data")->required();
  add_fields(app, options.part);
  add_fields(app, options.detector, {}, "the run's");
  options.quality.add(app, "the run's settings");
  add_overrides<SimulationSettings>(app, options.overrides, {"light", "camera_effects"});
  options.effects.add(app, "the run's");
  add_fields(app, options.settings);
  app.add_option("--tracker", options.tracker,
                 "a tracker of yours in place of ours, a program: \"exec:python3 my_tracker.py\"");
  add_defaulted(
      app, "--cycles", options.cycles,
      "re-judge the N vehicles that are hidden longest, with Blender Cycles' pictures and, by default, "
      "--lidar-effects as-recorded. 0: none")
      ->check(within({0, 1000}));
  add_defaulted(app, "--cycles-samples", options.blender.samples, "with --cycles: samples per pixel")
      ->check(within({1, 4096}));
  add_score_option(app, options.score);
  add_cache_note(app);
}

/// The user's tracker, by whose content and version a drive is known; null: none.
std::unique_ptr<Detector> tracker_of(const DriveOptions& options, const Common& common) {
  if (options.tracker.empty()) return nullptr;
  DetectorOptions program;
  program.detector = options.tracker;
  program.seed = common.seed;
  program.threads = 1;
  std::unique_ptr<Detector> tracker = load_detector(program);
  common.provenance->input("tracker", outside_content(program));
  common.provenance->input("tracker_version", tracker->capabilities().version);
  return tracker;
}

/// The vehicles that are hidden longest, in Cycles; null where there are none.
nlohmann::json in_cycles(const DriveOptions& options, const Common& common, const DetectorPool& detectors,
                         FrameStore& store, const Run& run, const DriveResult& result, DriveRequest request) {
  const DriveVehicles worst = longest_hidden(result, options.cycles);
  if (worst.empty()) return nullptr;
  CyclesRenderer::Settings settings = options.blender;
  settings.out = common.out;
  settings.workers = static_cast<int>(detectors.size());
  CyclesRenderer renderer(settings);
  AttackSettings physical = run.settings;
  if (options.effects.words.empty())
    override_settings(physical, {{"lidar_effects", kAsRecorded}}, common.seed);
  request.simulation = physical.simulation;
  request.renderer = &renderer;
  request.only = worst;
  request.folder = common.out / "vehicles-cycles";
  request.provenance.add(physical);
  request.provenance.set("renderer", renderer.identity());
  nlohmann::json judged = by_renderer(judge_drive(detectors, store, request), result);
  judged["lidar_effects"] = options.effects.words.empty() ? kAsRecorded : options.effects.words;
  return judged;
}

nlohmann::json run(const DriveOptions& options, const Common& common) {
  Run run = run_of(options);
  options.effects.check();
  // By the run's own data set, which the options replace.
  const std::set<std::string> learned = frames_learned_on(run, options.overrides.at("data"));
  Overrides overrides = options.overrides;
  options.quality.add_to(overrides);
  options.effects.add_to(overrides);
  override_settings(run, overrides, common.seed, true);
  if (const Victim victim = run.settings.placement.victim;
      victim == Victim::neighbour || victim == Victim::object)
    throw FieldError("placement", text_of(run.settings.placement),
                     fmt::format("is to hide the {}, and a drive follows the vehicle that carries the object",
                                 to_word(victim)),
                     "give a --place whose victim is the carrier");
  DetectorOptions detector = options.detector;
  use_detector_of(run, detector);
  detector = with_common(detector, common, run.settings);
  detector.precision = usable_precision(detector.precision);
  check_fields(options.settings);
  DriveRequest request;
  request.data = run.settings.data;
  request.sequences = read_sequences(request.data, options.part);
  request.object = run.adversary;
  request.random = baseline_meshes(run, Baseline::sized, 1).front();
  request.place = run.settings.placement;
  if (overrides.contains("classes") || run.settings.classes != kCars)
    request.types = classes_of(run.settings.classes);
  request.simulation = run.settings.simulation;
  request.evaluation.score_threshold = options.score;
  request.evaluation.quiet = common.quiet;
  request.settings = options.settings;
  request.folder = common.out / "vehicles";
  std::vector<std::string> frames;
  for (const Sequence& sequence : request.sequences)
    for (const SequenceFrame& frame : sequence.frames) frames.push_back(frame.id);
  const auto trained_on =
      std::ranges::count_if(frames, [&](const std::string& id) { return learned.contains(id); });
  if (trained_on > 0 && rank() == 0)
    spdlog::warn("the object was trained on {} of the {} frames: vehicles in them are not held-out",
                 trained_on, frames.size());
  FrameStore store(run.settings);
  const DetectorPool detectors = load_detector_pool(detector, static_cast<int>(frames.size()));
  const std::string version = detectors.front()->capabilities().version;
  request.evaluation.detector_identity = detector_identity(detector, version);
  common.provenance->add(run.settings);
  common.provenance->add(options.settings);
  common.provenance->add(options.part);
  add_frames(*common.provenance, run.settings, frames);
  add_detector(*common.provenance, detector);
  if (is_outside(detector)) common.provenance->input("version", version);
  common.provenance->input("object", hash_of(request.object));
  common.provenance->input("random", hash_of(request.random));
  if (options.cycles > 0 && !detectors.front()->capabilities().reads_image)
    throw FieldError("cycles", std::to_string(options.cycles),
                     detector.detector + " does not read the picture", "leave it out");
  const std::unique_ptr<Detector> tracker = tracker_of(options, common);
  request.tracker = tracker.get();
  request.goes_on =
      !request.evaluation.detector_identity.empty() && (!tracker || !tracker->capabilities().version.empty());
  request.provenance = *common.provenance;
  const DriveResult result = judge_drive(detectors, store, request);
  nlohmann::json drive = to_json(result);
  if (options.cycles > 0 && rank() == 0)
    drive["cycles"] = in_cycles(options, common, detectors, store, run, result, request);
  print_drive(result, drive);
  return {{"drive", drive},
          {"data", run.settings.data.string()},
          {"object", (options.run.empty() ? options.mesh : options.run).string()},
          {"frames_trained_on", trained_on},
          {"asked", overrides},  // in place of the run's, for mirage view
          {"detector", detector.detector},
          {"tracker", options.tracker},
          {"weights", detector.weights.string()},
          {"defense", detector.defense},
          {"score_threshold", options.score}};
}

}  // namespace

Command drive_command() {
  return command_of<DriveOptions>({
      .name = "drive",
      .help =
          "puts an object on each vehicle of a drive: seconds without detection, distance at confirmation",
      .example = "mirage drive --run out/attack --data kitti-tracking --sequence 0003 --weights real",
      .afterwards = [](const Common& common) { write_page(common.out); },
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
