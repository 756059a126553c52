#include "detection/average_precision.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <numeric>
#include <utility>

#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "scene/data/data_set.h"

namespace mirage {
namespace {

constexpr DifficultyLimits kLevels[] = {{40, 0, 0.15}, {25, 1, 0.3}, {25, 2, 0.5}};
/// Distance of a label without a box in space: beyond each range of standard_strata(), and within "any".
constexpr double kUnknownDistance = 1e8;  // m
/// Beyond any sensor's reach and any picture's width: an ignored box of this size covers all detections.
constexpr double kEverywhere = 1e5;  // m or pixels

bool meets(const Label& label, const DifficultyLimits& limits) {
  return label.bottom - label.top >= limits.least_height && label.occluded <= limits.most_occluded &&
         label.truncated <= limits.most_truncated;
}

struct Ranked {
  double logit;
  std::size_t frame, place;
};

/// A detection that counts: a hit or a false alarm.
struct Judged {
  std::size_t frame;
  bool hit;
  std::size_t box = 0;  ///< of a hit
};

double height_of(const PictureBox& box) {
  return box.bottom - box.top;
}

/// The detections that count, by falling score.
std::vector<Judged> judged(std::span<const ScoredFrame> frames, double min_iou) {
  std::vector<Ranked> detections;
  std::vector<std::vector<char>> claimed;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    for (std::size_t k = 0; k < frames[f].detections.size(); ++k)
      detections.push_back({frames[f].detections[k].logit, f, k});
    claimed.emplace_back(frames[f].truth.boxes.size(), 0);
  }
  std::stable_sort(detections.begin(), detections.end(),
                   [](const Ranked& a, const Ranked& b) { return a.logit > b.logit; });
  std::vector<Judged> result;
  for (const Ranked& detection : detections) {
    const ScoredFrame& frame = frames[detection.frame];
    const Matching& matching = frame.matching;
    const Detection& box = frame.detections[detection.place];
    double best = min_iou;
    std::size_t match = frame.truth.boxes.size();
    for (std::size_t i = 0; i < frame.truth.boxes.size(); ++i) {
      const double overlap = claimed[detection.frame][i] ? 0 : matching.overlap(box, frame.truth.boxes[i]);
      if (overlap >= best && (overlap > best || match == frame.truth.boxes.size())) {
        best = overlap;
        match = i;
      }
    }
    if (match < frame.truth.boxes.size()) {
      claimed[detection.frame][match] = 1;
      result.push_back({detection.frame, true, match});
      continue;
    }
    const auto covers = [&](const ObjectBoxes& other) {
      return matching.overlap(box, other) >= min_iou ||
             matching.intersection(box, other) >= matching.area(box) / 2;
    };
    const bool low =
        matching.in_picture() && height_of(box.picture) < limits_of(Difficulty::hard).least_height;
    if (!low && std::none_of(frame.truth.ignore.begin(), frame.truth.ignore.end(), covers))
      result.push_back({detection.frame, false});
  }
  return result;
}

/// A detection's distance (m from the sensor) and height (pixels). Infinite if the focal length is needed and
/// unknown.
struct ApparentSize {
  double distance, height;
};
ApparentSize apparent_size(const Detection& proposal, const ScoredFrame& frame) {
  const auto by_car = [&](double other) {  // distance to height, or height to distance
    return frame.focal_length > 0 ? frame.focal_length * kNominalHeight / std::max(other, 1.0)
                                  : std::numeric_limits<double>::infinity();
  };
  if (frame.matching.in_picture()) return {by_car(height_of(proposal.picture)), height_of(proposal.picture)};
  const BevBox& box = proposal.box.bev;
  return {horizontal_distance(box), by_car(box.x)};
}

/// Makes precision the best at that recall or above, and takes the mean over 40 recalls.
double area_under(std::vector<std::array<double, 2>>& curve) {
  for (std::size_t i = curve.size(); i-- > 1;) curve[i - 1][1] = std::max(curve[i - 1][1], curve[i][1]);
  double sum = 0;
  std::size_t at = 0;
  for (int step = 1; step <= 40; ++step) {
    while (at < curve.size() && curve[at][0] < step / 40.0 - 1e-9) ++at;
    if (at < curve.size()) sum += curve[at][1] / 40;
  }
  return sum;
}

/// The exact area under that curve. Over 40 recalls AP moves in steps, which a jackknife would count as
/// spread.
double whole_area_under(std::vector<std::array<double, 2>>& curve) {
  for (std::size_t i = curve.size(); i-- > 1;) curve[i - 1][1] = std::max(curve[i - 1][1], curve[i][1]);
  double sum = 0, reached = 0;
  for (const auto& [recall, precision] : curve) {
    sum += (recall - reached) * precision;
    reached = recall;
  }
  return sum;
}

/// The clusters that are left out in turn: the frames first, in their order, then the vehicles as they
/// appear.
class FramesAndVehicles {
 public:
  explicit FramesAndVehicles(std::span<const ScoredFrame> frames) : boxes_(frames.size(), 0) {
    for (std::size_t f = 0; f < frames.size(); ++f) {
      of_box_.emplace_back();
      for (const TruthBox& box : frames[f].truth.boxes) {
        std::size_t cluster = f;
        if (box.track >= 0) {
          cluster = vehicles_.try_emplace(box.track, boxes_.size()).first->second;
          if (cluster == boxes_.size()) boxes_.push_back(0);
        }
        ++boxes_[cluster];
        of_box_[f].push_back(cluster);
      }
    }
  }
  std::size_t size() const { return boxes_.size(); }
  std::size_t of(const Judged& detection) const {
    return detection.hit ? of_box_[detection.frame][detection.box] : detection.frame;
  }
  /// Number of boxes without the cluster.
  int boxes_without(std::size_t cluster) const {
    return std::reduce(boxes_.begin(), boxes_.end()) - (cluster < boxes_.size() ? boxes_[cluster] : 0);
  }
  Trials trials() const { return trials_of(std::vector<double>(boxes_.begin(), boxes_.end())); }

