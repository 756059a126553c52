#include "attack/comparison.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <set>

#include "base/error.h"
#include "base/names.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "frames/frame_provenance.h"
#include "frames/frame_store.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

/// A host under one object, by both detectors.
struct Pair {
  const HostOutcome* first;
  const HostOutcome* second;
};

const MissCriterion& vanished() {
  return kMissCriteria[0];
}

std::vector<Pair> pairs_of(std::span<const HostOutcome> first, std::span<const HostOutcome> second) {
  std::map<std::pair<HostId, int>, const HostOutcome*> seconds;
  for (const HostOutcome& host : second) seconds[{host.id, host.mesh}] = &host;
  std::vector<Pair> pairs;
  for (const HostOutcome& host : first) {
    const Pair pair{&host, seconds.at({host.id, host.mesh})};
    if (vanished().finds(*pair.first, true) && vanished().finds(*pair.second, true)) pairs.push_back(pair);
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
  std::map<HostId, int> objects;  // of a vehicle, so that it weighs 1 in all
  for (const Pair& pair : pairs)
    if (counts_first(pair) || counts_second(pair)) ++objects[pair.first->id];
  for (const Pair& pair : pairs) {
    const auto seen = objects.find(pair.first->id);
    if (seen == objects.end()) continue;
    const double weight = 1.0 / seen->second;
    const std::string cluster = pair.first->cluster();
    clusters.add(pair.first->id.frame, pair.first->track);
    if (counts_first(pair)) first.add(cluster, !vanished().finds(*pair.first, false), 0, weight);
    if (counts_second(pair)) second.add(cluster, !vanished().finds(*pair.second, false), 0, weight);
  }
  part.vehicles = static_cast<int>(objects.size());
  part.clusters = clusters.count().count;
  part.first = first.interval();
  part.second = second.interval();
  part.difference = share_difference(second, first);
  return part;
}

ClusterCount clusters_of(const std::vector<Pair>& pairs) {
  Clusters clusters;
  for (const Pair& pair : pairs) clusters.add(pair.first->id.frame, pair.first->track);
  return clusters.count();
}

std::vector<WorseVehicle> worse_of(const std::vector<Pair>& pairs, const std::vector<std::string>& objects) {
  std::vector<WorseVehicle> worse;
  for (const auto& [first, second] : pairs)
    if (vanished().finds(*first, false) && !vanished().finds(*second, false))
      worse.push_back({first->id, objects.at(as_size(first->mesh)), first->range, first->attacked_score,
                       second->clean_score});
  std::stable_sort(worse.begin(), worse.end(),
                   [](const WorseVehicle& a, const WorseVehicle& b) { return a.range < b.range; });
  return worse;
}

}  // namespace

Comparison compare_outcomes(std::span<const HostOutcome> first, std::span<const HostOutcome> second,
                            const std::vector<std::string>& objects, bool adaptive) {
  Comparison result;
  result.objects = objects;
  result.hosts = static_cast<int>(first.size() / std::max<std::size_t>(1, objects.size()));
  const std::vector<Pair> pairs = pairs_of(first, second);
  result.clusters = clusters_of(pairs);
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
  for (const ComparedPart& part : result.parts) p.push_back(p_value(part.difference, part.clusters));
  result.parts.front().p = p.front();
  const std::vector<double> adjusted = holm(std::span(p).subspan(1));
  for (std::size_t i = 0; i < adjusted.size(); ++i) result.parts[i + 1].p = adjusted[i];
  if (adaptive) {
    const auto own = [](int mesh) { return [mesh](const Pair& pair) { return pair.first->mesh == mesh; }; };
    result.own = part_of("own", "", pairs, own(0), own(1));
    result.own->p = p_value(result.own->difference, result.own->clusters);
  }
  const ComparedPart& all = result.parts.front();
  result.detectable = detectable_difference(all.difference, result.clusters.count);
  for (const double difference : {0.02, 0.05, 0.1})
    result.needed.push_back({difference, sample_size(all.vehicles, result.detectable, difference)});
  result.bounds = {hidden_bound(first), hidden_bound(second)};
  result.worse = worse_of(pairs, objects);
  return result;
}

