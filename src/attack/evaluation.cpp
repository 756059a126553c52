#include "attack/evaluation.h"

#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <set>
#include <tuple>

#include "attack/baseline.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/logging.h"
#include "base/random.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "detection/detect.h"
#include "frames/frame_cache.h"
#include "frames/frame_store.h"
#include "generator/fit.h"
#include "scene/data/read_frames.h"

namespace mirage {

std::vector<HostPart> host_parts(std::span<const HostOutcome> hosts) {
  std::vector<HostPart> list;
  const auto add_range = [&](const std::string& name, double nearest, double farthest) {
    list.push_back({"range", name, [nearest, farthest](const HostOutcome& host) {
                      return host.range >= nearest && host.range < farthest;
                    }});
  };
  add_range("0-15 m", 0, 15);
  add_range("15-30 m", 15, 30);
  add_range("30-50 m", 30, 50);
  add_range("50+ m", 50, 1e9);
  const char* const levels[] = {"fully visible", "partly occluded", "largely occluded", "occlusion unknown"};
  for (int level = 0; level < 4; ++level)
    list.push_back(
        {"occlusion", levels[level], [level](const HostOutcome& host) { return host.occluded == level; }});
  constexpr double kWhole = 0.15;
  list.push_back(
      {"truncation", "whole (≤ 0.15)", [](const HostOutcome& host) { return host.truncated <= kWhole; }});
  list.push_back(
      {"truncation", "cut off (> 0.15)", [](const HostOutcome& host) { return host.truncated > kWhole; }});
  std::set<std::string> kinds;
  for (const HostOutcome& host : hosts) kinds.insert(host.kind);
  for (const std::string& kind : kinds)
    list.push_back({"kind", kind, [kind](const HostOutcome& host) { return host.kind == kind; }});
  return list;
}

std::map<std::string, std::string> vehicle_kinds(const std::filesystem::path& data,
                                                 const std::vector<HostId>& hosts) {
  std::map<std::string, std::string> kinds;
  const auto source = generator::source_of(data);
  if (!source) return kinds;
  std::map<std::string, std::vector<const HostId*>> of_frame;
  for (const HostId& id : hosts) of_frame[id.frame].push_back(&id);
  const double mount = lidar_of(data).height;
  for (const auto& [frame, ids] : of_frame) {
    const auto index = try_parse_number<std::uint64_t>(frame);
    if (!index) continue;
    const std::vector<Label> labels = read_annotations(data, frame).labels;
    const auto vehicles = generator::true_vehicles(*source, *index, mount);
    for (const HostId* id : ids) {
      if (id->label < 0 || as_size(id->label) >= labels.size()) continue;
      const Label& label = labels[as_size(id->label)];
      const auto* vehicle = generator::find_vehicle(vehicles, label.type, label.box);
      if (vehicle != nullptr && !vehicle->kind.empty()) kinds[host_name(*id)] = vehicle->kind;
    }
  }
  return kinds;
}

bool is_cached_on_disk(FrameStore& store, const EvaluationSettings& settings) {
  return store.cache().on() && !settings.detector_identity.empty();
}

const char* how_to_go_on(FrameStore& store, const EvaluationSettings& settings) {
  return is_cached_on_disk(store, settings)
             ? "run the same command again to resume"
             : "nothing was saved without MIRAGE_CACHE; run it again from the start";
}

std::string hash_of(const TexturedMesh& textured) {
  const auto& [mesh, atlas] = textured;
  std::string bytes;
  const auto put = [&](const auto* values, std::size_t count) {
    bytes.append(reinterpret_cast<const char*>(&count), sizeof count);
    bytes.append(reinterpret_cast<const char*>(values), count * sizeof *values);
  };
  static_assert(sizeof(Vec3d) == 3 * sizeof(double) && sizeof(Face) == 3 * sizeof(int));
  put(mesh.vertices.data(), mesh.vertices.size());
  put(mesh.faces.data(), mesh.faces.size());
  put(&atlas.resolution, 1);
  put(atlas.texels.data(), atlas.texels.size());
  return content_hash(bytes);
}

namespace {

std::vector<StratumSuccess> strata(const std::vector<HostOutcome>& hosts, int meshes) {
  std::vector<StratumSuccess> result;
  for (const HostPart& part : host_parts(hosts)) {
    int members = 0;
    ClusteredShare clean, attacked;
    for (const HostOutcome& host : hosts)
      if (part.holds(host)) {
        ++members;
        clean.add(host.cluster(), kVanished.finds(host, true), 0, 1.0 / meshes);
        attacked.add(host.cluster(), kVanished.finds(host, false), 0, 1.0 / meshes);
      }
    result.push_back({part.by,
                      part.name,
                      members / meshes,
                      success_rates(hosts, {}, part.holds),
                      {clean.interval(), attacked.interval()}});
  }
  return result;
}

/// Best IoU of a detection with the host, and its score.
std::pair<double, double> best_match(const std::vector<Detection>& detections, const HostTruth& truth) {
  std::pair<double, double> best{0, 0};
  for (const Detection& d : detections)
    if (const double overlap = truth.host_iou(d); overlap > best.first) best = {overlap, d.score()};
  return best;
}

/// m to the nearest detection's centre; infinite in the picture, whose boxes have no metres.
double nearest_centre(const std::vector<Detection>& detections, const HostTruth& truth) {
  double nearest = std::numeric_limits<double>::infinity();
  if (truth.matching().in_picture()) return nearest;
  for (const Detection& d : detections)
    nearest = std::min(nearest, truth.matching().distance(d, truth.host()));
  return nearest;
}

/// Runs the detector on a host with a mesh on its roof, or reads the cached detections.
class Attacked {
 public:
  Attacked(FrameStore& store, const EvaluationSettings& settings, const SimulationSettings& simulation)
      : store_(store), settings_(settings), simulation_(simulation) {}

