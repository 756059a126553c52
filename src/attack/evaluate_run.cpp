#include "attack/evaluate_run.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <iterator>

#include "attack/host_outcome.h"
#include "base/disk_cache.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "detection/detector_settings.h"
#include "frames/frame_provenance.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

constexpr const char* kKind = "reliance";

std::string key_of(const std::string& identity, const FrameSource& source,
                   const std::vector<std::string>& ids) {
  Provenance provenance;
  provenance.input("detector", identity);
  provenance.input("data", frames_hash(source.data, ids, source.cameras));
  provenance.input("sensors", sensors_identity(source.sensors));
  provenance.set("classes", source.classes);
  return provenance.provenance().dump();
}

}  // namespace

Reliance cached_reliance(const DetectorPool& detectors, const std::string& identity,
                         const FrameSource& source, bool quiet, CleanDetections* seen) {
  const std::vector<std::string> ids = spread_evenly(list_frames(source.data), kAuditFrames);
  const auto measure = [&] {
    // Processes share the passes through the cache.
    const RecordedFrames frames =
        rank_count() > 1 ? recorded_frames(source, identity, "evaluate") : recorded_frames(source);
    return measure_reliance(instances(detectors), frames, ids, progress_of("use of the picture", quiet),
                            seen);
  };
  const auto disk = DiskCache::from_environment();
  if (identity.empty() || !disk->on() || !detectors.front()->capabilities().reads_image) return measure();
  const std::string key = key_of(identity, source, ids);
  if (const auto bytes = disk->read(kKind, key)) try {
      const nlohmann::json json = nlohmann::json::parse(*bytes);
      return reliance_from_json({kKind, json, "it is measured again"});
    } catch (const std::exception&) {
      disk->report_damaged(kKind, key);
    }
  const Reliance reliance = measure();
  if (rank() == 0) disk->write(kKind, key, to_json(reliance).dump());
  return reliance;
}

void require_unchanged(const Run& run, std::span<const HostId> hosts) {
  const std::set<HostId> asked(hosts.begin(), hosts.end());
  const auto require = [&](const std::vector<HostId>& split, const std::string& hash) {
    if (hash.empty() || std::ranges::none_of(split, [&](const HostId& id) { return asked.contains(id); }))
      return;
    const std::vector<std::string> frames = host_frames(split);
    const auto as_chosen = [&](Cameras cameras) {
      return frames_hash(run.settings.data, frames, cameras) == hash;
    };
    // The request may use other cameras than the run did.
    const Cameras own = run.settings.cameras;
    if (!as_chosen(own) && !as_chosen(own == Cameras::all ? Cameras::first : Cameras::all))
      throw InputError(run.settings.data.string(), "frames",
                       "have changed since " + run.folder.string() + " chose its vehicles in them",
                       "restore them, or attack again");
  };
  require(run.train, run.train_frames);
  require(run.test, run.test_frames);
}

std::vector<HostId> hosts_learned_on(const Run& run, const FrameSource& source,
                                     const std::vector<HostId>& hosts, const std::set<std::string>& frames) {
  std::set<int> tracks;
  if (!is_other_data(run, source.data))
    for (const HostId& id : run.train) tracks.insert(track_of(source, id));
  tracks.erase(-1);
  std::vector<HostId> learned;
  std::ranges::copy_if(hosts, std::back_inserter(learned), [&](const HostId& id) {
    return frames.contains(id.frame) || (!tracks.empty() && tracks.contains(track_of(source, id)));
  });
  return learned;
}

