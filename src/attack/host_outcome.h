// What a detector says of one host, clean and attacked (attack/evaluation.h has the definitions of success).
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

// Which labels are vehicles and people, in the eyes of an attack's objective and of its evaluation.

/// A box on it is no false positive. DontCare regions are none, nor is "Misc": what looks like a car and is
/// none (the generator's hedges and stacks of goods) is background to a detector, under attack too.
bool is_road_user(const Label& label);

// What a detector's boxes are compared with when an adversary stands on a host's roof.

/// The box around the object's pixels (S > 0.5), clipped to the picture; none where it shows no pixel.
std::optional<PictureBox> silhouette_box(const Simulated& simulated);
/// That of an object which stands on its carrier, or grows its box; none of one that stands free: a box
/// around a vehicle and what is beside it is no box of the vehicle.
std::optional<PictureBox> carried_box(const Simulated& simulated, const Placement& placement);

/// The host's boxes and those of every road user of its frame (is_road_user), for one way of comparing them.
///
/// In the picture the host has second boxes where an object is seen: its label's joined with the object's
/// silhouette. A box around car and object is no miss, and no false positive. DontCare regions are among the
/// labels there: nobody knows what stands in them.
class HostTruth {
 public:
  /// From above. `labels`: every labelled road user of the frame, the host among them.
  HostTruth(const BevBox& host, std::vector<ObjectBoxes> labels)
      : host_({ObjectBoxes(host)}), labels_(std::move(labels)) {}
  /// Of a label of the frame. `object`: its carried_box(), of which Matching::in_picture alone takes notice.
  HostTruth(const Frame& frame, const Label& host, Matching matching,
            const std::optional<PictureBox>& object = {});
  /// The same of a host whose box is another than the label's: `grown`, and in the picture the label's joined
  /// with the object's.
  static HostTruth with_box(const Frame& frame, const Label& host, Matching matching, const BevBox& grown,
                            const std::optional<PictureBox>& object);

  /// Of a thing that the frame's labels do not know (own_label()): no box on it is a false positive.
  static HostTruth of_object(const Frame& frame, const Label& object, Matching matching);

  /// How its boxes are compared.
  const Matching& matching() const { return matching_; }
  /// The host's boxes: the label's.
  const ObjectBoxes& host() const { return host_.front(); }
  /// Largest overlap with a box of the host.
  double host_iou(const ObjectBoxes& found) const;
  /// Largest overlap with a box of any label; 1 in the picture for a box that lies by half or more in a
  /// DontCare region.
  double label_iou(const ObjectBoxes& found) const;
  /// Whether what is found lies by half or more in a DontCare region. Regions are boxes of the picture: a box
  /// in space is projected, with a car's height, and standing where the host stands, where it tells neither.
  bool in_dont_care(const ObjectBoxes& found) const;
  /// The labels' boxes, the host's own among them.
  const std::vector<ObjectBoxes>& labels() const { return labels_; }

 private:
  double largest(const ObjectBoxes& found, const std::vector<ObjectBoxes>& others) const;

  Matching matching_;
  std::vector<ObjectBoxes> host_, labels_;
  std::vector<ObjectBoxes> dont_care_;  ///< boxes of the picture, whatever is compared
  Calibration calibration_;             ///< in space, where there are regions
  double ground_ = 0;                   ///< m, `velo`: the host's bottom
};

/// A false positive: a detection that the adversary made.
struct NewBox {
  ObjectBoxes box;
  double score = 0;
  double distance = 0;  ///< m (in the picture: pixels), from the host's centre to the box's
  double range = 0;     ///< m, from the `velo` origin; 0 in the picture
};

/// What the detector says about one host, clean and attacked.
struct HostOutcome {
  HostId id;
  int mesh = 0;            ///< which of the judged meshes
  int victim = -1;         ///< Victim::neighbour: the label that is judged in the host's place; -1: the host
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

  /// What it is counted with (base/intervals.h).
  std::string cluster() const { return cluster_of(id.frame, track); }
  /// Whether the attack worked on this host, in either way: what ASR counts.
  bool fooled() const { return hidden || false_positive; }
};

/// Which outcomes are meant.
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
/// Over those outcomes that count: hosts `of` that kind whose detection was clean. With `iou`, as if that
/// were EvaluationSettings::detected_iou.
SuccessRates success_rates(
    std::span<const HostOutcome> hosts, std::optional<double> iou = {},
    const OutcomeTest& of = [](const HostOutcome&) { return true; });

// Where the detections are that an adversary made.

/// A histogram with its median and 90th percentile (order statistics: the ⌈q·n⌉-th value).
struct Distribution {
  std::vector<double> edges;  ///< bin k is [edges[k], edges[k + 1]); the last one takes what lies beyond, too
  std::vector<int> counts;
  std::optional<double> median, p90;  ///< none without values
};
template <class Visitor, FieldsOf<Distribution> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "edges", s.edges, "counts", s.counts, "median", s.median, "p90", s.p90);
}
/// Counts finite values into bins; `edges` rise and are at least two.
Distribution distribution(const std::vector<double>& values, std::vector<double> edges);

/// New boxes of the hosts that were detected clean, those that FP ASR counts:
/// {vehicles, boxes, distance_from_host, distance_from_sensor, score, list}. `vehicles`: outcomes with at
/// least one; distances in m, each a distribution {edges, counts, median, p90} (null without boxes); `list`:
/// every box with its host {frame, label, mesh}, box, score and the two distances. Of a detector that is
/// judged in the picture the boxes are {left, top, right, bottom}, distance_from_host_px stands for
/// distance_from_host (pixels), and there is no distance_from_sensor.
nlohmann::json false_positives_json(const std::vector<HostOutcome>& hosts);

