#include "attack/comparison.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <iterator>
#include <map>
#include <set>

#include "attack/clean_detections.h"
#include "base/error.h"
#include "base/names.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "detection/process_detector.h"
#include "frames/frame_provenance.h"
#include "frames/frame_store.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

/// Outcomes of both detectors on a host under one object.
struct Pair {
  const HostOutcome* first;
  const HostOutcome* second;
};

std::vector<Pair> pairs_of(std::span<const HostOutcome> first, std::span<const HostOutcome> second) {
  std::map<std::pair<HostId, int>, const HostOutcome*> seconds;
  for (const HostOutcome& host : second) seconds[{host.id, host.mesh}] = &host;
  std::vector<Pair> pairs;
  for (const HostOutcome& host : first) {
    const Pair pair{&host, seconds.at({host.id, host.mesh})};
    if (kVanished.finds(*pair.first, true) && kVanished.finds(*pair.second, true)) pairs.push_back(pair);
  }
  return pairs;
}

/// `first`, `second`: whether a pair counts for the one and for the other.
template <class First, class Second>
ComparedPart part_of(const std::string& by, const std::string& name, const std::vector<Pair>& pairs,
                     const First& counts_first, const Second& counts_second) {
  ComparedPart part;
  part.by = by;
  part.name = name;
  ClusteredShare first, second;
  Clusters clusters;
  std::set<HostId> vehicles;
  // Number of a vehicle's objects that count for each side, so that it weighs 1 on either side.
  std::map<HostId, int> of_first, of_second;
  for (const Pair& pair : pairs) {
    if (counts_first(pair)) ++of_first[pair.first->id];
    if (counts_second(pair)) ++of_second[pair.first->id];
  }
  for (const Pair& pair : pairs) {
    const HostId& id = pair.first->id;
    const bool in_first = counts_first(pair), in_second = counts_second(pair);
    const std::string cluster = pair.first->cluster();
    if (in_first) first.add(cluster, !kVanished.finds(*pair.first, false), 0, 1.0 / of_first.at(id));
    if (in_second) second.add(cluster, !kVanished.finds(*pair.second, false), 0, 1.0 / of_second.at(id));
    if (!in_first && !in_second) continue;
    vehicles.insert(id);
    clusters.add(id.frame, pair.first->track);
  }
  part.vehicles = static_cast<int>(vehicles.size());
  part.clusters = clusters.count();
  part.first = first.interval();
  part.second = second.interval();
  part.difference = share_difference(second, first);
  return part;
}

std::vector<NewlyMissedVehicle> newly_missed(const std::vector<Pair>& pairs,
                                             const std::vector<std::string>& objects) {
  std::vector<NewlyMissedVehicle> worse;
  for (const auto& [first, second] : pairs)
    if (kVanished.finds(*first, false) && !kVanished.finds(*second, false))
      worse.push_back({first->id, objects.at(as_size(first->mesh)), first->range, first->attacked_score,
                       second->clean_score});
  std::ranges::stable_sort(worse, {}, &NewlyMissedVehicle::range);
  return worse;
}

int found_as_recorded(std::span<const HostOutcome> hosts) {
  std::set<HostId> found;
  for (const HostOutcome& host : hosts)
    if (kVanished.finds(host, true)) found.insert(host.id);
  return static_cast<int>(found.size());
}

/// A run's simulation settings without its noise seed.
SimulationSettings without_draws(SimulationSettings simulation) {
  simulation.lidar_effects.seed = 0;
  return simulation;
}

