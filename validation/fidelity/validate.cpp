#include "validation/fidelity/validate.h"

#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <set>

#include "attack/evaluate_run.h"
#include "base/child_process.h"
#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/ranks.h"
#include "frames/frame_provenance.h"
#include "scene/depth/learned_depth.h"
#include "scene/shape/shape_fit.h"
#include "simulation/insertion.h"

namespace mirage {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr int kLadder = 4;

/// A path that stays below the folder that it is relative to.
bool is_inside(const fs::path& path) {
  return path.is_relative() && std::find(path.begin(), path.end(), "..") == path.end();
}

/// The vehicle's stored result if it is of the same key and whole, and if the pictures that it names are
/// still there (the report embeds them); empty otherwise, and it is made again.
std::optional<VehicleResult> stored_result(const fs::path& out, const fs::path& file, const std::string& key,
                                           bool with_ladder) {
  if (!fs::exists(file)) return std::nullopt;
  VehicleResult vehicle;
  try {
    const json stored = read_json(file);
    if (!stored.is_object() || stored.value("key", json()) != key) return std::nullopt;
    vehicle = read_vehicle(file, stored);
  } catch (const InputError& damaged) {
    spdlog::warn("{}", damaged.what());
    return std::nullopt;
  }
  if (!vehicle.seen) return vehicle;
  std::error_code ignored;  // a name that can be none of a file
  for (const auto& [name, picture] : vehicle.seen->pictures)
    if (!is_inside(picture) || !fs::exists(out / picture, ignored)) return std::nullopt;
  if (with_ladder && !vehicle.seen->ladder) return std::nullopt;
  if (!with_ladder) vehicle.seen->ladder.reset();
  return vehicle;
}

/// Finds a result.json that the report needs at the end, by its path or its folder, and throws now if it is
/// unusable. `key`: a field that only its command writes.
void require_result(fs::path& file, const char* key, const std::string& command) {
  if (file.empty()) return;
  if (fs::is_directory(file)) file /= "result.json";
  if (const nlohmann::json result = read_json(file); !result.is_object() || !result.contains(key))
    throw InputError(
        file.string(), key, "is missing: this is not a result of mirage " + command,
        "give --" + std::string(command == "evaluate" ? "evaluation" : command) + " the folder of one");
}

/// The hash of the run behind a result.json of mirage; empty if it states none.
std::string run_of(const fs::path& file) {
  const json result = read_json(file);
  const json::json_pointer run("/provenance/inputs/run");
  return result.contains(run) && result.at(run).is_string() ? result.at(run).get<std::string>() : "";
}

/// Throws now for an evaluation whose object is not `run`'s, because the page calls it this object. Another
/// run's trade-off only causes a warning, because its figures are not the object's.
void require_same_run(const ValidationSettings& settings) {
  const std::string own = settings.provenance->input("run");  // of the command's option; none in a library
  if (own.empty()) return;
  if (!settings.evaluation.empty())
    if (const std::string theirs = run_of(settings.evaluation); theirs != own)
      throw InputError(settings.evaluation.string(), "provenance.inputs.run",
                       theirs.empty() ? "is missing: this is of objects that are not from a run (--mesh)"
                                      : "is of another run than " + settings.run.string(),
                       "give --evaluation what mirage evaluate --run " + settings.run.string() + " wrote");
  if (settings.tradeoff.empty()) return;
  if (const std::string theirs = run_of(settings.tradeoff); !theirs.empty() && theirs != own)
    spdlog::warn("{}: the trade-off was measured on another run's object", settings.tradeoff.string());
}

/// The variation that words of --expect mean, however they are written; unknown words unchanged.
json varied_by(const json& words) {
  try {
    return fields_json(parse_expectation(words.get<std::string>()));
  } catch (const std::exception&) {  // no program of ours wrote them
    return words;
  }
}

/// The rules by which a result of `mirage evaluate` or this validation was made, by names for readers; rules
/// that a result does not state are left out. `result`: result.json of mirage evaluate, or the part of this
/// validation's under the same keys.
std::vector<std::pair<std::string, json>> comparable_settings(const json& result) {
  std::vector<std::pair<std::string, json>> rules;
  const auto add = [&](const std::string& name, const char* place) {
    const json::json_pointer pointer(place);
    if (result.contains(pointer) && !result.at(pointer).is_null())
      rules.emplace_back(name, result.at(pointer));
  };
  add("detector", "/provenance/detector");
  add("weights", "/provenance/weights_hash");
  add("defence", "/provenance/defense");
  add("data", "/provenance/data");
  add("--iou", "/detected_iou");
  add("--score", "/score_threshold");
  add("--matching", "/plane");
  add("--expect", "/provenance/settings/expect");
  add("--place", "/placement");
  add("--place's file", "/placed");
  for (const char* field : {"rig", "depth", "rooftop", "cameras", "classes", "sun", "precision", "locality"})
    add(std::string("--") + field, (std::string("/provenance/settings/") + field).c_str());
  if (!result.contains("simulation") || !result.at("simulation").is_object()) return rules;
  for (const auto& [name, value] : result.at("simulation").items()) {
    rules.emplace_back(name, value);
    if (value.is_object()) rules.back().second.erase("seed");  // the same noise, drawn otherwise
  }
  return rules;
}

/// How the evaluation differs from this validation: "detector: lidar there, fusion here". `own`: as
/// comparable_settings() takes it.
std::vector<std::string> evaluation_differences(const fs::path& evaluation, const json& own) {
  std::vector<std::string> differences;
  if (evaluation.empty()) return differences;
  const auto theirs = comparable_settings(read_json(evaluation));
  const auto told = [](const json& value) {
    return value.is_string() ? value.get<std::string>() : value.dump();
  };
  bool other_place = false;
  for (const auto& rule : comparable_settings(own)) {
    const auto& [name, here] = rule;
    const auto there = std::find_if(theirs.begin(), theirs.end(),
                                    [&](const auto& entry) { return entry.first == rule.first; });
    if (there == theirs.end() || there->second == here) continue;
    if (name == "--expect" && varied_by(there->second) == varied_by(here)) continue;
    if (name == "--place's file" && other_place) continue;  // told by its name
    other_place = other_place || name == "--place";
    differences.push_back(here.is_structured()
                              ? fmt::format("{}: other values there", name)
                              : fmt::format("{}: {} there, {} here", name, told(there->second), told(here)));
    spdlog::warn("{}: {}", evaluation.string(), differences.back());
  }
  return differences;
}

/// The hosts' results, stored earlier or made now. Each is stored once finished, so that ranks find each
/// other's results. Hosts on which the renderer was lost go to `failed`.
std::vector<VehicleResult> vehicle_results(ValidationContext& context, const std::vector<HostId>& hosts,
                                           std::vector<AbandonedVehicle>& failed) {
  const ValidationSettings& settings = context.settings;
  const std::string version = context.detector.capabilities().version,
                    said_by = detector_identity(settings.detector, version);
  if (said_by.empty() && rank_count() > 1)
    throw InputError("validate", "mpirun",
                     "processes share finished vehicles, and this detector tells no version to keep them by",
                     "start it without mpirun");
  std::map<std::string, std::string> keys;  // by frame
  const std::vector<bool> has_ladder =
      ladder_hosts(hosts, settings.ladder < 0 && !(settings.budget > 0) ? kLadder : settings.ladder);
  Progress progress("validate", hosts.size(), settings.quiet);
  std::vector<std::optional<VehicleResult>> results(hosts.size());
  std::size_t done = 0;
  for (const std::size_t i : order_among_ranks(hosts.size())) {
    throw_if_interrupted("finished vehicles are kept; run the same command again to go on");
    const std::string name = host_name(hosts[i]);
    std::string& key = keys[hosts[i].frame];
    if (key.empty())
      key = content_hash(validation_key(settings, context.run, hosts[i].frame, context.renderer.identity()) +
                         fields_json(context.learned).dump() + version);
    const fs::path file = settings.out / "hosts" / (name + ".json");
    std::optional<VehicleResult>& result = results[i];
    if (!said_by.empty()) result = stored_result(settings.out, file, key, has_ladder[i]);
    if (!result) {
      try {
        result = validate_vehicle(context, hosts[i], has_ladder[i]);
      } catch (const ReferenceLost& lost) {  // the other vehicles' renders may well succeed
        spdlog::warn("{}: given up; {}", name, lost.what());
        failed.push_back({name, lost.what()});
        continue;
      }
      json stored = to_json(*result);
      stored["key"] = key;
      write_json(file, stored);
    }
    // As the data set has it now: stored results need not be made again for it.
    result->track = track_of(context.run.settings,
                             {hosts[i].frame, result->victim < 0 ? hosts[i].label : result->victim});
    progress.update(++done, name);
  }
  std::vector<VehicleResult> validated;
  for (std::optional<VehicleResult>& result : results)
    if (result) validated.push_back(std::move(*result));
  return validated;
}

/// How many of the verdict's vehicles the run was learned on. Warns if held-back vehicles are among them.
int trained_on(const Run& run, const std::vector<VehicleResult>& results, const Verdict& verdict,
               const std::set<std::string>& test_frames) {
  const bool held_back = &verdict.judged() == &verdict.held_back;
  std::vector<HostId> judged;
  for (const VehicleResult& vehicle : results)
    if (vehicle.seen && vehicle.seen->detected && (!held_back || test_frames.contains(vehicle.host.frame)))
      judged.push_back(vehicle.host);
  const std::size_t learned =
      hosts_learned_on(run, run.settings, judged, frames_learned_on(run, run.settings.data)).size();
  if (learned > 0 && held_back && rank() == 0)
    spdlog::warn(
        "the adversary was learned on {} of the {} held-back vehicles, in other frames of their drive",
        learned, judged.size());
  return static_cast<int>(learned);
}

}  // namespace

