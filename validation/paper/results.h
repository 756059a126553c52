// What `mirage evaluate` found of each host, read back from its result.json, and shares over it with
// intervals.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "attack/hiding.h"
#include "attack/host_outcome.h"
#include "base/clusters.h"
#include "base/intervals.h"
#include "detection/reliance.h"

namespace mirage::paper {

/// What mends a result that can't be read, in errors.
inline constexpr const char* kMakeAgain = "delete the folder and run the same command again";

/// One host under one mesh, without its detections (attack/evaluation.h).
struct Outcome : HostOutcome {
  int run = 0;  ///< of the attack, from another seed

  /// m from the host to each of its false positives; none in the picture's plane, which has no metres.
  std::vector<double> distances() const;
};

struct Outcomes {
  std::string name;  ///< "learned mesh", "random mesh", "random mesh of its size", …
  std::string data;  ///< which frames: hosts of equal data, frame and label are the same
  std::vector<Outcome> hosts;
  int meshes = 1, runs = 1;
  int vehicles = 0;  ///< hosts detected clean, each once
  /// Whether the detector uses its picture on these frames; none: not known.
  std::optional<Reliance> reliance = {};

  /// What stands in place of statements about images; empty if they may be made.
  std::string note() const;
  int frames() const;
  ClusterCount clusters() const;  ///< of the hosts detected clean
};

using Which = std::function<bool(const Outcome&)>;
bool is_hidden(const Outcome&);
bool is_false_positive(const Outcome&);
bool is_fooled(const Outcome&);

/// The outcomes of an evaluation's result.json, and those of the controls that it was asked for (others are
/// null). `data` names the frames. InputError naming file and field.
/// `sized`: those of random meshes of the learned one's extents, `cuboid`: those of cuboids that fill the box
/// (attack/baseline.h).
struct Judged {
  std::shared_ptr<const Outcomes> learned, random, sized, cuboid;
};
Judged read_evaluation(const std::filesystem::path& file, const std::string& data);
/// The same experiment's runs as one; what one of them lacks is missing. `runs` is not empty.
Judged pooled(const std::vector<Judged>& runs);

/// Share of the vehicles detected clean for which `which` holds; 95 % interval over clusters and runs
/// (base/intervals.h), as of all figures below.
Interval success(const Outcomes& outcomes, const Which& which);

/// Share of the vehicles found clean at all (IoU > 0.1 with a detection) of which nothing is found any more:
/// what attack/hiding.h calls vanished.
Interval vanished(const Outcomes& outcomes);

/// Of the vehicles that the rule (attack/hiding.h) finds clean, the share that it does not find any more;
/// none by distance where no detection has one (the picture's plane).
std::optional<Interval> hiding(const Outcomes& outcomes, const HidingRule& rule);
/// Vehicles that the rule finds clean, each once.
int found_clean(const Outcomes& outcomes, const HidingRule& rule);

/// hiding(a) − hiding(b), paired as below.
Interval hiding_difference(const Outcomes& a, const Outcomes& b, const HidingRule& rule);

/// A mesh and the control beside it, judged together.
struct NetOf {
  const Outcomes *learned, *control;
};
/// (hiding(a.learned) − hiding(a.control)) − (hiding(b.learned) − hiding(b.control)), on the vehicles that
/// all four have: which of two attacks has learned more beyond its mesh's size.
Interval net_difference(const NetOf& a, const NetOf& b, const HidingRule& rule);

/// success(a) − success(b), paired: both are of the same data, only hosts that stand in both count.
Interval success_difference(const Outcomes& a, const Outcomes& b, const Which& which);

/// Recall of the frames as recorded, of two detectors on the same hosts: a − b.
Interval clean_recall_difference(const Outcomes& a, const Outcomes& b, double iou);

/// Those outcomes for which `keep` holds.
Outcomes part(const Outcomes& outcomes, const Which& keep);
/// Those outcomes of `a` whose hosts also stand in `b`, in the run of the same number.
Outcomes shared_hosts(const Outcomes& a, const Outcomes& b);

/// Share of all hosts found at the IoU or better, clean or attacked.
Interval recall(const Outcomes& outcomes, double iou, bool clean);
/// Mean of that over IoU 0, 0.05, …, 1.
Interval mean_recall(const Outcomes& outcomes, bool clean);
/// The curve itself: the recall at each of those IoU.
struct RecallCurve {
  std::vector<double> iou;
  std::vector<Interval> recall;
};
RecallCurve recall_curve(const Outcomes& outcomes, bool clean);
/// {iou, recall, low, high}, a list each
nlohmann::json to_json(const RecallCurve& curve);

}  // namespace mirage::paper