/// FieldError if a run (in the order of --runs) is named twice, was learned at another placement than
/// `place`, or with another simulation than the first run.
void check_runs(const std::vector<Run>& runs, const PlaceChoice& place) {
  std::set<std::filesystem::path> folders;
  const auto shown_by = [](const Run& run) {
    return fields_json(without_draws(run.settings.simulation)).flatten();
  };
  const nlohmann::json of_first = runs.empty() ? nlohmann::json() : shown_by(runs.front());
  for (const Run& run : runs) {
    const std::string folder = run.folder.string();
    if (!folders.insert(std::filesystem::weakly_canonical(run.folder)).second)
      throw FieldError("runs", folder, "is named twice", "name each run once");
    if (const PlaceChoice& own = run.settings.placement; content_of(own) != content_of(place))
      throw FieldError("placement", text_of(place),
                       fmt::format("is not where {} was learned, which is {}", folder, text_of(own)),
                       "give --place " + text_of(own) + ", and runs that were learned there");
    const nlohmann::json of_run = shown_by(run);
    for (const nlohmann::json* either : {&of_run, &of_first})
      for (const auto& [key, value] : either->items()) {
        const nlohmann::json here = of_run.value(key, nlohmann::json());
        const nlohmann::json there = of_first.value(key, nlohmann::json());
        if (here == there) continue;
        throw FieldError("runs", folder,
                         fmt::format("was learned with {} = {} of the simulation, and {} with {}",
                                     key.substr(1), here.dump(), runs.front().folder.string(), there.dump()),
                         "compare runs of one simulation");
      }
  }
}

/// FieldError unless that run, the `which`-th, attacked this detector.
void check_attacked(const Run& run, const DetectorOptions& options) {
  const auto refuse = [&](const char* what, const std::string& own, const std::string& other) {
    throw FieldError("runs", run.folder.string(),
                     fmt::format("attacked {}{}, and --adaptive puts its object before {}", what, own, other),
                     "give --runs in the order of --detectors, or leave --adaptive out");
  };
  const DetectorOptions& learned = run.settings.detector;
  const std::string& word = run.refused.detector.empty() ? learned.detector : run.refused.detector;
  const bool given = word == kInProcessDetector && is_in_process(options);  // which has its place in the name
  if (word != options.detector && !given) refuse("", word, options.detector);
  const auto named = [](const std::string& defense) { return defense.empty() ? "none" : defense; };
  if (named(learned.defense) != named(options.defense))
    refuse("the defence ", named(learned.defense), named(options.defense));
  const std::string weights = is_outside(options) ? outside_content(options) : weights_hash(options);
  if (!run.settings.weights_hash.empty() && !weights.empty() && run.settings.weights_hash != weights)
    refuse("other weights of ", word, "these");
}

/// Whether the two are the same detector.
bool are_the_same(const DetectorOptions& a, const DetectorOptions& b) {
  const std::string identity = detector_identity(a);
  if (!identity.empty()) return identity == detector_identity(b);
  return a.detector == b.detector && a.weights == b.weights && a.defense == b.defense;
}

/// The intersection of both regions (Detector::region).
std::array<double, 4> common_region(const std::array<double, 4>& a, const std::array<double, 4>& b) {
  return {std::max(a[0], b[0]), std::min(a[1], b[1]), std::max(a[2], b[2]), std::min(a[3], b[3])};
}

/// Warns if a detector finds few vehicles as recorded, as an attack does.
void warn_of_few(const Comparison& result) {
  for (const std::size_t which : {0u, 1u})
    if (result.found[which] == 0 || result.found[which] < kFewFound * result.hosts)
      spdlog::warn("{} ({}) finds {} of {} vehicles as recorded: a difference over so few says little",
                   which == 0 ? "the first detector" : "the second detector", result.detectors[which],
                   result.found[which], result.hosts);
}

}  // namespace

bool Comparison::few() const {
  const int both = parts.front().vehicles;
  return both == 0 || both < kFewFound * hosts;
}

