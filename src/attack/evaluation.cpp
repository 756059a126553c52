#include "attack/evaluation.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>

#include "attack/clean_view.h"
#include "attack/evaluation_outcomes.h"
#include "attack/evaluation_strata.h"
#include "attack/false_positives.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/progress.h"
#include "base/ranks.h"
#include "detection/detect.h"
#include "frames/cached_detections.h"
#include "frames/frame_cache.h"

namespace mirage {
namespace {

/// Best IoU with the host, and that detection's score.
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

/// Whether answers go to disk: then a second run goes on, and ranks share their work.
bool kept_on_disk(FrameStore& store, const EvaluationSettings& settings) {
  return store.cache().on() && !settings.detector_identity.empty();
}

const char* how_to_go_on(FrameStore& store, const EvaluationSettings& settings) {
  return kept_on_disk(store, settings) ? "run it again: it goes on"
                                       : "nothing is kept without MIRAGE_CACHE; run it again";
}

/// content_hash of every coordinate, index and texel.
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

/// One mesh on one host: drawn, and shown to the detector.
class Attacked {
 public:
  Attacked(FrameStore& store, const EvaluationSettings& settings, const SimulationSettings& simulation)
      : store_(store), settings_(settings), simulation_(simulation) {}

  /// `local`: the clean frame is looked at, too, which saves it work.
  FoundAttacked look(Detector& detector, const HostId& id, const TexturedMesh& mesh,
                     const std::string& mesh_hash, bool local) const {
    const auto now = [&] { return drawn(detector, id, mesh, local); };
    if (!kept_on_disk(store_, settings_)) return now();
    Provenance made_of = store_.made_of(id);
    made_of.add(simulation_);
    made_of.input("mesh", mesh_hash);
    made_of.input("detector", settings_.detector_identity);
    made_of.set("score_threshold", settings_.score_threshold);
    made_of.set("local", local);  // its answers are those of whole passes up to rounding
    return store_.cache().attacked(made_of, now);
  }

 private:
  FoundAttacked drawn(Detector& detector, const HostId& id, const TexturedMesh& mesh, bool local) const {
    const auto prepared = store_.get(id.frame);
    const Placement placement = store_.placement(id);
    const Simulated simulated = simulate(*prepared, placement, mesh, simulation_);
    SensorView view = view_of(prepared->frame, simulated.image, simulated.sweep);
    CleanView as_recorded;
    if (local) {
      as_recorded = clean_view(*prepared, simulated);
      view.clean = &as_recorded;
    }
    return {detections(detector, view, settings_),
            settings_.matching.in_picture() ? carried_box(simulated, placement) : std::nullopt};
  }