namespace {

std::vector<HostId> hosts_of_split(const Run& run, const std::string& which) {
  if (!which.empty() && which != "test" && which != "train" && which != "all")
    throw unknown_word("hosts", which, {"test", "train", "all"});
  std::vector<HostId> hosts;
  if (which == "train" || which == "all") hosts = run.train;
  if (which != "train") hosts.insert(hosts.end(), run.test.begin(), run.test.end());
  require_unchanged(run, hosts);
  return hosts;
}

/// FieldError for options that contradict --hosts-of.
void check_hosts_of(const EvaluationRequest& request, const Run& target_run) {
  const auto data = request.overrides.find("data");
  if (data != request.overrides.end() && is_other_data(target_run, data->second))
    throw FieldError("data", data->second,
                     "is not the data set of --hosts-of's run (" + target_run.settings.data.string() + ")",
                     "leave --data out");
  if (!request.hosts.empty() && request.hosts != "test")
    throw FieldError("hosts", request.hosts, "contradicts --hosts-of, which takes the run's test hosts",
                     "leave --hosts out");
}

/// FieldError for contradictory options, before anything is read.
void check_request(const EvaluationRequest& request) {
  if (request.random_meshes < 0)
    throw FieldError("random_meshes", std::to_string(request.random_meshes), "out of range",
                     "use at least 0");
  if (request.run.empty() == request.meshes.empty())
    throw FieldError("run", request.run.string(),
                     request.run.empty() ? "is missing, and so is --mesh" : "is given, and --mesh, too",
                     "give a finished mirage attack (--run) or objects (--mesh)");
  if (request.meshes.empty()) return;
  if (!request.overrides.contains("data") && request.hosts_of.empty())
    throw FieldError("data", "", "is missing: --mesh alone names no vehicles",
                     "give --data, or --hosts-of a finished mirage attack");
  if (!request.hosts.empty() && request.hosts != "all" && request.hosts_of.empty())
    throw FieldError("hosts", request.hosts, "selects among the hosts of a run, and none is given",
                     "leave --hosts out, or give --hosts-of");
  if (!request.baseline.empty() && request.baseline != "none" &&
      (request.meshes.size() > 1 || request.meshes.front() == kZoo))
    throw FieldError("baseline", request.baseline, "are controls of one object, and there are several",
                     "give one --mesh, or leave --baseline out");
  if (request.baseline.find("start") != std::string::npos || request.baseline == "all")
    throw FieldError("baseline", request.baseline,
                     "needs a run: start is the mesh that its attack starts from",
                     "use sized, ellipsoid or cuboid");
}

/// Frames of another data set than the run's; only --hosts all includes those in `learned`.
std::vector<std::string> unseen_frames(const EvaluationRequest& request, const std::filesystem::path& data,
                                       const std::set<std::string>& learned) {
  if (!request.hosts.empty() && request.hosts != "all" && request.hosts != "test")
    throw FieldError("hosts", request.hosts, "are of the run's own data set, and --data is another one",
                     "leave --hosts out, or give all");
  std::vector<std::string> frames = list_frames(data);
  if (request.hosts == "all") return frames;
  const std::size_t seen = std::erase_if(frames, [&](const std::string& id) { return learned.contains(id); });
  if (frames.empty())
    throw InputError(data.string(), "", "holds only frames that the run was learned on",
                     "give other frames, or --hosts all");
  if (seen > 0 && rank() == 0)
    spdlog::warn("{} frames are left out: the run was learned on them (--hosts all judges on them, too)",
                 seen);
  return frames;
}

/// The evaluation of one of several meshes (evaluate() orders outcomes by mesh).
Evaluation of_mesh(const Evaluation& all, std::size_t mesh) {
  const std::size_t count = all.hosts.size() / as_size(all.meshes);
  const auto begin = all.hosts.begin() + static_cast<std::ptrdiff_t>(mesh * count);
  std::vector<HostOutcome> hosts(begin, begin + static_cast<std::ptrdiff_t>(count));
  for (HostOutcome& host : hosts) host.mesh = 0;
  Evaluation one = summarize(std::move(hosts));
  for (std::size_t i = mesh * count; i < (mesh + 1) * count && i < all.against_grown.size(); ++i) {
    one.against_grown.push_back(all.against_grown[i]);
    one.against_grown.back().mesh = 0;
  }
  return one;
}

Vec3d extents(const TexturedMesh& mesh) {
  return bounds(mesh.mesh).sizes();
}

/// The entry of one mesh in "arms".
nlohmann::json arm_json(const RunEvaluation& all, const std::string& name, const Evaluation& of,
                        const Vec3d& size, const GainOverControl* net) {
  auto seeds = nlohmann::json::array();
  for (int i = 0; i < of.meshes; ++i) seeds.push_back(all.run.settings.seed + static_cast<std::uint64_t>(i));
  nlohmann::json entry = {{"name", name},
                          {"detector", all.detector.detector},
                          {"rig", all.detector.rig},
                          {"target", to_word(all.run.settings.target)},
                          {"seeds", seeds},
                          {"meshes", of.meshes},
                          {"extents_m", {size.x(), size.y(), size.z()}},
                          {"hidden", fields_json(of.hiding)},
                          {"bound", fields_json(hidden_bound(of.hosts))}};
  entry.update(fields_json(of.rates));
  if (net != nullptr) entry["net"] = fields_json(*net);
  if (!of.against_grown.empty()) {
    entry["grown"] = grown_json(of.against_grown, of.meshes);
    entry["grown"].erase("outcomes");
  }
  return entry;
}

}  // namespace

const BaselineEvaluation* RunEvaluation::baseline(Baseline kind) const {
  for (const BaselineEvaluation& baseline : baselines)
    if (baseline.kind == kind) return &baseline;
  return nullptr;
}