Comparison compare_outcomes(std::span<const HostOutcome> first, std::span<const HostOutcome> second,
                            const std::vector<std::string>& objects, bool adaptive) {
  Comparison result;
  result.objects = objects;
  result.hosts = static_cast<int>(first.size() / std::max<std::size_t>(1, objects.size()));
  result.found = {found_as_recorded(first), found_as_recorded(second)};
  const std::vector<Pair> pairs = pairs_of(first, second);
  const auto add = [&](const std::string& by, const std::string& name, const auto& counts) {
    ComparedPart part = part_of(by, name, pairs, counts, counts);
    if (part.vehicles > 0 || result.parts.empty()) result.parts.push_back(std::move(part));
  };
  add("all", "", [](const Pair&) { return true; });
  if (objects.size() > 1)
    for (std::size_t mesh = 0; mesh < objects.size(); ++mesh)
      add("object", objects[mesh],
          [&](const Pair& pair) { return pair.first->mesh == static_cast<int>(mesh); });
  for (const HostPart& part : host_parts(first))
    add(part.by, part.name, [&](const Pair& pair) { return part.holds(*pair.first); });
  std::vector<double> p;
  for (const ComparedPart& part : result.parts) p.push_back(p_value(part.difference, part.clusters.count));
  result.parts.front().p = p.front();
  const std::vector<double> adjusted = holm(std::span(p).subspan(1));
  for (std::size_t i = 0; i < adjusted.size(); ++i) result.parts[i + 1].p = adjusted[i];
  if (adaptive) {
    const auto own = [](int mesh) { return [mesh](const Pair& pair) { return pair.first->mesh == mesh; }; };
    result.own = part_of("own", "", pairs, own(0), own(1));
    result.own->p = p_value(result.own->difference, result.own->clusters.count);
  }
  const ComparedPart& all = result.parts.front();
  result.detectable = detectable_difference(all.difference, all.clusters.count);
  for (const double difference : {0.02, 0.05, 0.1})
    result.needed.push_back({difference, result.detectable < 1
                                             ? sample_size(all.vehicles, result.detectable, difference)
                                             : std::nullopt});  // too few to estimate
  result.bounds = {hidden_bound(first), hidden_bound(second)};
  result.worse = newly_missed(pairs, objects);
  return result;
}

