#include "detection/kitti_ap.h"

#include <algorithm>
#include <cmath>

#include "detection/detect.h"

namespace mirage {
namespace {

constexpr int kRecalls = 41;

/// What becomes of a label or a detection at one level.
enum class Part { counts, ignored, absent };

/// The kit reads a label's height as too low where it equals the limit.
Part part_of(const Label& label, Difficulty level) {
  const DifficultyLimits& limits = limits_of(level);
  if (label.type == "Van") return Part::ignored;
  if (label.type != "Car") return Part::absent;
  const bool hard = label.occluded > limits.most_occluded || label.truncated > limits.most_truncated ||
                    label.bottom - label.top <= limits.least_height;
  return hard ? Part::ignored : Part::counts;
}

Part part_of(const KittiDetection& detection, Difficulty level) {
  const double height = detection.picture ? detection.picture->bottom - detection.picture->top : 0;
  if (height < limits_of(level).least_height) return Part::ignored;
  return detection.type == "Car" ? Part::counts : Part::absent;
}

ObjectBoxes boxes_of(const KittiDetection& detection) {
  return {detection.box.value_or(Box3{}), detection.picture.value_or(PictureBox{})};
}

/// A frame at one level: its parts, and what overlaps what.
struct Judgement {
  std::vector<Part> labels, detections;
  std::vector<double> scores;
  std::vector<std::vector<double>> iou;      ///< of label and detection
  std::vector<std::vector<double>> covered;  ///< of DontCare region and detection: share of the detection
};

Judgement judgement(const KittiFrame& frame, Matching matching, Difficulty level) {
  Judgement result;
  std::vector<ObjectBoxes> boxes;
  for (const KittiDetection& detection : frame.detections) {
    result.detections.push_back(part_of(detection, level));
    result.scores.push_back(detection.score);
    boxes.push_back(boxes_of(detection));
  }
  for (const Label& label : frame.labels) {
    const ObjectBoxes box = boxes_of(label);
    if (!matching.in_picture() && !has_box(label)) continue;
    if (label.type == "DontCare") {
      result.covered.emplace_back();
      for (const ObjectBoxes& other : boxes) {
        const double area = matching.area(other);
        result.covered.back().push_back(area > 0 ? matching.intersection(other, box) / area : 0);
      }
      continue;
    }
    const Part part = part_of(label, level);
    if (part == Part::absent) continue;
    result.labels.push_back(part);
    result.iou.emplace_back();
    for (const ObjectBoxes& other : boxes) result.iou.back().push_back(matching.overlap(other, box));
  }
  return result;
}

/// The detection that a label takes to find the scores at which the curve is read: the surest one.
std::vector<double> hit_scores(const Judgement& frame, double min_iou) {
  std::vector<double> scores;
  std::vector<char> taken(frame.detections.size(), 0);
  for (std::size_t i = 0; i < frame.labels.size(); ++i) {
    std::size_t best = taken.size();
    for (std::size_t k = 0; k < taken.size(); ++k)
      if (!taken[k] && frame.detections[k] != Part::absent && frame.iou[i][k] > min_iou &&
          (best == taken.size() || frame.scores[k] > frame.scores[best]))
        best = k;
    if (best == taken.size()) continue;
    taken[best] = 1;
    if (frame.labels[i] == Part::counts && frame.detections[best] == Part::counts)
      scores.push_back(frame.scores[best]);
  }
  return scores;
}

struct Counts {
  int hits = 0, alarms = 0;
};

/// At a score or above: a label takes the detection of the largest overlap, a low one only where there is no
/// other.
Counts counts_at(const Judgement& frame, double min_iou, double score) {
  Counts counts;
  const std::size_t none = frame.detections.size();
  std::vector<char> taken(none, 0);
  const auto plays = [&](std::size_t k) {
    return !taken[k] && frame.detections[k] != Part::absent && frame.scores[k] >= score;
  };
  for (std::size_t i = 0; i < frame.labels.size(); ++i) {
    std::size_t best = none, low = none;
    for (std::size_t k = 0; k < none; ++k) {
      if (!plays(k) || !(frame.iou[i][k] > min_iou)) continue;
      if (frame.detections[k] == Part::ignored)
        low = low == none ? k : low;
      else if (best == none || frame.iou[i][k] > frame.iou[i][best])
        best = k;
    }
    const std::size_t match = best != none ? best : low;
    if (match == none) continue;
    taken[match] = 1;
    counts.hits += frame.labels[i] == Part::counts && best != none;
  }
  for (std::size_t k = 0; k < none; ++k) {
    const auto covers = [&](const std::vector<double>& shares) { return shares[k] > min_iou; };
    counts.alarms += plays(k) && frame.detections[k] == Part::counts &&
                     std::none_of(frame.covered.begin(), frame.covered.end(), covers);
  }
  return counts;
}

/// Of the hits' scores those at which recall is nearest to 0, 1/40, 2/40, …
std::vector<double> thresholds(std::vector<double> scores, int cars) {
  std::sort(scores.begin(), scores.end(), std::greater<>());
  std::vector<double> chosen;
  double recall = 0;
  for (std::size_t i = 0; i < scores.size(); ++i) {
    const double left = static_cast<double>(i + 1) / cars;
    const bool last = i + 1 == scores.size();
    const double right = last ? left : static_cast<double>(i + 2) / cars;
    if (right - recall < recall - left && !last) continue;
    chosen.push_back(scores[i]);
    recall += 1.0 / (kRecalls - 1);
  }
  return chosen;
}

std::string kitti_name(Matching matching) {
  return matching.in_picture() ? "image" : matching.name();
}

}  // namespace

KittiFrame kitti_frame(const Frame& frame, std::span<const Detection> detections, Matching matching,
                       const std::vector<std::string>& types) {
  KittiFrame result{frame.labels, kitti_detections(detections, matching, frame, types), frame.labelled};
  for (KittiDetection& detection : result.detections)
    if (!detection.picture && detection.box) detection.picture = projected(*detection.box, frame.calibration);
  return result;
}

KittiPrecision kitti_average_precision(std::span<const KittiFrame> frames, Matching matching,
                                       Difficulty level, double min_iou) {
  KittiPrecision result;
  std::vector<Judgement> judged;
  std::vector<double> scores;
  for (const KittiFrame& frame : frames) {
    if (!frame.labelled) continue;
    judged.push_back(judgement(frame, matching, level));
    const auto& labels = judged.back().labels;
    result.cars += static_cast<int>(std::count(labels.begin(), labels.end(), Part::counts));
    const std::vector<double> hits = hit_scores(judged.back(), min_iou);
    scores.insert(scores.end(), hits.begin(), hits.end());
  }
  if (result.cars == 0) return result;
  std::vector<double> precision(kRecalls, 0);
  const std::vector<double> at = thresholds(std::move(scores), result.cars);
  for (std::size_t t = 0; t < at.size() && t < precision.size(); ++t) {
    Counts sum;
    for (const Judgement& frame : judged) {
      const Counts counts = counts_at(frame, min_iou, at[t]);
      sum.hits += counts.hits, sum.alarms += counts.alarms;
    }
    if (sum.hits > 0) precision[t] = static_cast<double>(sum.hits) / (sum.hits + sum.alarms);
  }
  for (std::size_t t = precision.size(); t-- > 1;)
    precision[t - 1] = std::max(precision[t - 1], precision[t]);
  for (std::size_t t = 1; t < precision.size(); ++t)
    result.average_precision += precision[t] / (kRecalls - 1);
  return result;
}

nlohmann::json kitti_ap_json(std::span<const KittiFrame> frames, std::span<const Matching> ways) {
  constexpr std::pair<const char*, Difficulty> kLevelNames[] = {
      {"easy", Difficulty::easy}, {"moderate", Difficulty::moderate}, {"hard", Difficulty::hard}};
  nlohmann::json result = {{"iou", 0.7}};
  for (const Matching matching : ways)
    for (const auto& [name, level] : kLevelNames)
      for (const double iou : {0.7, 0.5}) {
        const KittiPrecision at = kitti_average_precision(frames, matching, level, iou);
        nlohmann::json& of = iou == 0.7 ? result : result["iou50"];
        of[kitti_name(matching)][name] =
            at.cars > 0 ? nlohmann::json(at.average_precision) : nlohmann::json();
        result["cars"][name] = at.cars;
      }
  return result;
}

}  // namespace mirage