RunEvaluation evaluate_run(const EvaluationRequest& request) {
  check_request(request);
  const bool of_run = request.meshes.empty();
  const std::vector<Baseline> kinds = parse_baselines(
      request.baseline.empty() ? std::string(of_run ? "start,sized" : "none") : request.baseline);
  RunEvaluation result;
  result.objects = read_objects(request.meshes);
  result.run = of_run ? read_run(request.run, request.trust) : run_of_objects(result.objects);
  result.hosts_of = request.hosts_of;
  result.target_run = request.hosts_of.empty() ? result.run : read_run(request.hosts_of, request.trust);
  Run& target_run = result.target_run;
  if (!request.hosts_of.empty()) check_hosts_of(request, target_run);
  const auto data = request.overrides.find("data");
  const bool whole_data = data != request.overrides.end() && is_other_data(target_run, data->second);
  const std::string target_classes = target_run.settings.classes;
  override_settings(target_run, request.overrides, request.detector.seed, true);
  result.detector = request.detector;
  use_detector_of(target_run, result.detector);
  result.detector = for_data(result.detector, target_run.settings);
  result.detector.precision = usable_precision(result.detector.precision);
  result.store = std::make_unique<FrameStore>(target_run.settings);

  const std::set<std::string> learned = frames_learned_on(result.run, target_run.settings.data);
  const auto check_labels_of = [&source = target_run.settings](const std::vector<std::string>& frames) {
    if (!frames.empty()) check_labels(source.data, frames, "an evaluation", source.classes, source.cameras);
  };
  if (whole_data) {  // judges all its usable vehicles
    const std::vector<std::string> frames = unseen_frames(request, target_run.settings.data, learned);
    check_labels_of(frames);
    result.detectors = load_detector_pool(result.detector, static_cast<int>(frames.size()));
    result.hosts = host_ids(find_all_hosts(*result.store, frames, result.detectors.front()->region(),
                                           target_run.settings.simulation, target_run.settings.min_view, true,
                                           &result.left_out));
  } else {
    if (request.overrides.contains("min_view"))
      throw FieldError("min_view", request.overrides.at("min_view"), "is for another --data than the run's",
                       "leave it out: the run has chosen its vehicles");
    if (target_run.settings.classes != target_classes)
      throw FieldError("classes", target_run.settings.classes,
                       "is for another --data than the run's, whose vehicles are " + target_classes,
                       "leave it out: the run has chosen its vehicles");
    result.hosts = hosts_of_split(target_run, request.hosts);
    check_labels_of(host_frames(result.hosts));
    if (request.overrides.contains("placement")) result.left_out = leave_out(*result.store, result.hosts);
  }
  if (result.hosts.empty()) refuse_left_out(target_run.settings.placement, result.left_out);
  if (result.hosts.empty() && whole_data)
    throw InputError(target_run.settings.data.string(), "labels", "no vehicle has the object in view",
                     "give more frames or lower --min-view");
  if (result.hosts.empty())
    throw InputError((target_run.folder / "run.json").string(),
                     request.hosts.empty() ? "test" : request.hosts, "has no host vehicles",
                     "use --hosts all or a larger data set");
  if (rank() == 0) warn_of_left_out(target_run.settings.placement, result.left_out);
  result.trained_on =
      static_cast<int>(hosts_learned_on(result.run, target_run.settings, result.hosts, learned).size());
  if (result.trained_on > 0 && request.hosts != "train" && request.hosts != "all" && rank() == 0)
    spdlog::warn("the adversary was learned on {} of the {} vehicles, some of them in other frames",
                 result.trained_on, result.hosts.size());

  result.settings = request.settings;
  result.settings.reports_outcomes = rank() == 0;
  if (result.settings.reports_outcomes)
    result.settings.kinds = vehicle_kinds(target_run.settings.data, result.hosts);
  if (result.detectors.empty())
    result.detectors = load_detector_pool(result.detector, static_cast<int>(result.hosts.size()));
  const Capabilities can = result.detectors.front()->capabilities();
  result.settings.matching = can.matching();
  result.settings.detector_identity = detector_identity(result.detector, can.version);
  if (!can.why_whole.empty())
    spdlog::info("each detector pass covers the whole frame, which is slower: {}", can.why_whole);
  require_shared(result.store->cache(), "evaluate", result.settings.detector_identity);
  CleanDetections seen;
  result.reliance = cached_reliance(result.detectors, result.settings.detector_identity, target_run.settings,
                                    result.settings.quiet, &seen);
  CleanDetections clean;
  if (target_run.settings.placement.victim != Victim::object)  // there the clean frames show a plain object
    clean = clean_detections(result.detectors, *result.store, result.hosts, result.settings, seen);
  const auto judged = [&](std::span<const TexturedMesh> meshes) {
    return evaluate(result.detectors, *result.store, result.hosts, clean, meshes,
                    target_run.settings.simulation, result.settings);
  };
  std::vector<TexturedMesh> meshes;
  for (const NamedObject& object : result.objects) meshes.push_back(object.mesh);
  if (of_run) meshes.push_back(result.run.adversary);
  const bool reports_outcomes = result.settings.reports_outcomes;
  for (std::size_t i = 0; i < meshes.size() && reports_outcomes; ++i)
    warn_of_volume(target_run.settings.placement, extents(meshes[i]),
                   of_run ? "the run's mesh" : escape_name(result.objects[i].name));
  result.learned = judged(meshes);
  for (std::size_t mesh = 0; mesh < result.objects.size() && reports_outcomes; ++mesh)
    result.each.push_back({result.objects[mesh].name, of_mesh(result.learned, mesh), extents(meshes[mesh])});
  if (reports_outcomes && result.learned.rates.vehicles == 0)
    spdlog::warn("{} finds none of {} vehicles as recorded, so no success rate can be given",
                 result.detectors.front()->name(), result.hosts.size());
  if (request.random_meshes == 0) return result;
  for (const Baseline kind : kinds) {
    const auto controls = baseline_meshes(result.run, kind, request.random_meshes);
    Evaluation of = judged(controls);
    if (!reports_outcomes) continue;
    result.baselines.push_back({kind, std::move(of), {}, extents(controls.front())});
    BaselineEvaluation& entry = result.baselines.back();
    entry.net = gain_over_control(result.learned.hosts, entry.evaluation.hosts);
  }
  return result;
}