void write_report(const ValidationSettings& requested) {
  ValidationSettings settings = requested;
  require_result(settings.evaluation, "fn_asr", "evaluate");
  require_result(settings.tradeoff, "recommended", "tradeoff");
  const std::string python = plotting_python().string();
  if (python.empty())
    throw InputError("python3", "", "not found on PATH", "install it with apt-get install python3-jinja2");
  std::vector<std::string> arguments = {python,         shipped_file("validation/report/report.py").string(),
                                        "--validation", settings.out.string(),
                                        "--run",        settings.run.string()};
  if (!settings.evaluation.empty())
    arguments.insert(arguments.end(), {"--evaluation", settings.evaluation.string()});
  if (!settings.tradeoff.empty())
    arguments.insert(arguments.end(), {"--tradeoff", settings.tradeoff.string()});
  if (const fs::path viewer = built_file("report/model-viewer.min.js"); fs::exists(viewer))
    arguments.insert(arguments.end(), {"--viewer", viewer.string()});
  if (settings.sign_off) arguments.push_back("--sign-off");
  std::string output;
  if (const int status = run_program(arguments, &output); status != 0)
    throw Failure("report.py", output.empty() ? fmt::format("ended with status {}", status) : output,
                  output.starts_with("ModuleNotFoundError") ? "install python3-jinja2 and python3-pil"
                                                            : "finished vehicles are kept");
}