Comparison compare(const ComparisonRequest& request, Provenance* provenance) {
  if (request.detectors.size() != 2)
    throw FieldError("detectors", std::to_string(request.detectors.size()), "is not two detectors",
                     "name the old one, then the new one");
  if (request.adaptive && request.runs.size() < 2)
    throw FieldError("adaptive", "", "wants two runs",
                     "give --runs the folders learned against the first and against the second detector");
  std::vector<NamedObject> objects;
  SimulationSettings simulation;
  std::set<std::string> learned_on;
  for (const std::filesystem::path& folder : request.runs) {
    Run run = read_run(folder, request.trust);
    if (objects.empty()) simulation = run.settings.simulation;
    objects.push_back({folder.string(), folder / "adversary.glb", std::move(run.adversary)});
    learned_on.merge(frames_learned_on(run, request.data));
  }
  std::ranges::move(read_objects(request.meshes), std::back_inserter(objects));
  if (objects.empty()) throw FieldError("runs", "", "names no object", "give --runs or --mesh");
  std::vector<TexturedMesh> meshes;
  std::vector<std::string> object_names;
  for (const NamedObject& object : objects) {
    meshes.push_back(object.mesh);
    object_names.push_back(object.name);
  }

  std::vector<std::string> frames = list_frames(request.data);
  if (request.frames > 0 && frames.size() > request.frames) frames.resize(request.frames);
  std::erase_if(frames, [&](const std::string& frame) { return learned_on.contains(frame); });
  if (frames.empty())
    throw InputError(request.data.string(), "frames", "holds no frame that the runs have not learned on",
                     "give another data set");
  const LabelCensus census = count_labels(request.data, frames, request.classes, request.cameras);
  require_cars(census, "a comparison");
  warn_of_labels(census);
  FrameStore store(request);
  std::vector<HostId> hosts;
  std::vector<std::vector<HostOutcome>> outcomes;
  std::vector<std::string> names;
  for (const DetectorOptions& requested : request.detectors) {
    const DetectorOptions options = for_data(requested, request);
    const DetectorPool pool = load_detector_pool(options, static_cast<int>(frames.size()));
    if (hosts.empty()) {
      SkippedHosts left_out;
      hosts = host_ids(find_all_hosts(store, frames, pool.front()->region(), simulation, request.min_view,
                                      request.settings.quiet, &left_out));
      if (hosts.empty()) refuse_left_out(store.place(), left_out);
      warn_of_left_out(store.place(), left_out);
    }
    if (hosts.empty())
      throw InputError(request.data.string(), "labels", "no car has the adversary in view",
                       "give more frames or lower --min-view");
    EvaluationSettings settings = request.settings;
    const Capabilities can = pool.front()->capabilities();
    settings.matching = can.matching();
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
    provenance->set("simulation", to_json(simulation));
    add_frames(*provenance, request, frames);
    add_objects(*provenance, objects);
  }
  Comparison result = compare_outcomes(outcomes[0], outcomes[1], object_names, request.adaptive);
  result.detectors = names;
  return result;
}

nlohmann::json to_json(const Comparison& comparison) {
  const ComparedPart& all = comparison.parts.front();
  nlohmann::json json = {{"detectors", comparison.detectors},
                         {"hosts", comparison.hosts},
                         {"vehicles", all.vehicles},
                         {"clusters", to_json(comparison.clusters)},
                         {"difference", all.difference.value},
                         {"low", all.difference.low},
                         {"high", all.difference.high},
                         {"told", to_string(classify(all.difference))},
                         {"first", to_json(all.first)},
                         {"second", to_json(all.second)},
                         {"bounds", list_json(comparison.bounds, fields_json<HiddenBound>)},
                         {"detectable", comparison.detectable},
                         {"needed", list_json(comparison.needed, fields_json<Comparison::Needed>)},
                         {"parts", list_json(comparison.parts, fields_json<ComparedPart>)},
                         {"worse", list_json(comparison.worse, fields_json<WorseVehicle>)}};
  for (const std::string& object : comparison.objects) json["objects"].push_back(escape_name(object));
  if (comparison.own) json["own"] = fields_json(*comparison.own);
  return json;
}

}  // namespace mirage
