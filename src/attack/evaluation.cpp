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
#include "base/interrupt.h"
#include "base/progress.h"
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

constexpr const char* kStopped = "an evaluation writes nothing until it is done; run it again";

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
  for_each_with_detector(detectors, frames.size(), [&](Detector& detector, std::size_t i) {
    throw_if_interrupted(kStopped);
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
  std::vector<HostOutcome> outcomes(count);
  Progress progress("evaluate", count, settings.quiet);
  std::mutex mutex;
  std::size_t done = 0;
  for_each_with_detector(detectors, count, [&](Detector& detector, std::size_t i) {
    throw_if_interrupted(kStopped);
    const HostId& id = hosts[i / adversaries.size()];  // a frame's work lies together
    const std::size_t mesh = i % adversaries.size();
    const auto held = store.get(id.frame);
    const PreparedFrame& prepared = *held;
    const Placement placement = store.placement(id);
    const Simulated simulated = simulate(prepared, placement, adversaries[mesh], simulation);
    SensorView view = view_of(prepared.frame, simulated.image, simulated.sweep);
    CleanView as_recorded;
    if (local && passes.at(id.frame) >= kWorthKeeping) {
      as_recorded = clean_view(prepared, simulated);
      view.clean = &as_recorded;
    }
    HostOutcome& outcome = outcomes[mesh * hosts.size() + i / adversaries.size()];
    const auto object = by.matching.in_picture() ? carried_box(simulated, placement) : std::nullopt;
    outcome = judge(id, prepared.frame, clean.at(id.frame), detections(detector, view, by), by, object);
    outcome.mesh = static_cast<int>(mesh);
    outcome.from_box = placement.carrier->from_box;
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