std::string validation_key(const ValidationSettings& settings, const Run& run, const std::string& frame,
                           const ReferenceIdentity& reference) {
  Provenance provenance;
  add_frames(provenance, run.settings, {&frame, 1});
  add_detector(provenance, settings.detector);
  provenance.add(run.settings.simulation);
  provenance.file("adversary", settings.run / "adversary.glb");
  reference.add_to(provenance);
  provenance.set("samples", settings.samples);
  provenance.set("noise", settings.noise);
  provenance.set("seed", settings.seed);
  const EvaluationSettings& evaluation = settings.evaluation_settings;
  provenance.set("score_threshold", evaluation.score_threshold);
  provenance.set("detected_iou", evaluation.detected_iou);
  provenance.set("false_positive_iou", evaluation.false_positive_iou);
  if (evaluation.expectation.any()) {
    provenance.set("expectation", fields_json(evaluation.expectation));
    provenance.set("expectation_seed", evaluation.expectation_seed);
  }
  return provenance.identity();
}

std::vector<HostId> select_hosts(const Run& run, int frames) {
  std::vector<HostId> selected;
  std::set<std::string> seen;
  for (const auto* list : {&run.test, &run.train}) {
    for (const HostId& id : *list) {
      const bool full =
          frames > 0 ? static_cast<int>(seen.size()) >= frames : selected.size() >= kVerdictVehicles;
      if (!seen.count(id.frame) && full) continue;
      seen.insert(id.frame);
      selected.push_back(id);
    }
  }
  return selected;
}

