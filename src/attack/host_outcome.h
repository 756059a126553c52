// A detector's outcome on one host, clean and attacked (attack/evaluation.h defines success).
#pragma once

#include <array>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/intervals.h"
#include "detection/detector.h"
#include "frames/host_id.h"
#include "scene/frame.h"
#include "simulation/insertion.h"

namespace mirage {

// Which labels count as vehicles and people in an attack's objective and evaluation.

/// Whether a box on this label is no false positive. DontCare and "Misc" are not road users: car-like objects
/// (the generator's hedges and stacks of goods) are background to a detector, under attack too.
bool is_road_user(const Label& label);

// The ground truth for a detector's boxes when an adversary stands on a host's roof.

/// The box around the object's pixels (S > 0.5), clipped to the picture; nullopt if it shows no pixel.
std::optional<PictureBox> silhouette_box(const Simulated& simulated);
/// silhouette_box() of an object that stands on its carrier or grows its box. nullopt for a free-standing
/// object: a box around it and the vehicle is not the vehicle's box.
std::optional<PictureBox> carried_box(const Simulated& simulated, const Placement& placement);

/// The boxes of the host and of every road user of its frame (is_road_user), for one Matching.
///
/// In the picture the host has a second box if the object is visible: the union of its label's box and the
/// object's silhouette. A box around car and object is neither a miss nor a false positive. DontCare regions
/// count as labels there, since their content is unknown.
class HostTruth {
 public:
  /// In the bird's-eye view. `labels`: every labelled road user of the frame, including the host.
  HostTruth(const BevBox& host, std::vector<ObjectBoxes> labels)
      : host_({ObjectBoxes(host)}), labels_(std::move(labels)) {}
  /// For a label of the frame. `object`: the object's carried_box(), used only with Matching::in_picture.
  HostTruth(const Frame& frame, const Label& host, Matching matching,
            const std::optional<PictureBox>& object = {});
  /// The same for a host whose true box differs from its label: `grown`; in the picture, the union of the
  /// label's box and the object's.
  static HostTruth with_box(const Frame& frame, const Label& host, Matching matching, const BevBox& grown,
                            const std::optional<PictureBox>& object);

  /// For an object that is not among the frame's labels (own_label()): no box on it is a false positive.
  static HostTruth of_object(const Frame& frame, const Label& object, Matching matching);

  /// How its boxes are compared.
  const Matching& matching() const { return matching_; }
  /// The box of the host's label.
  const ObjectBoxes& host() const { return host_.front(); }
  /// Largest overlap with a box of the host.
  double host_iou(const ObjectBoxes& found) const;
  /// Largest overlap with a box of any label; in the picture, 1 for a box that lies at least half in a
  /// DontCare region.
  double label_iou(const ObjectBoxes& found) const;
  /// Whether at least half of the box lies in a DontCare region. Regions are boxes of the picture, so a box
  /// in space is projected. If it has no height, it gets a car's height, and the host's bottom.
  bool in_dont_care(const ObjectBoxes& found) const;
  /// The labels' boxes, including the host's.
  const std::vector<ObjectBoxes>& labels() const { return labels_; }

 private:
  double largest(const ObjectBoxes& found, const std::vector<ObjectBoxes>& others) const;

  Matching matching_;
  std::vector<ObjectBoxes> host_, labels_;
  std::vector<ObjectBoxes> dont_care_;  ///< boxes of the picture, with every Matching
  Calibration calibration_;             ///< only set for boxes in space
  double ground_ = 0;                   ///< m, `velo`: the host's bottom
};

/// A false positive: a detection that the adversary made.
struct NewBox {
  ObjectBoxes box;
  double score = 0;
  double distance = 0;  ///< m (in the picture: pixels), from the host's centre to the box's
  double range = 0;     ///< m, from the `velo` origin; 0 in the picture
};

/// The detector's outcome on one host, clean and attacked.
struct HostOutcome {
  HostId id;
  int mesh = 0;            ///< which of the judged meshes
  int victim = -1;         ///< Victim::neighbour: the label judged in the host's place; -1: the host
  int track = -1;          ///< the label's (here and below the victim's)
  bool from_box = true;    ///< the roof's pose is the labelled box's (Carrier)
  double range = 0;        ///< m, host's box centre from the `velo` origin
  int occluded = 0;        ///< the label's
  double truncated = 0;    ///< the label's
  std::string kind;        ///< EvaluationSettings::kinds
  Matching matching = {};  ///< how the detector was judged
  double clean_iou = 0, attacked_iou = 0;      ///< best IoU of a detection with the host's box
  double clean_score = 0, attacked_score = 0;  ///< score of that detection
  /// m, from the host's centre to that of the nearest detection; infinite without any and in the picture.
  double clean_distance = std::numeric_limits<double>::infinity(),
         attacked_distance = std::numeric_limits<double>::infinity();
  bool detected = false, hidden = false, false_positive = false;
  double false_positive_distance = 0;      ///< from the host to the farthest new box, if any (NewBox)
  std::vector<NewBox> new_boxes;           ///< in the order of `attacked`
  std::vector<Detection> clean, attacked;  ///< detections after suppression