nlohmann::json to_json(const RunEvaluation& evaluation) {
  nlohmann::json result = to_json(evaluation.learned);
  result["bound"] = fields_json(hidden_bound(evaluation.learned.hosts));
  for (const BaselineEvaluation& entry : evaluation.baselines) {
    const std::string key = entry.kind == Baseline::start ? "random" : to_word(entry.kind);
    result[key] = to_json(entry.evaluation);
    result[key]["meshes"] = entry.evaluation.meshes;
  }
  auto& arms = result["arms"];
  const BaselineEvaluation* sized = evaluation.baseline(Baseline::sized);
  for (const ObjectEvaluation& entry : evaluation.each)
    arms.push_back(arm_json(evaluation, escape_name(entry.name), entry.evaluation, entry.extents,
                            sized ? &sized->net : nullptr));
  if (evaluation.each.empty())
    arms.push_back(arm_json(evaluation, "learned", evaluation.learned, extents(evaluation.run.adversary),
                            sized ? &sized->net : nullptr));
  const std::vector<HostOutcome>& grown = evaluation.learned.against_grown;
  for (const BaselineEvaluation& entry : evaluation.baselines) {
    arms.push_back(arm_json(evaluation, to_word(entry.kind), entry.evaluation, entry.extents, &entry.net));
    if (!grown.empty())
      arms.back()["grown"]["net"] = fields_json(gain_over_control(grown, entry.evaluation.against_grown));
  }
  if (sized) result["net"] = fields_json(sized->net);
  for (const NamedObject& object : evaluation.objects) result["meshes"].push_back(escape_name(object.name));
  if (evaluation.objects.empty()) result["run"] = evaluation.run.folder.string();
  if (!evaluation.hosts_of.empty()) result["hosts_of"] = evaluation.hosts_of.string();
  result["hosts_trained_on"] = evaluation.trained_on;
  result["data"] = evaluation.target_run.settings.data.string();
  result["detector"] = evaluation.detector.detector;
  result["weights"] = evaluation.detector.weights.string();
  result["defense"] = evaluation.detector.defense;
  result["precision"] = evaluation.detector.precision;
  result["locality"] = evaluation.detector.locality;
  result["reliance"] = to_json(evaluation.reliance);
  result["simulation"] = fields_json(evaluation.target_run.settings.simulation);
  result["sun"] = evaluation.target_run.settings.sun;
  result["depth"] = escape_name(evaluation.target_run.settings.depth);
  result["rooftop"] = escape_name(evaluation.target_run.settings.rooftop);
  result["placement"] = text_of(evaluation.target_run.settings.placement);
  result["placed"] = to_json(evaluation.target_run.settings.placement);
  result["left_out"] = to_json(evaluation.left_out);
  result["plane"] = evaluation.settings.matching.name();
  result["score_threshold"] = evaluation.settings.score_threshold;
  result["detected_iou"] = evaluation.settings.detected_iou;
  return result;
}

}  // namespace mirage