  /// `local`: the detector also runs on the clean frame, and then computes only changes.
  AttackedDetections detect_with_object(Detector& detector, const HostId& id, const TexturedMesh& mesh,
                                        const std::string& mesh_hash, bool local) const {
    const auto now = [&] { return drawn(detector, id, mesh, local); };
    if (!is_cached_on_disk(store_, settings_)) return now();
    Provenance provenance = store_.provenance(id);
    provenance.add(simulation_);
    if (simulation_.camera_effects.noisy()) provenance.set("camera_seed", simulation_.camera_effects.seed);
    if (settings_.expectation.any()) {
      provenance.set("expectation", fields_json(settings_.expectation));  // its light is not the simulation's
      provenance.set("expectation_seed", settings_.expectation_seed);
    }
    provenance.input("mesh", mesh_hash);
    provenance.input("detector", settings_.detector_identity);
    provenance.set("score_threshold", settings_.score_threshold);
    provenance.set("local", local);  // its detections equal those of whole passes up to rounding
    return store_.cache().attacked(provenance, now);
  }

 private:
  AttackedDetections drawn(Detector& detector, const HostId& id, const TexturedMesh& mesh, bool local) const {
    JudgedScene scene(store_, id, mesh, simulation_, settings_);
    Observation& seen = scene.observation();
    const SensorView view = seen.view(detector.capabilities(), local && !seen.changes_picture());
    return {detections(detector, view, settings_),
            settings_.matching.in_picture() ? carried_box(seen.simulated(), seen.placement()) : std::nullopt};
  }

