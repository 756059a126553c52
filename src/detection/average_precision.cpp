#include "detection/average_precision.h"

#include <algorithm>

namespace mirage {
namespace {

constexpr double kMostTruncated = 0.5, kLeastHeight = 25;
constexpr int kMostOccluded = 2, kLeastPoints = 3;
constexpr double kGrown = 0.1;  // m: returns scatter around a surface

bool counts(const Label& label, std::span<const LidarPoint> points, const std::array<double, 4>& region) {
  if (label.type != "Car" || label.truncated > kMostTruncated || label.occluded > kMostOccluded ||
      label.bottom - label.top < kLeastHeight)
    return false;
  const BevBox& box = label.box.bev;
  if (!(box.x >= region[0] && box.x <= region[1] && box.y >= region[2] && box.y <= region[3])) return false;
  const Transform box_from_velo = velo_from_box(label.box).inverse();
  int inside = 0;
  for (const LidarPoint& point : points) {
    const Vec3d p = box_from_velo * point.position().cast<double>();
    inside += std::abs(p.x()) <= box.length / 2 + kGrown && std::abs(p.y()) <= box.width / 2 + kGrown &&
              p.z() >= -kGrown && p.z() <= label.box.height + kGrown;
  }
  return inside >= kLeastPoints;
}

struct Detection {
  double logit;
  std::size_t frame, place;
};

}  // namespace

GroundTruth ground_truth(const Frame& frame, std::span<const LidarPoint> points,
                         const std::array<double, 4>& region) {
  GroundTruth truth;
  for (std::size_t i = 0; i < frame.labels.size(); ++i) {
    const Label& label = frame.labels[i];
    if (label.type != "Car" && label.type != "Van") continue;
    if (counts(label, points, region)) {
      truth.boxes.push_back(label.box.bev);
      truth.labels.push_back(i);
    } else {
      truth.ignore.push_back(label.box.bev);
    }
  }
  return truth;
}

PrecisionRecall average_precision(std::span<const ScoredFrame> frames, double min_iou) {
  PrecisionRecall result;
  std::vector<Detection> detections;
  std::vector<std::vector<char>> claimed;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    for (std::size_t k = 0; k < frames[f].detections.size(); ++k)
      detections.push_back({frames[f].detections[k].logit, f, k});
    claimed.emplace_back(frames[f].truth.boxes.size(), 0);
    result.boxes += static_cast<int>(frames[f].truth.boxes.size());
  }
  if (result.boxes == 0) return result;
  std::stable_sort(detections.begin(), detections.end(),
                   [](const Detection& a, const Detection& b) { return a.logit > b.logit; });

  std::vector<double> precision, recall;
  int hits = 0, alarms = 0;
  for (const Detection& detection : detections) {
    const ScoredFrame& frame = frames[detection.frame];
    const BevBox& box = frame.detections[detection.place].box;
    double best = min_iou;
    std::size_t found = frame.truth.boxes.size();
    for (std::size_t i = 0; i < frame.truth.boxes.size(); ++i) {
      const double overlap = claimed[detection.frame][i] ? 0 : iou(box, frame.truth.boxes[i]);
      if (overlap >= best && (overlap > best || found == frame.truth.boxes.size())) {
        best = overlap;
        found = i;
      }
    }
    if (found < frame.truth.boxes.size()) {
      claimed[detection.frame][found] = 1;
      ++hits;
    } else {
      const auto covers = [&](const BevBox& other) {
        return iou(box, other) >= min_iou || intersection_area(box, other) >= box.length * box.width / 2;
      };
      if (std::any_of(frame.truth.ignore.begin(), frame.truth.ignore.end(), covers)) continue;
      ++alarms;
    }
    precision.push_back(static_cast<double>(hits) / (hits + alarms));
    recall.push_back(static_cast<double>(hits) / result.boxes);
  }
  result.recall = static_cast<double>(hits) / result.boxes;
  for (std::size_t i = precision.size(); i-- > 1;)
    precision[i - 1] = std::max(precision[i - 1], precision[i]);
  std::size_t at = 0;
  for (int step = 1; step <= 40; ++step) {
    while (at < recall.size() && recall[at] < step / 40.0 - 1e-9) ++at;
    if (at < recall.size()) result.average_precision += precision[at] / 40;
  }
  return result;
}

}  // namespace mirage