  /// The cluster of this host (base/intervals.h).
  std::string cluster() const { return cluster_of(id.frame, track); }
  /// Whether the attack succeeded on this host, by a miss or a false positive: the event that ASR counts.
  bool fooled() const { return hidden || false_positive; }
};

/// Selects outcomes.
using OutcomeTest = std::function<bool(const HostOutcome&)>;

// Success rates over outcomes (attack/evaluation.h has their definitions).

/// Shares of the vehicles that were detected clean, with 95 % intervals (base/intervals.h).
struct SuccessRates {
  int vehicles = 0;  ///< detected clean: the denominator of one mesh
  Interval fn_asr, fp_asr, asr;
};
template <class Visitor, FieldsOf<SuccessRates> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "vehicles", s.vehicles, "fn_asr", s.fn_asr, "fp_asr", s.fp_asr, "asr", s.asr);
}
/// Rates over the hosts that satisfy `of` and were detected clean. `iou`, if given, replaces
/// EvaluationSettings::detected_iou.
SuccessRates success_rates(
    std::span<const HostOutcome> hosts, std::optional<double> iou = {},
    const OutcomeTest& of = [](const HostOutcome&) { return true; });

// The detections that an adversary created.

/// A histogram with its median and 90th percentile (order statistics: the ⌈q·n⌉-th value).
struct Distribution {
  std::vector<double> edges;  ///< bin k is [edges[k], edges[k + 1]); the last includes all larger values
  std::vector<int> counts;
  std::optional<double> median, p90;  ///< nullopt without values
};
template <class Visitor, FieldsOf<Distribution> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "edges", s.edges, "counts", s.counts, "median", s.median, "p90", s.p90);
}
/// Counts finite values into bins; `edges` are at least two, rising.
Distribution distribution(const std::vector<double>& values, std::vector<double> edges);

/// New boxes of the hosts that were detected clean, as FP ASR counts them: {vehicles, boxes,
/// distance_from_host, distance_from_sensor, score, list}. `vehicles`: outcomes with at least one new box;
/// distances in m, each a distribution {edges, counts, median, p90} (null without boxes); `list`: every box
/// with its host {frame, label, mesh}, box, score and the two distances. For a detector judged in the picture
/// the boxes are {left, top, right, bottom}, distance_from_host_px stands for distance_from_host (pixels),
/// and there is no distance_from_sensor.
nlohmann::json false_positives_json(const std::vector<HostOutcome>& hosts);

// Rules for "hidden". A host is hidden if the detector finds it in the frame as recorded, and not with the
// adversary on its roof. There are several rules for "found", because a slightly turned or shifted box is a
// miss at IoU 0.7 and yet no danger in traffic:
//     vanished         IoU (or Matching's other overlap) of a detection with the host's box above 0.1: below
//                      that no box is left there
//     iou50, iou70     above 0.5; above 0.7, as Tu et al., CoRL 2021, section 4
//     distance1m, …2m  a detection's centre lies within 1 or 2 m of the host's, however its box is turned
//                      (nuScenes' matching: Caesar et al., CVPR 2020)
// Each rate has its own denominator: the hosts that its rule finds clean. In the picture there are no rates
// by distance, since boxes have no metres there.

/// Rule for a found host: an IoU above `iou`, or, if `distance` > 0, a centre within `distance` m.
struct MissCriterion {
  const char* name;
  double iou = 0, distance = 0;
  /// From the best IoU of a detection, and the distance (m) to the nearest detection's centre.
  bool finds(double best_iou, double nearest) const {
    return distance > 0 ? nearest <= distance : best_iou > iou;
  }
  /// For the frame as recorded (`clean`) or with the adversary.
  bool finds(const HostOutcome& host, bool clean) const;
};

/// All rules, in the order of MissRates.
inline constexpr std::array<MissCriterion, 5> kMissCriteria = {
    {{"vanished", 0.1, 0}, {"iou50", 0.5, 0}, {"iou70", 0.7, 0}, {"distance1m", 0, 1}, {"distance2m", 0, 2}}};
/// The rule "vanished".
inline constexpr const MissCriterion& kVanished = kMissCriteria.front();

/// Share of the hosts found clean by a rule that it does not find attacked.
struct MissRate {
  Interval share;    ///< 95 % (base/intervals.h)
  int vehicles = 0;  ///< found clean by this rule: the denominator of one mesh
};
template <class Visitor, FieldsOf<MissRate> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, s.share);
  visit_named(visit, "vehicles", s.vehicles);
}