 private:
  std::vector<int> boxes_;  ///< of each cluster
  std::vector<std::vector<std::size_t>> of_box_;
  std::map<int, std::size_t> vehicles_;
};

/// The area under the curve without one of the clusters; NaN without a box.
class PrecisionWithout {
 public:
  PrecisionWithout(std::span<const ScoredFrame> frames, double min_iou, const FramesAndVehicles& clusters)
      : clusters_(clusters) {
    for (const Judged& detection : judged(frames, min_iou))
      detections_.push_back({clusters.of(detection), detection.hit});
  }
  double operator()(std::size_t left_out) {
    const int boxes = clusters_.boxes_without(left_out);
    if (boxes == 0) return std::nan("");
    int hits = 0, alarms = 0;
    curve_.clear();
    for (const auto& [cluster, hit] : detections_) {
      if (cluster == left_out) continue;
      ++(hit ? hits : alarms);
      curve_.push_back({static_cast<double>(hits) / boxes, static_cast<double>(hits) / (hits + alarms)});
    }
    return whole_area_under(curve_);
  }

 private:
  const FramesAndVehicles& clusters_;
  std::vector<std::pair<std::size_t, bool>> detections_;
  std::vector<std::array<double, 2>> curve_;
};

/// `value` with the spread of a figure when each cluster is left out in turn: `without` gets its number, past
/// the last to leave out none. Degrees of freedom: the clusters with boxes, less one.
template <class Without>
Estimate jackknifed(double value, const FramesAndVehicles& clusters, const Without& without) {
  std::vector<double> figures;
  for (std::size_t i = 0; i < clusters.size(); ++i) figures.push_back(without(i));
  Estimate estimate = jackknife(without(clusters.size()), figures);
  estimate.value = value;
  estimate.freedom = clusters.trials().clusters - 1;
  return estimate;
}

/// The i-th label, which has these boxes.
TruthBox truth_box(const Label& label, const ObjectBoxes& boxes, std::size_t i) {
  TruthBox truth = boxes;
  truth.label = i;
  truth.difficulty = easiest_level(label);
  truth.distance = has_box(label) ? horizontal_distance(label.box.bev) : kUnknownDistance;
  truth.track = label.track;
  return truth;
}

bool has_boxes(std::span<const ScoredFrame> frames) {
  return std::any_of(frames.begin(), frames.end(),
                     [](const ScoredFrame& frame) { return !frame.truth.boxes.empty(); });
}

}  // namespace

