#include "attack/evaluation.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>

#include "base/error.h"
#include "base/interrupt.h"
#include "base/progress.h"

namespace mirage {
namespace {

/// Best IoU with the box, and that detection's score.
std::pair<double, double> best_match(const std::vector<Proposal>& detections, const BevBox& box) {
  std::pair<double, double> best{0, 0};
  for (const Proposal& d : detections)
    if (const double overlap = iou(d.box, box); overlap > best.first) best = {overlap, d.score()};
  return best;
}

}  // namespace

std::vector<Proposal> detections(Detector& detector, const SensorView& view,
                                 const EvaluationSettings& settings) {
  return suppress(detector.forward(view, settings.score_threshold, false));
}

HostOutcome judge(const HostId& id, const Frame& frame, std::vector<Proposal> clean,
                  std::vector<Proposal> attacked, const EvaluationSettings& settings) {
  HostOutcome outcome;
  outcome.id = id;
  const BevBox host = frame.labels[static_cast<std::size_t>(id.label)].box.bev;
  outcome.range = std::hypot(host.x, host.y);
  std::tie(outcome.clean_iou, outcome.clean_score) = best_match(clean, host);
  std::tie(outcome.attacked_iou, outcome.attacked_score) = best_match(attacked, host);
  outcome.detected = outcome.clean_iou > settings.detected_iou;
  outcome.hidden = outcome.detected && outcome.attacked_iou <= settings.detected_iou;
  const auto truth = ground_truth_boxes(frame);
  for (const Proposal& box : attacked) {
    const bool real = std::any_of(truth.begin(), truth.end(), [&](const BevBox& t) {
      return iou(box.box, t) >= settings.false_positive_iou;
    });
    const bool known =
        std::any_of(clean.begin(), clean.end(), [&](const Proposal& c) { return iou(box.box, c.box) > 0; });
    if (real || known) continue;
    outcome.false_positive = true;
    outcome.false_positive_distance =
        std::max(outcome.false_positive_distance, std::hypot(box.box.x - host.x, box.box.y - host.y));
  }
  outcome.clean = std::move(clean);
  outcome.attacked = std::move(attacked);
  return outcome;
}

Evaluation summarize(std::vector<HostOutcome> hosts) {
  Evaluation result;
  int hidden = 0, false_positives = 0, either = 0;
  struct FrameSums {
    ClusterSums hidden, false_positives, either;
  };
  std::map<std::string, FrameSums> frames;
  const auto count = [](ClusterSums& sums, bool yes) {
    sums.numerator += yes;
    sums.denominator += 1;
  };
  for (const HostOutcome& host : hosts) {
    ++(host.from_box ? result.rooftops.from_box : result.rooftops.fitted);
    if (!host.detected) continue;
    ++result.vehicles;
    FrameSums& frame = frames[host.id.frame];
    count(frame.hidden, host.hidden);
    count(frame.false_positives, host.false_positive);
    count(frame.either, host.hidden || host.false_positive);
    hidden += host.hidden;
    false_positives += host.false_positive;
    either += host.hidden || host.false_positive;
  }
  if (result.vehicles > 0) {
    result.fn_asr = double(hidden) / result.vehicles;
    result.fp_asr = double(false_positives) / result.vehicles;
    result.asr = double(either) / result.vehicles;
  }
  const auto interval = [&](ClusterSums FrameSums::*part) {
    std::vector<ClusterSums> clusters;
    for (const auto& [frame, sums] : frames) clusters.push_back(sums.*part);
    return bootstrap_interval(clusters);
  };
  result.fn_interval = interval(&FrameSums::hidden);
  result.fp_interval = interval(&FrameSums::false_positives);
  result.asr_interval = interval(&FrameSums::either);
  for (int step = 0; step <= 20; ++step) {
    const double threshold = step * 0.05;
    double clean = 0, attacked = 0;
    for (const HostOutcome& host : hosts) {
      // IoU 0 asks for any overlap at all: a host without one counts as missed.
      clean += host.clean_iou > 0 && host.clean_iou >= threshold;
      attacked += host.attacked_iou > 0 && host.attacked_iou >= threshold;
    }
    const double n = std::max<double>(1, static_cast<double>(hosts.size()));
    result.iou.push_back(threshold);
    result.recall_clean.push_back(clean / n);
    result.recall_attacked.push_back(attacked / n);
  }
  result.hosts = std::move(hosts);
  return result;
}

Evaluation evaluate(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                    const TexturedMesh& adversary, const SimulationSettings& simulation,
                    const EvaluationSettings& settings) {
  std::map<std::string, std::vector<Proposal>> clean;  // a frame's clean detections serve all its hosts
  for (const HostId& id : hosts) clean[id.frame];
  std::vector<std::string> frames;
  for (const auto& [id, none] : clean) frames.push_back(id);
  for_each_with_detector(detectors, frames.size(), [&](Detector& detector, std::size_t i) {
    throw_if_interrupted("an evaluation writes nothing until it is done; run it again");
    const Frame& frame = store.get(frames[i]).frame;
    clean.at(frames[i]) = detections(detector, {&frame.image, frame.sweep, &frame.calibration}, settings);
  });

  std::vector<HostOutcome> outcomes(hosts.size());
  Progress progress("evaluate", hosts.size(), settings.quiet);
  std::mutex mutex;
  std::size_t done = 0;
  for_each_with_detector(detectors, hosts.size(), [&](Detector& detector, std::size_t i) {
    throw_if_interrupted("an evaluation writes nothing until it is done; run it again");
    const HostId& id = hosts[i];
    const PreparedFrame& prepared = store.get(id.frame);
    const Rooftop& rooftop = store.rooftop(id);
    const Simulated simulated =
        simulate(prepared, label_of(prepared.frame, id), rooftop, adversary, simulation);
    const SensorView view{&simulated.image, simulated.sweep, &prepared.frame.calibration};
    outcomes[i] =
        judge(id, prepared.frame, clean.at(id.frame), detections(detector, view, settings), settings);
    outcomes[i].from_box = rooftop.from_box;
    const std::lock_guard lock(mutex);
    progress.update(++done);
  });
  return summarize(std::move(outcomes));
}

nlohmann::json to_json(const Evaluation& evaluation) {
  auto hosts = nlohmann::json::array();
  for (const HostOutcome& h : evaluation.hosts)
    hosts.push_back({{"frame", h.id.frame},
                     {"label", h.id.label},
                     {"from_box", h.from_box},
                     {"range", h.range},
                     {"clean_iou", h.clean_iou},
                     {"attacked_iou", h.attacked_iou},
                     {"clean_score", h.clean_score},
                     {"attacked_score", h.attacked_score},
                     {"detected", h.detected},
                     {"hidden", h.hidden},
                     {"false_positive", h.false_positive},
                     {"false_positive_distance", h.false_positive_distance}});
  return {{"vehicles", evaluation.vehicles},
          {"hosts", evaluation.hosts.size()},
          {"rooftops", to_json(evaluation.rooftops)},
          {"fn_asr", evaluation.fn_asr},
          {"fp_asr", evaluation.fp_asr},
          {"asr", evaluation.asr},
          {"intervals",
           {{"confidence", BootstrapSettings().confidence},
            {"fn_asr", to_json(evaluation.fn_interval)},
            {"fp_asr", to_json(evaluation.fp_interval)},
            {"asr", to_json(evaluation.asr_interval)}}},
          {"recall_iou",
           {{"iou", evaluation.iou},
            {"clean", evaluation.recall_clean},
            {"attacked", evaluation.recall_attacked}}},
          {"outcomes", hosts}};
}

}  // namespace mirage