/// Miss rates by each rule; by distance only for boxes in space.
struct MissRates {
  MissRate vanished, iou50, iou70;
  std::optional<MissRate> distance1m, distance2m;
};
template <class Visitor, FieldsOf<MissRates> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "vanished", s.vanished, "iou50", s.iou50, "iou70", s.iou70, "distance1m", s.distance1m,
              "distance2m", s.distance2m);
}

/// Over the outcomes of one mesh, or of several, one mesh after the other.
MissRates miss_rates(std::span<const HostOutcome> hosts);

/// How much more often one mesh succeeds than others on the same hosts: rate(learned) − rate(other). By each
/// rule above, and for FN ASR, FP ASR and ASR (attack/evaluation.h). Paired (share_difference).
struct GainOverControl {
  Interval vanished, iou50, iou70;
  std::optional<Interval> distance1m, distance2m;
  Interval fn, false_positive, asr;
};
template <class Visitor, FieldsOf<GainOverControl> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "vanished", s.vanished, "iou50", s.iou50, "iou70", s.iou70, "distance1m", s.distance1m,
              "distance2m", s.distance2m, "fn_asr", s.fn, "fp_asr", s.false_positive, "asr", s.asr);
}
/// Both cover the same hosts, in any order; their numbers of meshes may differ.
GainOverControl gain_over_control(std::span<const HostOutcome> learned, std::span<const HostOutcome> other);

// Exact one-sided bounds of a share, for data in which few cars or none vanish, and the number of vehicles
// that a tighter bound needs.

/// Exact bounds of the mean of one share per cluster. The clusters are independent draws; the population mean
/// is at most `high` with kConfidence, and at least `low` with kConfidence.
struct ShareBound {
  double value = 0, low = 0, high = 1;
  int clusters = 0;
  /// No cluster has more than one trial. Then the bound is binomial (Clopper and Pearson, Biometrika 26,
  /// 1934). Otherwise it is the binomial bound at level (1 − kConfidence) / e for the count rounded up to a
  /// whole number of clusters. For independent numbers in [0, 1] the lower tail of the sum is at most e times
  /// the binomial's (Bentkus, Annals of Probability 32, 2004).
  bool single = true;
};
/// Bounds from one share in [0, 1] per cluster; [0, 1] for no shares.
ShareBound share_bound(std::span<const double> shares, bool single);
/// Approximate number of clusters that bounds the mean by `at_most`, if the observed share stays `value`;
/// infinite if `value` ≥ `at_most`.
double clusters_for(double at_most, double value, bool single);
/// A planned number of vehicles, rounded up to two digits; nullopt above a million and for NaN.
std::optional<long> rounded_up(double count);
/// Number of vehicles that would detect `difference` if `vehicles` detect `detectable` with the same power:
/// interval widths scale with 1/√n.
std::optional<long> sample_size(double vehicles, double detectable, double difference);

/// m: default range up to which bounds are computed.
inline constexpr double kBoundRange = 40;
/// Bounds of the share of cars at these distances that vanish. Each cluster (base/intervals.h) has equal
/// weight, so the share is that of a random car of a random frame (or vehicle). With several meshes a car
/// counts as hidden if any mesh hides it.
struct HiddenBound {
  ShareBound share;
  double nearest = 0, farthest = kBoundRange;  ///< m; the nearer end belongs to it
  int vehicles = 0;
  std::string by = "frame";  ///< ClusterCount::by
  /// Number of clusters that a smaller bound needs if the observed share stays the same.
  struct Needed {
    double at_most;
    double clusters;  ///< infinite: the observed share is not below it
  };
  std::vector<Needed> needed;  ///< for 10, 5, 2 and 1 %
};
template <class Visitor, FieldsOf<HiddenBound::Needed> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "at_most", s.at_most, "clusters", s.clusters);
}
template <class Visitor, FieldsOf<HiddenBound> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "at_most", s.share.high, "at_least", s.share.low, "value", s.share.value, "from_m",
              s.nearest, "within_m", s.farthest, "vehicles", s.vehicles, "needed", s.needed);
  visit.derived("clusters", to_json(ClusterCount{s.by, s.share.clusters}));
}
/// Computed over the outcomes of one or several meshes.
HiddenBound hidden_bound(std::span<const HostOutcome> hosts, double nearest = 0,
                         double farthest = kBoundRange);
/// "at most 5.1 % of cars within 40 m vanish (95 %, exact over 58 frames; seen: 0.0 %)", and ": 149 frames
/// for 2 %" if a smaller bound can be reached.
std::string describe(const HiddenBound& bound);

}  // namespace mirage