  FrameStore& store_;
  const EvaluationSettings& settings_;
  const SimulationSettings& simulation_;
};

}  // namespace

std::uint64_t draw_of(const HostId& vehicle) {
  return fnv1a(host_name(vehicle));
}

JudgedScene::JudgedScene(FrameStore& store, const HostId& id, const TexturedMesh& mesh,
                         const SimulationSettings& simulation, const EvaluationSettings& settings)
    : recorded_(store.get(id.frame)),
      draw_(settings.expectation, settings.expectation_seed, draw_of(id)),
      host_{*recorded_, id, store.placement(id), {}, settings.expectation.any() ? &draw_ : nullptr},
      observation_(host_, mesh, simulation) {}

std::vector<Detection> detections(Detector& detector, const SensorView& view,
                                  const EvaluationSettings& settings) {
  return suppress(detector.forward(view, settings.score_threshold, false),
                  detector.capabilities().matching());
}

EvaluationLabels labelled_boxes(const Placement& placement, const Mesh& placed,
                                const Calibration& calibration, const std::optional<PictureBox>& object) {
  EvaluationLabels boxes{.victim = placement.neighbour};
  if (placement.support == Support::roof && !placement.neighbour) boxes.object = object;
  if (placement.victim == Victim::object) {
    boxes.own = own_label(placement, placed, calibration);
    boxes.plain = own_label(placement, place(plain_object(placement), placement).mesh, calibration);
  }
  return boxes;
}

Label in_a_camera(Label own, const Simulated& simulated) {
  for (std::size_t k = 1; k <= simulated.others.size() && own.right <= own.left; ++k)
    if (const PixelRect& rect = simulated.sight(k).rect; !rect.empty()) {
      own.camera = static_cast<int>(k);
      own.left = rect.u0, own.top = rect.v0, own.right = rect.u1, own.bottom = rect.v1;
    }
  return own;
}

TexturedMesh plain_object(const Placement& placement) {
  BuildableSettings as_it_is;
  as_it_is.on = false;
  return filling_shape(Baseline::cuboid, {placement.volume / 2}, as_it_is);
}

std::vector<Detection> clean_of(Detector& detector, const PreparedFrame& prepared, const Placement& placement,
                                const SimulationSettings& simulation, const EvaluationSettings& settings) {
  if (placement.victim != Victim::object) return detections(detector, view_of(prepared.frame), settings);
  const Simulated plain = simulate(prepared, placement, plain_object(placement), simulation);
  return detections(detector, view_of(prepared, plain, detector.capabilities()), settings);
}

HostOutcome judge(const HostId& id, const Frame& frame, std::vector<Detection> clean,
                  std::vector<Detection> attacked, const EvaluationSettings& settings,
                  const EvaluationLabels& boxes) {
  HostOutcome outcome;
  outcome.matching = settings.matching;
  outcome.id = id;
  outcome.victim = boxes.victim.value_or(-1);
  const HostId judged{id.frame, boxes.victim.value_or(id.label)};
  const Label& label = boxes.own ? *boxes.own : frame.labels[as_size(judged.label)];
  const HostTruth recorded = boxes.plain ? HostTruth::of_object(frame, *boxes.plain, settings.matching)
                                         : HostTruth(frame, label, settings.matching);
  const HostTruth truth =
      boxes.own     ? HostTruth::of_object(frame, label, settings.matching)
      : boxes.grown ? HostTruth::with_box(frame, label, settings.matching, boxes.grown->bev, boxes.object)
                    : HostTruth(frame, label, settings.matching, boxes.object);
  const auto kind = settings.kinds.find(host_name(judged));
  outcome.kind = boxes.own                      ? to_word(Victim::object)
                 : kind == settings.kinds.end() ? label.type
                                                : kind->second;
  outcome.track = label.track;
  outcome.occluded = label.occluded;
  outcome.truncated = label.truncated;
  outcome.range = horizontal_distance(label.box.bev);
  std::tie(outcome.clean_iou, outcome.clean_score) = best_match(clean, recorded);
  std::tie(outcome.attacked_iou, outcome.attacked_score) = best_match(attacked, truth);
  outcome.clean_distance = nearest_centre(clean, recorded);
  outcome.attacked_distance = nearest_centre(attacked, truth);
  outcome.detected = outcome.clean_iou > settings.detected_iou;
  outcome.hidden = outcome.detected && outcome.attacked_iou <= settings.detected_iou;
  for (const Detection& proposal : attacked) {
    const bool was_found = std::ranges::any_of(
        clean, [&](const Detection& c) { return settings.matching.overlap(proposal, c) > 0; });
    if (was_found || truth.label_iou(proposal) >= settings.false_positive_iou) continue;
    const double distance = settings.matching.distance(proposal, truth.host());
    const BevBox& box = proposal.box.bev;
    const double range = settings.matching.in_picture() ? 0 : horizontal_distance(box);
    outcome.new_boxes.push_back({proposal, proposal.score(), distance, range});
    outcome.false_positive = true;
    outcome.false_positive_distance = std::max(outcome.false_positive_distance, distance);
  }
  outcome.clean = std::move(clean);
  outcome.attacked = std::move(attacked);
  return outcome;
}

Evaluation summarize(std::vector<HostOutcome> hosts, int meshes) {
  Evaluation result;
  result.meshes = meshes;
  Clusters clusters;
  for (const HostOutcome& host : hosts) {
    if (host.mesh != hosts.front().mesh) continue;  // all meshes have the same vehicles
    result.rooftops.add(host.from_box);
    if (host.detected) clusters.add(host.id.frame, host.track);
  }
  result.rates = success_rates(hosts);
  result.at50 = success_rates(hosts, 0.5);
  result.hiding = miss_rates(hosts);
  result.clusters = clusters.count();

  constexpr std::size_t kSteps = 21;
  for (std::size_t step = 0; step < kSteps; ++step) result.iou.push_back(static_cast<double>(step) * 0.05);
  for (const double least : result.iou) {
    ClusteredShare clean, attacked;
    for (const HostOutcome& host : hosts) {
      // IoU 0 requires some overlap: a host without any counts as missed.
      clean.add(host.cluster(), host.clean_iou > 0 && host.clean_iou >= least, 0, 1.0 / meshes);
      attacked.add(host.cluster(), host.attacked_iou > 0 && host.attacked_iou >= least, 0, 1.0 / meshes);
    }
    result.recall_clean.push_back(clean.interval());
    result.recall_attacked.push_back(attacked.interval());
  }
  result.strata = strata(hosts, meshes);
  result.hosts = std::move(hosts);
  return result;
}

CleanDetections clean_detections(const DetectorPool& detectors, FrameStore& store,
                                 const std::vector<HostId>& hosts, const EvaluationSettings& settings,
                                 const CleanDetections& seen) {
  CleanDetections clean;  // a frame's clean detections serve all its hosts
  for (const HostId& id : hosts) clean[id.frame];
  std::vector<std::string> frames;
  for (const auto& [id, none] : clean) frames.push_back(id);
  const std::vector<std::size_t> order = order_among_ranks(frames.size());
  for_each_with_detector(detectors, frames.size(), [&](Detector& detector, std::size_t k) {
    throw_if_interrupted(how_to_go_on(store, settings));
    const std::size_t i = order[k];
    // Uses the score threshold of an attack's cache (CleanDetectionCache): one entry on disk serves both.
    EvaluationSettings down = settings;
    down.score_threshold = std::min(settings.score_threshold, kScoreThresholdForAp);
    clean.at(frames[i]) = scored_over(
        cached_detections(store, frames[i], settings.detector_identity, down.score_threshold,
                          [&](const Frame& frame) {
                            const auto cached = seen.find(frames[i]);
                            if (cached != seen.end() && down.score_threshold == kScoreThresholdForAp)
                              return cached->second;
                            return detections(detector, view_of(frame), down);
                          }),
        settings.score_threshold);
  });
  return clean;
}

Evaluation evaluate(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                    const CleanDetections& clean, std::span<const TexturedMesh> adversaries,
                    const SimulationSettings& simulation, const EvaluationSettings& settings) {
  EvaluationSettings by = settings;
  by.matching = detectors.front()->capabilities().matching();
  const std::size_t count = hosts.size() * adversaries.size();
  // A clean frame costs a whole pass, and saves over half a pass for each mesh.
  constexpr std::size_t kWorthKeeping = 3;
  std::map<std::string, std::size_t> passes;
  for (const HostId& id : hosts) passes[id.frame] += adversaries.size();
  const bool local = detectors.front()->capabilities().why_whole.empty();
  std::vector<std::string> hashes;
  for (const TexturedMesh& mesh : adversaries) hashes.push_back(hash_of(mesh));
  const bool itself = store.place().victim == Victim::object;
  TexturedMesh plain;
  if (itself) plain = plain_object({.volume = store.place().volume});
  const std::string plain_hash = hash_of(plain);
  const Attacked attacked(store, by, simulation);
  std::vector<HostOutcome> outcomes(count), grown(store.place().box == TrueBox::grown ? count : 0);
  Progress progress("evaluate", count, settings.quiet);
  const auto same_frame = [&](std::size_t i) {
    return hosts[i / adversaries.size()].frame == hosts[(i - 1) / adversaries.size()].frame;
  };
  const std::vector<std::size_t> order = order_among_ranks(count, same_frame);
  for_each_with_detector(detectors, count, [&](Detector& detector, std::size_t k) {
    throw_if_interrupted(how_to_go_on(store, settings));
    const std::size_t i = order[k];
    const HostId& id = hosts[i / adversaries.size()];  // hosts of a frame are adjacent
    const std::size_t mesh = i % adversaries.size();
    AttackedDetections found = attacked.detect_with_object(detector, id, adversaries[mesh], hashes[mesh],
                                                           local && passes.at(id.frame) >= kWorthKeeping);
    if (!by.reports_outcomes) {
      if (itself) attacked.detect_with_object(detector, id, plain, plain_hash, local);
      return progress.add();
    }
    const auto prepared = store.get(id.frame);
    const std::size_t at = mesh * hosts.size() + i / adversaries.size();
    const Placement placement = store.placement(id);
    const auto judged = [&](std::vector<Detection> detections, const EvaluationLabels& boxes) {
      std::vector<Detection> before =
          itself ? attacked.detect_with_object(detector, id, plain, plain_hash, local).detections
                 : clean.at(id.frame);
      HostOutcome one = judge(id, prepared->frame, std::move(before), std::move(detections), by, boxes);
      one.mesh = static_cast<int>(mesh);
      one.from_box = placement.carrier->from_box;
      return one;
    };
    const Mesh placed = placement.grows_box || itself ? place(adversaries[mesh], placement).mesh : Mesh();
    if (placement.grows_box) {
      const Box3 box = grown_box(placement.carrier->label.box, placed);
      grown[at] = judged(found.detections, {found.object, placement.neighbour, box});
    }
    outcomes[at] = judged(std::move(found.detections),
                          labelled_boxes(placement, placed, prepared->frame.calibration, found.object));
    progress.add();
  });
  if (!by.reports_outcomes) return {};
  Evaluation evaluation = summarize(std::move(outcomes), static_cast<int>(adversaries.size()));
  evaluation.against_grown = std::move(grown);
  return evaluation;
}

Evaluation evaluate(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                    const TexturedMesh& adversary, const SimulationSettings& simulation,
                    const EvaluationSettings& settings) {
  const CleanDetections clean = clean_detections(detectors, store, hosts, settings);
  return evaluate(detectors, store, hosts, clean, {&adversary, 1}, simulation, settings);
}

nlohmann::json grown_json(const std::vector<HostOutcome>& hosts, int meshes) {
  nlohmann::json json = fields_json(success_rates(hosts));
  json["hidden"] = fields_json(miss_rates(hosts));
  json["outcomes"] = outcomes_json(hosts, meshes);
  return json;
}

nlohmann::json to_json(const Evaluation& evaluation) {
  nlohmann::json recall = {{"iou", evaluation.iou}};
  const auto add_curve = [&](const std::string& name, const std::vector<Interval>& curve) {
    for (const Interval& at : curve) {
      recall[name].push_back(at.value);
      recall[name + "_low"].push_back(at.low);
      recall[name + "_high"].push_back(at.high);
    }
  };
  add_curve("clean", evaluation.recall_clean);
  add_curve("attacked", evaluation.recall_attacked);
  const SuccessRates& rates = evaluation.rates;
  nlohmann::json json = {{"vehicles", rates.vehicles},
                         {"hosts", evaluation.hosts.size() / as_size(std::max(1, evaluation.meshes))},
                         {"clusters", to_json(evaluation.clusters)},
                         {"rooftops", to_json(evaluation.rooftops)},
                         {"fn_asr", rates.fn_asr.value},
                         {"fp_asr", rates.fp_asr.value},
                         {"asr", rates.asr.value},
                         {"intervals",
                          {{"confidence", kConfidence},
                           {"fn_asr", to_json(rates.fn_asr)},
                           {"fp_asr", to_json(rates.fp_asr)},
                           {"asr", to_json(rates.asr)}}},
                         {"at_iou_50", fields_json(evaluation.at50)},
                         {"hidden", fields_json(evaluation.hiding)},
                         {"recall_iou", recall},
                         {"strata", list_json(evaluation.strata, fields_json<StratumSuccess>)},
                         {"false_positives", false_positives_json(evaluation.hosts)},
                         {"outcomes", outcomes_json(evaluation.hosts, evaluation.meshes)}};
  if (!evaluation.against_grown.empty())
    json["grown"] = grown_json(evaluation.against_grown, evaluation.meshes);
  return json;
}

/// Fields of every host in the file.
template <class Visitor, FieldsOf<HostOutcome> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "frame", .plain = true}, s.id.frame);
  visit({.name = "label", .range = kNotNegative}, s.id.label);
  visit({.name = "kind", .plain = true}, s.kind);
  visit({.name = "from_box"}, s.from_box);
  visit({.name = "range", .range = kNotNegative}, s.range);
  visit({.name = "occluded"}, s.occluded);
  visit({.name = "truncated"}, s.truncated);
  visit({.name = "clean_iou", .range = kShare}, s.clean_iou);
  visit({.name = "attacked_iou", .range = kShare}, s.attacked_iou);
  visit({.name = "clean_score", .range = kShare}, s.clean_score);
  visit({.name = "attacked_score", .range = kShare}, s.attacked_score);
  visit({.name = "clean_distance", .range = kNotNegative, .lacking = "inf", .endless = true},
        s.clean_distance);
  visit({.name = "attacked_distance", .range = kNotNegative, .lacking = "inf", .endless = true},
        s.attacked_distance);
  visit({.name = "detected"}, s.detected);
  visit({.name = "hidden"}, s.hidden);
  visit({.name = "false_positive"}, s.false_positive);
  visit({.name = "false_positive_distance", .range = kNotNegative}, s.false_positive_distance);
}