// What "hidden" means. A host is hidden when the detector found it in the frame as recorded and does not find
// it with the adversary on its roof; what counts as found is one of several rules, because a box that was
// only turned or moved a little is a miss at IoU 0.7 and no danger in traffic:
//     vanished         IoU (or what else Matching compares by) of a detection with the host's box above 0.1:
//                      else no box stands there any more
//     iou50, iou70     above 0.5; above 0.7, as Tu et al., CoRL 2021, section 4
//     distance1m, …2m  a detection's centre lies within 1 or 2 m of the host's, however its box is turned
//                      (nuScenes' matching: Caesar et al., CVPR 2020)
// Each rate has its own denominator: the hosts that its rule finds clean. In the picture there are no
// metres, and no rates by distance.

/// What counts as found: an IoU above `iou`, or with `distance` > 0 a centre within so many metres.
struct MissCriterion {
  const char* name;
  double iou = 0, distance = 0;
  /// Given the best IoU of a detection, and m to the nearest one's centre.
  bool finds(double best_iou, double nearest) const {
    return distance > 0 ? nearest <= distance : best_iou > iou;
  }
  /// In the frame as recorded (`clean`) or with the adversary.
  bool finds(const HostOutcome& host, bool clean) const;
};

/// All of them, in the order of MissRates.
inline constexpr std::array<MissCriterion, 5> kMissCriteria = {
    {{"vanished", 0.1, 0}, {"iou50", 0.5, 0}, {"iou70", 0.7, 0}, {"distance1m", 0, 1}, {"distance2m", 0, 2}}};
/// The first of them.
inline constexpr const MissCriterion& kVanished = kMissCriteria.front();

/// Of the hosts that a rule finds clean, those that it does not find attacked.
struct MissRate {
  Interval share;    ///< 95 % (base/intervals.h)
  int vehicles = 0;  ///< found clean by this rule: the denominator of one mesh
};
template <class Visitor, FieldsOf<MissRate> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, s.share);
  visit_named(visit, "vehicles", s.vehicles);
}

/// By each rule; those by distance only where boxes lie in space.
struct MissRates {
  MissRate vanished, iou50, iou70;
  std::optional<MissRate> distance1m, distance2m;
};
template <class Visitor, FieldsOf<MissRates> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "vanished", s.vanished, "iou50", s.iou50, "iou70", s.iou70, "distance1m", s.distance1m,
              "distance2m", s.distance2m);
}

/// Over outcomes of one mesh or, a mesh after the other, of several.
MissRates miss_rates(std::span<const HostOutcome> hosts);

/// How much more often one mesh works than others on the same hosts: rate(learned) − rate(other) by each of
/// the rules above, and of FN ASR, FP ASR and ASR (attack/evaluation.h). Paired (share_difference).
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
/// Both are of the same hosts, in any order, each with as many meshes as it has.
GainOverControl gain_over_control(std::span<const HostOutcome> learned, std::span<const HostOutcome> other);

// How large a share can be at most, where few cars or none vanish, and at least: exact, one-sided. And how
// many vehicles it takes to tell more.

/// Exact bounds of a mean of shares, one a cluster: the mean over all clusters, of which these were drawn
/// independently, is no larger than `high` with kConfidence, and no smaller than `low` with kConfidence.
struct ShareBound {
  double value = 0, low = 0, high = 1;
  int clusters = 0;
  /// No cluster has more than one trial. Then the bound is the binomial's (Clopper and Pearson, Biometrika
  /// 26, 1934). Else it is that at (1 − kConfidence) / e, at the next whole number of clusters: for any
  /// independent numbers in [0, 1] the lower tail of their sum is at most e times the binomial's (Bentkus,
  /// Annals of Probability 32, 2004).
  bool single = true;
};
/// `shares` in [0, 1]. Without any: [0, 1].
ShareBound share_bound(std::span<const double> shares, bool single);
/// About how many clusters of that kind would bound the mean by `at_most`, if the share seen stays `value`;
/// infinite where that is not below `at_most`.
double clusters_for(double at_most, double value, bool single);
/// A plan's number of vehicles, rounded up to two digits; none above a million, and for no number.
std::optional<long> rounded_up(double count);
/// How many it would take to tell `difference`, where `vehicles` tell `detectable` in as many of such sets:
/// intervals narrow with their root.
std::optional<long> sample_size(double vehicles, double detectable, double difference);

/// m: vehicles within it are what bounds are given for, unless others are asked for.
inline constexpr double kBoundRange = 40;
/// The share of cars at these distances that vanish, as far as it can be excluded: each cluster
/// (base/intervals.h) weighs the same, so it is of a car drawn from a frame (or vehicle) drawn. With several
/// meshes a car counts as hidden if any of them hides it.
struct HiddenBound {
  ShareBound share;
  double nearest = 0, farthest = kBoundRange;  ///< m; the nearer end belongs to it
  int vehicles = 0;
  std::string by = "frame";  ///< ClusterCount::by
  /// The clusters that a smaller bound would need if the observed share stays.
  struct Needed {
    double at_most;
    double clusters;  ///< infinite: the share seen is not below it
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
/// Over outcomes of one mesh or of several.
HiddenBound hidden_bound(std::span<const HostOutcome> hosts, double nearest = 0,
                         double farthest = kBoundRange);
/// "at most 5.1 % of cars within 40 m vanish (95 %, exact over 58 frames; seen: 0.0 %)", and where one can be
/// reached ": 149 frames for 2 %".
std::string describe(const HiddenBound& bound);

}  // namespace mirage