const DifficultyLimits& limits_of(Difficulty difficulty) {
  return kLevels[static_cast<int>(difficulty)];
}

bool counts_by_label(const Label& label, const std::array<double, 4>& region) {
  const BevBox& box = label.box.bev;
  return is_sought(label) && has_box(label) && meets(label, limits_of(Difficulty::hard)) &&
         box.x >= region[0] && box.x <= region[1] && box.y >= region[2] && box.y <= region[3];
}

Difficulty easiest_level(const Label& label) {
  for (const Difficulty difficulty : {Difficulty::easy, Difficulty::moderate})
    if (meets(label, limits_of(difficulty))) return difficulty;
  return Difficulty::hard;
}

std::vector<int> places_of_cameras(const Frame& frame, const Capabilities& can) {
  constexpr int kBeside = 2;  // in sensors() the first camera and the first LiDAR come before the others
  std::vector<int> places = {0};
  int place = kBeside;
  for (const SideCamera& camera : frame.others) places.push_back(can.names(camera.name) ? place++ : -1);
  return places;
}

GroundTruth ground_truth(const Frame& frame, const std::array<double, 4>& region, const Capabilities& can) {
  GroundTruth all{{}, picture_truth(frame.labels, places_of_cameras(frame, can))};
  TruthBoxes& truth = all.space;
  if (!frame.labelled) {
    const ObjectBoxes everywhere({{0, 0, 2 * kEverywhere, 2 * kEverywhere, 0}, -kEverywhere, 2 * kEverywhere},
                                 {-kEverywhere, -kEverywhere, kEverywhere, kEverywhere});
    truth.ignore.push_back(everywhere);
    for (const int place : places_of_cameras(frame, can)) {
      all.picture.ignore.push_back(everywhere);
      all.picture.ignore.back().camera = place;
    }
  }
  for (std::size_t i = 0; i < frame.labels.size(); ++i) {
    const Label& label = frame.labels[i];
    if (!has_box(label)) continue;
    if (label.type == "Misc") truth.look_alikes.push_back(boxes_of(label));
    if (label.type != "Car" && label.type != "Van" && !is_sought(label)) continue;
    if (counts_by_label(label, region))
      truth.boxes.push_back(truth_box(label, boxes_of(label), i));
    else
      truth.ignore.push_back(boxes_of(label));
  }
  return all;
}

PictureBox picture_box(const Label& label) {
  return {label.left, label.top, label.right, label.bottom};
}

ObjectBoxes boxes_of(const Label& label) {
  return {has_box(label) ? label.box : Box3{}, label.camera == 0 ? picture_box(label) : PictureBox{}};
}

TruthBoxes picture_truth(std::span<const Label> labels, std::span<const int> places) {
  TruthBoxes truth;
  for (std::size_t i = 0; i < labels.size(); ++i) {
    const Label& label = labels[i];
    const auto camera = as_size(label.camera);
    const int place = places.empty() && camera == 0 ? 0 : camera < places.size() ? places[camera] : -1;
    if (place < 0) continue;
    ObjectBoxes boxes(has_box(label) ? label.box : Box3{}, picture_box(label));
    boxes.camera = place;
    if (label.type == "Misc") truth.look_alikes.push_back(boxes);
    if (is_sought(label) && meets(label, limits_of(Difficulty::hard)))
      truth.boxes.push_back(truth_box(label, boxes, i));
    else if (is_vehicle_type(label.type) || label.type == "DontCare")
      truth.ignore.push_back(boxes);
  }
  return truth;
}

ScoredFrame scored(std::vector<Detection> detections, const GroundTruth& truth, double focal_length,
                   Matching matching) {
  return {std::move(detections), matching.in_picture() ? truth.picture : truth.space, focal_length, matching};
}