std::vector<HostId> shown_hosts(const Run& run, int frames) {
  return frames == 0 ? run.test : select_hosts(run, frames);
}

std::vector<bool> ladder_hosts(const std::vector<HostId>& hosts, int count) {
  std::vector<bool> on_ladder(hosts.size(), count < 0);
  std::map<std::string, int> of_frame;
  std::vector<std::pair<int, std::size_t>> order;  // place within the frame, place in the list
  for (std::size_t i = 0; i < hosts.size(); ++i) order.emplace_back(of_frame[hosts[i].frame]++, i);
  std::sort(order.begin(), order.end());
  for (std::size_t k = 0; k < order.size() && static_cast<int>(k) < count; ++k)
    on_ladder[order[k].second] = true;
  return on_ladder;
}

Validation validate(const ValidationSettings& requested, const StartReference& start) {
  ValidationSettings settings = requested;
  settings.evaluation_settings.expectation = parse_expectation(settings.expect);
  settings.evaluation_settings.expectation_seed = settings.seed;
  require_built(settings.evaluation_settings.expectation);
  Run run = read_run(settings.run, settings.trust);
  const SimulationSettings learned = run.settings.simulation;
  override_settings(run, settings.overrides, settings.seed);
  check_fields(run.settings);
  // Rays and pixels are compared with the reference's; the ladders add the effects.
  run.settings.simulation.lidar_effects = {};
  run.settings.simulation.camera_effects = {};
  require_result(settings.evaluation, "fn_asr", "evaluate");
  require_result(settings.tradeoff, "recommended", "tradeoff");
  require_same_run(settings);
  use_detector_of(run, settings.detector);
  const std::vector<HostId> hosts = select_hosts(run, settings.frames);
  if (hosts.empty())
    throw InputError((settings.run / "run.json").string(), "test", "no vehicles to validate",
                     "run mirage attack on a data set with cars in view");
  require_unchanged(run, hosts);
  const std::unique_ptr<ReferenceRenderer> renderer = start(settings.out);
  for (const char* folder : {"hosts", "scenes", "pictures"}) fs::create_directories(settings.out / folder);
  fs::remove(settings.out /
             "sign-off.html");  // of an earlier validation: nobody is to sign that for this one
  settings.detector = for_data(settings.detector, run.settings);
  DetectorPool detectors;
  detectors.push_back(load_detector(settings.detector));
  Validation validation;
  if (rank() == 0)  // only this rank prints
    validation.reliance = cached_reliance(
        detectors, detector_identity(settings.detector, detectors.front()->capabilities().version),
        run.settings, settings.quiet);
  FrameStore store(run.settings);
  ValidationContext context{settings, run, learned, store, *detectors.front(), *renderer, {}};
  const std::vector<VehicleResult> results = vehicle_results(context, hosts, validation.failed);
  if (results.empty())
    throw Failure(renderer->identity().name, "was lost on every vehicle",
                  "look at its log in " + settings.out.string());
  std::error_code ignored;
  fs::remove_all(scratch_folder(settings.out), ignored);
  for (const VehicleResult& vehicle : results)
    if (!vehicle.seen) validation.unseen.push_back(vehicle.name);
  if (validation.unseen.size() == results.size())
    throw Failure(
        "the object",
        fmt::format("is in view on none of {} vehicles: there is nothing to compare", results.size()),
        "give more --frames, or another --place");
  std::set<std::string> test_frames;
  for (const HostId& id : run.test) test_frames.insert(id.frame);
  validation.summary = summarize_vehicles(results, test_frames);
  validation.verdict = verdict(results, test_frames);
  validation.trained_on = trained_on(run, results, validation.verdict, test_frames);
  if (settings.budget > 0)
    validation.budget = choose_rungs(
        results, {settings.budget, settings.budget_of, settings.seed, settings.budget_confidence});
  for (const VehicleResult& vehicle : results) {
    validation.hosts.push_back(vehicle.name);
    for (const ReferenceLoss& loss : vehicle.losses) validation.losses.emplace_back(vehicle.name, loss);
  }
  validation.settings = requested;
  validation.placement = run.settings.placement;
  validation.reference = renderer->identity();
  settings.provenance->add(run.settings);
  settings.provenance->set("samples", settings.samples);
  settings.provenance->set("expect", settings.expect);
  settings.provenance->input(validation.reference.key, validation.reference.version);
  add_frames(*settings.provenance, run.settings, hosts);
  add_detector(*settings.provenance, settings.detector);
  validation.evaluation_differences = evaluation_differences(
      settings.evaluation, {{"provenance", settings.provenance->json()},
                            {"detected_iou", settings.evaluation_settings.detected_iou},
                            {"score_threshold", settings.evaluation_settings.score_threshold},
                            {"plane", detectors.front()->capabilities().matching().name()},
                            {"placement", text_of(run.settings.placement)},
                            {"placed", to_json(run.settings.placement)},
                            {"simulation", fields_json(learned)}});
  return validation;
}