Comparison compare(const ComparisonRequest& request, Provenance* provenance) {
  if (request.detectors.size() != 2)
    throw FieldError("detectors", std::to_string(request.detectors.size()), "is not two detectors",
                     "name the old one, then the new one");
  if (request.adaptive && request.runs.size() < 2)
    throw FieldError("adaptive", "", "needs two runs",
                     "give --runs the folders learned against the first and against the second detector");
  std::vector<Run> runs;
  for (const std::filesystem::path& folder : request.runs) runs.push_back(read_run(folder, request.trust));
  check_runs(runs, request.placement);
  SimulationSettings simulation;
  if (!runs.empty()) simulation = without_draws(runs.front().settings.simulation);
  simulation.camera_effects.seed = request.detectors.front().seed;
  if (simulation.lidar_effects.any()) simulation.lidar_effects.seed = request.detectors.front().seed;
  std::vector<NamedObject> objects;
  std::set<std::string> learned_on;
  for (Run& run : runs) {
    objects.push_back({run.folder.string(), run.folder / "adversary.glb", std::move(run.adversary)});
    learned_on.merge(frames_learned_on(run, request.data));
  }
  std::ranges::move(read_objects(request.meshes), std::back_inserter(objects));
  if (objects.empty()) throw FieldError("runs", "", "names no object", "give --runs or --mesh");
  std::vector<DetectorOptions> detectors;
  for (const DetectorOptions& requested : request.detectors)
    detectors.push_back(for_data(requested, request));
  if (are_the_same(detectors[0], detectors[1]))
    throw FieldError("detectors", detectors[0].detector, "is compared with itself",
                     "name two detectors, or two --weights or --defense");
  for (std::size_t which = 0; request.adaptive && which < detectors.size(); ++which)
    check_attacked(runs[which], detectors[which]);
  std::vector<TexturedMesh> meshes;
  std::vector<std::string> object_names;
  for (const NamedObject& object : objects) {
    meshes.push_back(object.mesh);
    object_names.push_back(object.name);
  }

  std::vector<std::string> frames = list_frames(request.data, request.frames);
  std::erase_if(frames, [&](const std::string& frame) { return learned_on.contains(frame); });
  if (frames.empty())
    throw InputError(request.data.string(), "frames", "holds no frame that the runs have not learned on",
                     "give another data set");
  check_labels(request.data, frames, "a comparison", request.classes, request.cameras);
  FrameStore store(request);
  std::vector<DetectorPool> pools;
  pools.reserve(detectors.size());
  for (const DetectorOptions& options : detectors)
    pools.push_back(load_detector_pool(options, static_cast<int>(frames.size())));
  SkippedHosts left_out;
  const std::vector<HostId> hosts = host_ids(
      find_all_hosts(store, frames, common_region(pools[0].front()->region(), pools[1].front()->region()),
                     simulation, request.min_view, request.settings.quiet, &left_out));
  if (hosts.empty()) refuse_left_out(store.place(), left_out);
  if (hosts.empty())
    throw InputError(request.data.string(), "labels",
                     "no car in the regions of both detectors has the adversary in view",
                     "give more frames or lower --min-view");
  if (rank() == 0) warn_of_left_out(store.place(), left_out);
  std::vector<std::vector<HostOutcome>> outcomes;
  std::vector<std::string> names;
  for (const DetectorOptions& options : detectors) {
    const DetectorPool pool = std::move(pools[outcomes.size()]);  // frees its memory before the next one runs
    EvaluationSettings settings = request.settings;
    const Capabilities can = pool.front()->capabilities();
    settings.detector_identity = detector_identity(options, can.version);
    require_shared(store.cache(), "compare", settings.detector_identity);
    settings.reports_outcomes = rank() == 0;
    if (settings.reports_outcomes) settings.kinds = vehicle_kinds(request.data, hosts);
    const CleanDetections clean = clean_detections(pool, store, hosts, settings);
    outcomes.push_back(evaluate(pool, store, hosts, clean, meshes, simulation, settings).hosts);
    names.push_back(pool.front()->name());
    if (!provenance) continue;
    Provenance detector;
    add_detector(detector, options);
    provenance->set(outcomes.size() == 1 ? "first" : "second", detector.provenance());
  }
  if (rank() > 0) return {};
  if (provenance) {
    provenance->set("simulation", fields_json(simulation));
    add_frames(*provenance, request, frames);
    add_objects(*provenance, objects);
  }
  Comparison result = compare_outcomes(outcomes[0], outcomes[1], object_names, request.adaptive);
  result.detectors = names;
  warn_of_few(result);
  return result;
}

nlohmann::json to_json(const Comparison& comparison) {
  const ComparedPart& all = comparison.parts.front();
  nlohmann::json json = {{"detectors", comparison.detectors},
                         {"hosts", comparison.hosts},
                         {"found", comparison.found},
                         {"vehicles", all.vehicles},
                         {"clusters", to_json(all.clusters)},
                         {"difference", all.difference.value},
                         {"low", all.difference.low},
                         {"high", all.difference.high},
                         {"told", to_word(classify(all.difference))},
                         {"first", to_json(all.first)},
                         {"second", to_json(all.second)},
                         {"bounds", list_json(comparison.bounds, fields_json<HiddenBound>)},
                         {"detectable", comparison.detectable},
                         {"needed", list_json(comparison.needed, fields_json<Comparison::Needed>)},
                         {"parts", list_json(comparison.parts, fields_json<ComparedPart>)},
                         {"worse", list_json(comparison.worse, fields_json<NewlyMissedVehicle>)}};
  for (const std::string& object : comparison.objects) json["objects"].push_back(escape_name(object));
  if (comparison.own) json["own"] = fields_json(*comparison.own);
  return json;
}

}  // namespace mirage