namespace {

constexpr std::size_t kMaxEntries = 100'000'000;
constexpr int kMaxMeshes = 1'000'000;

HostOutcome read_outcome(const JsonFields& json) {
  HostOutcome host;
  if (json.has("mesh")) host.mesh = json.count("mesh", kMaxMeshes);
  if (json.has("track")) host.track = json.count("track");
  if (json.has("victim")) host.victim = json.count("victim");
  read_fields(json, host);
  return host;
}

}  // namespace

nlohmann::json outcomes_json(const std::vector<HostOutcome>& hosts, int meshes) {
  auto list = nlohmann::json::array();
  for (const HostOutcome& host : hosts) {
    nlohmann::json entry = fields_json(host);
    if (host.matching.in_picture())
      for (const char* key : {"clean_distance", "attacked_distance"}) entry.erase(key);
    if (meshes > 1) entry["mesh"] = host.mesh;
    if (host.track >= 0) entry["track"] = host.track;
    if (host.victim >= 0) entry["victim"] = host.victim;
    list.push_back(std::move(entry));
  }
  return list;
}

std::vector<HostOutcome> read_outcomes(const JsonFields& evaluation) {
  const JsonFields positives = evaluation.object("false_positives");
  // The distribution exists even without boxes (host_outcome.h).
  const bool in_picture = positives.has("distance_from_host_px");
  const auto each = [](const JsonFields& json, const char* key, const auto& read) {
    const nlohmann::json& list = json.list(key, kMaxEntries);
    for (std::size_t i = 0; i < list.size(); ++i) read(json.inner(fmt::format("{}[{}]", key, i), list[i]));
  };
  std::map<std::tuple<std::string, int, int>, std::vector<NewBox>> boxes;
  each(positives, "list", [&](const JsonFields& json) {
    NewBox box;
    box.distance = json.number(in_picture ? "distance_from_host_px" : "distance_from_host", 0, Range::kMax);
    boxes[{json.text("frame"), json.count("label"), json.count("mesh", kMaxMeshes)}].push_back(box);
  });
  std::vector<HostOutcome> hosts;
  each(evaluation, "outcomes", [&](const JsonFields& json) {
    HostOutcome host = read_outcome(json);
    host.matching = in_picture ? kInPicture : kFromAbove;
    if (const auto own = boxes.find({host.id.frame, host.id.label, host.mesh}); own != boxes.end())
      host.new_boxes = own->second;
    hosts.push_back(std::move(host));
  });
  return hosts;
}

}  // namespace mirage