PrecisionRecall average_precision(std::span<const ScoredFrame> frames, double min_iou) {
  PrecisionRecall result;
  for (const ScoredFrame& frame : frames) result.boxes += static_cast<int>(frame.truth.boxes.size());
  if (result.boxes == 0) return result;
  int hits = 0, alarms = 0;
  for (const Judged& detection : judged(frames, min_iou)) {
    ++(detection.hit ? hits : alarms);
    result.curve.push_back(
        {static_cast<double>(hits) / result.boxes, static_cast<double>(hits) / (hits + alarms)});
  }
  result.recall = static_cast<double>(hits) / result.boxes;
  result.average_precision = area_under(result.curve);
  return result;
}

std::vector<ScoredFrame> without_look_alikes(std::span<const ScoredFrame> frames) {
  std::vector<ScoredFrame> result(frames.begin(), frames.end());
  for (ScoredFrame& frame : result) {
    TruthBoxes& truth = frame.truth;
    truth.ignore.insert(truth.ignore.end(), truth.look_alikes.begin(), truth.look_alikes.end());
  }
  return result;
}

Interval average_precision_interval(std::span<const ScoredFrame> frames, double min_iou) {
  if (!has_boxes(frames)) return {0, 0, 1};
  const FramesAndVehicles clusters(frames);
  PrecisionWithout precision(frames, min_iou, clusters);
  return share_interval(
      jackknifed(average_precision(frames, min_iou).average_precision, clusters, std::ref(precision)),
      clusters.trials());
}

Interval average_precision_difference(std::span<const ScoredFrame> a, std::span<const ScoredFrame> b,
                                      double min_iou) {
  if (!has_boxes(a)) return {0, -1, 1};
  const FramesAndVehicles clusters(a);
  PrecisionWithout first(a, min_iou, clusters), second(b, min_iou, clusters);
  return difference_interval(
      jackknifed(
          average_precision(a, min_iou).average_precision - average_precision(b, min_iou).average_precision,
          clusters, [&](std::size_t left_out) { return first(left_out) - second(left_out); }),
      clusters.trials());
}

ClusterCount clusters_of(std::span<const ScoredFrame> frames) {
  Clusters clusters;
  for (std::size_t f = 0; f < frames.size(); ++f)
    for (const TruthBox& box : frames[f].truth.boxes) clusters.add(std::to_string(f), box.track);
  return clusters.count();
}

std::vector<Stratum> standard_strata() {
  return {{"0-20 m", 0, 20},
          {"20-40 m", 20, 40},
          {"40-70 m", 40, 70},
          {"0-40 m", 0, 40},
          {"easy", 0, 1e9, Difficulty::easy},
          {"moderate", 0, 1e9, Difficulty::moderate},
          {"hard", 0, 1e9, Difficulty::hard}};
}

PrecisionRecall average_precision(std::span<const ScoredFrame> frames, double min_iou,
                                  const Stratum& stratum) {
  std::vector<ScoredFrame> kept;
  for (const ScoredFrame& frame : frames) {
    ScoredFrame part;
    part.truth.ignore = frame.truth.ignore;
    part.matching = frame.matching;
    const auto in_range = [&](double distance) {
      return distance >= stratum.nearest && distance < stratum.farthest;
    };
    for (const TruthBox& box : frame.truth.boxes) {
      const double distance = frame.matching.in_picture() ? box.distance : horizontal_distance(box.box.bev);
      if (in_range(distance) && box.difficulty <= stratum.hardest)
        part.truth.boxes.push_back(box);
      else
        part.truth.ignore.push_back(box);
    }
    for (const Detection& proposal : frame.detections) {
      const ApparentSize seen = apparent_size(proposal, frame);
      const bool high = seen.height >= limits_of(stratum.hardest).least_height;
      const auto matches = [&](const ObjectBoxes& box) {
        return frame.matching.overlap(proposal, box) >= min_iou;
      };
      if ((high && (in_range(seen.distance) || std::isinf(seen.distance))) ||
          std::any_of(part.truth.boxes.begin(), part.truth.boxes.end(), matches))
        part.detections.push_back(proposal);
    }
    kept.push_back(std::move(part));
  }
  return average_precision(kept, min_iou);
}

}  // namespace mirage