  FrameStore& store_;
  const EvaluationSettings& settings_;
  const SimulationSettings& simulation_;
};

}  // namespace

std::vector<Detection> detections(Detector& detector, const SensorView& view,
                                  const EvaluationSettings& settings) {
  return suppress(detector.forward(view, settings.score_threshold, false),
                  detector.capabilities().matching());
}

HostOutcome judge(const HostId& id, const Frame& frame, std::vector<Detection> clean,
                  std::vector<Detection> attacked, const EvaluationSettings& settings,
                  const std::optional<PictureBox>& object) {
  HostOutcome outcome;
  outcome.matching = settings.matching;
  outcome.id = id;
  const Label& label = frame.labels[static_cast<std::size_t>(id.label)];
  const HostTruth recorded(frame, label, settings.matching), truth(frame, label, settings.matching, object);
  const auto kind = settings.kinds.find(host_name(id));
  outcome.kind = kind == settings.kinds.end() ? label.type : kind->second;
  outcome.track = label.track;
  outcome.occluded = label.occluded;
  outcome.truncated = label.truncated;
  outcome.range = std::hypot(label.box.bev.x, label.box.bev.y);
  std::tie(outcome.clean_iou, outcome.clean_score) = best_match(clean, recorded);
  std::tie(outcome.attacked_iou, outcome.attacked_score) = best_match(attacked, truth);
  outcome.clean_distance = nearest_centre(clean, recorded);
  outcome.attacked_distance = nearest_centre(attacked, truth);
  outcome.detected = outcome.clean_iou > settings.detected_iou;
  outcome.hidden = outcome.detected && outcome.attacked_iou <= settings.detected_iou;
  for (const Detection& proposal : attacked) {
    const bool known = std::any_of(clean.begin(), clean.end(), [&](const Detection& c) {
      return settings.matching.overlap(proposal, c) > 0;
    });
    if (known || truth.label_iou(proposal) >= settings.false_positive_iou) continue;
    const double distance = settings.matching.distance(proposal, truth.host());
    const BevBox& box = proposal.box.bev;
    const double range = settings.matching.in_picture() ? 0 : std::hypot(box.x, box.y);
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
  std::vector<const HostOutcome*> all;
  Clusters clusters;
  for (const HostOutcome& host : hosts) {
    all.push_back(&host);
    if (host.mesh != hosts.front().mesh) continue;  // the vehicles are every mesh's
    ++(host.from_box ? result.rooftops.from_box : result.rooftops.fitted);
    if (host.detected) clusters.add(host.id.frame, host.track);
    result.vehicles += host.detected;
    result.vehicles50 += host.clean_iou > 0.5;
  }
  result.at50 = success_rates(all, 0.5);
  result.hiding = hiding_rates(hosts);
  result.clusters = clusters.count();
  const SuccessRates rates = success_rates(all);
  result.fn_interval = rates.fn_asr;
  result.fp_interval = rates.fp_asr;
  result.asr_interval = rates.asr;
  result.fn_asr = rates.fn_asr.value;
  result.fp_asr = rates.fp_asr.value;
  result.asr = rates.asr.value;

  constexpr std::size_t kSteps = 21;
  for (std::size_t step = 0; step < kSteps; ++step) result.iou.push_back(static_cast<double>(step) * 0.05);
  for (const double least : result.iou) {
    ClusteredShare clean, attacked;
    for (const HostOutcome& host : hosts) {
      // IoU 0 asks for any overlap at all: a host without one counts as missed.
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
                                 const std::vector<HostId>& hosts, const EvaluationSettings& settings) {
  CleanDetections clean;  // a frame's clean detections serve all its hosts
  for (const HostId& id : hosts) clean[id.frame];
  std::vector<std::string> frames;
  for (const auto& [id, none] : clean) frames.push_back(id);
  const std::vector<std::size_t> order = order_among_ranks(frames.size());
  for_each_with_detector(detectors, frames.size(), [&](Detector& detector, std::size_t k) {
    throw_if_interrupted(how_to_go_on(store, settings));
    const std::size_t i = order[k];
    // Down to the score that an attack keeps them (CleanSights): one entry on disk serves both.
    EvaluationSettings down = settings;
    down.score_threshold = std::min(settings.score_threshold, kScoreThresholdForAp);
    clean.at(frames[i]) = scored_over(
        cached_detections(store, frames[i], settings.detector_identity, down.score_threshold,
                          [&](const Frame& frame) { return detections(detector, view_of(frame), down); }),
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
  // A clean frame costs a whole pass, and saves more than half of one each time.
  constexpr std::size_t kWorthKeeping = 3;
  std::map<std::string, std::size_t> passes;
  for (const HostId& id : hosts) passes[id.frame] += adversaries.size();
  const bool local = detectors.front()->capabilities().why_whole.empty();
  std::vector<std::string> hashes;
  for (const TexturedMesh& mesh : adversaries) hashes.push_back(hash_of(mesh));
  const Attacked attacked(store, by, simulation);
  std::vector<HostOutcome> outcomes(count);
  Progress progress("evaluate", count, settings.quiet);
  std::mutex mutex;
  std::size_t done = 0;
  const std::vector<std::size_t> order = order_among_ranks(count);
  for_each_with_detector(detectors, count, [&](Detector& detector, std::size_t k) {
    throw_if_interrupted(how_to_go_on(store, settings));
    const std::size_t i = order[k];
    const HostId& id = hosts[i / adversaries.size()];  // a frame's work lies together
    const std::size_t mesh = i % adversaries.size();
    FoundAttacked found = attacked.look(detector, id, adversaries[mesh], hashes[mesh],
                                        local && passes.at(id.frame) >= kWorthKeeping);
    const auto prepared = store.get(id.frame);
    HostOutcome& outcome = outcomes[mesh * hosts.size() + i / adversaries.size()];
    outcome = judge(id, prepared->frame, clean.at(id.frame), std::move(found.detections), by, found.object);
    outcome.mesh = static_cast<int>(mesh);
    outcome.from_box = store.placement(id).carrier->from_box;
    const std::lock_guard lock(mutex);
    progress.update(++done);
  });
  return summarize(std::move(outcomes), static_cast<int>(adversaries.size()));
}

Evaluation evaluate(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                    const TexturedMesh& adversary, const SimulationSettings& simulation,
                    const EvaluationSettings& settings) {
  const CleanDetections clean = clean_detections(detectors, store, hosts, settings);
  return evaluate(detectors, store, hosts, clean, {&adversary, 1}, simulation, settings);
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
  return {{"vehicles", evaluation.vehicles},
          {"hosts", evaluation.hosts.size() / static_cast<std::size_t>(std::max(1, evaluation.meshes))},
          {"clusters", to_json(evaluation.clusters)},
          {"rooftops", to_json(evaluation.rooftops)},
          {"fn_asr", evaluation.fn_asr},
          {"fp_asr", evaluation.fp_asr},
          {"asr", evaluation.asr},
          {"intervals",
           {{"confidence", kConfidence},
            {"fn_asr", to_json(evaluation.fn_interval)},
            {"fp_asr", to_json(evaluation.fp_interval)},
            {"asr", to_json(evaluation.asr_interval)}}},
          {"at_iou_50",
           {{"vehicles", evaluation.vehicles50},
            {"fn_asr", to_json(evaluation.at50.fn_asr)},
            {"fp_asr", to_json(evaluation.at50.fp_asr)},
            {"asr", to_json(evaluation.at50.asr)}}},
          {"hidden", to_json(evaluation.hiding)},
          {"recall_iou", recall},
          {"strata", to_json(evaluation.strata)},
          {"false_positives", false_positives_json(evaluation.hosts)},
          {"outcomes", outcomes_json(evaluation.hosts, evaluation.meshes)}};
}

}  // namespace mirage