std::string headline(const Validation& validation) {
  const bool sees = validation.reliance.uses_picture();
  std::string words = "No vehicle was found without the object: there is no success rate";
  if (const auto* condition = validation.verdict.nearest_to_reality(sees)) {
    words = fmt::format("Attack success {:.1f} % ({:.1f}–{:.1f}) {}with realistic returns",
                        100 * condition->asr.value, 100 * condition->asr.low, 100 * condition->asr.high,
                        sees ? "in Cycles " : "");
    if (condition->difference)
      words += std::string("; difference from Mirage's own rendering: ") +
               to_word(classify(*condition->difference));
  }
  const std::vector<Target> targets = targets_of(validation.summary);
  const auto count = [&](std::optional<bool> met) {
    return std::count_if(targets.begin(), targets.end(), [&](const Target& of) { return of.met == met; });
  };
  if (count(false) > 0) return words + "; matched light misses a target.";
  if (const auto unknown = count(std::nullopt); unknown > 0)
    words += fmt::format("; matched light measured nothing for {} of {} targets", unknown, targets.size());
  return words + ".";
}

json to_json(const Validation& validation) {
  json out = to_json(validation.summary);
  auto losses = list_json(validation.losses, [](const auto& lost) {
    json entry = fields_json(lost.second);
    entry["vehicle"] = lost.first;
    return entry;
  });
  auto failed = list_json(validation.failed, [](const AbandonedVehicle& vehicle) -> json {
    return {{"name", vehicle.name}, {"problem", vehicle.problem}};
  });
  if (validation.budget) out["budget"] = to_json(*validation.budget);
  out["targets"] = list_json(targets_of(validation.summary), fields_json<Target>);
  out["headline"] = headline(validation);
  const auto& conditions = validation.verdict.judged().conditions;
  const auto* nearest = validation.verdict.nearest_to_reality(validation.reliance.uses_picture());
  out.update({{"verdict", to_json(validation.verdict)},
              {"reliance", to_json(validation.reliance)},
              {"hosts", validation.hosts},
              {"hosts_trained_on", validation.trained_on},
              {"failed", std::move(failed)},
              {"unseen", validation.unseen},
              {"samples", validation.settings.samples},
              {"reference",
               {{"name", validation.reference.name},
                {"version", validation.reference.version},
                {"losses", std::move(losses)}}},
              {"run", validation.settings.run.string()},
              {"placement", text_of(validation.placement)},
              {"placed", to_json(validation.placement)},
              {"expect", validation.settings.expect},
              {"clusters", to_json(validation.verdict.judged().clusters)},
              {"report", (validation.settings.out / "report.html").string()}});
  if (!validation.evaluation_differences.empty())
    out["evaluation_differences"] = validation.evaluation_differences;
  if (nearest) out["verdict"]["nearest"] = nearest - conditions.data();
  return out;
}

}  // namespace mirage
