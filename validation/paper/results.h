// The results of the finished cases: how each went, the outcome of each host that `mirage evaluate` judged,
// and shares over hosts with intervals.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "attack/host_outcome.h"
#include "base/intervals.h"
#include "detection/reliance.h"
#include "validation/paper/experiments.h"

namespace mirage::paper {

/// The fix that errors name for an unreadable result.
inline constexpr const char* kMakeAgain = "delete the folder and run the same command again";

/// One host under one mesh, without its detections (attack/evaluation.h).
struct Outcome : HostOutcome {
  int run = 0;  ///< of the attack, from another seed

  /// m from the host to each false positive; empty in the picture's plane, which has no metres.
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

  /// The note that replaces statements about images; empty if they may be made.
  std::string note() const;
  int frames() const;
  ClusterCount clusters() const;  ///< of the hosts detected clean
};

/// The outcomes of an evaluation by mesh: "learned", and its controls by their words (attack/baseline.h).
using Judged = std::map<std::string, Outcomes>;
/// Reads them from its result.json. `data` names the frames. InputError naming file and field.
Judged read_evaluation(const std::filesystem::path& file, const std::string& data);
/// Pools the runs of one experiment, by their numbers; a mesh that one lacks is missing. `runs` is not empty.
Judged pooled(const std::map<int, Judged>& runs);

/// A share: for how many of the hosts that count `holds` is true.
struct Question {
  std::function<bool(const Outcome&)> counts, holds;
};
/// A false positive is far from the host beyond this, m: about three lengths of a car, as the pictures of
/// mirage evaluate have it.
inline constexpr double kFar = 12;
/// The question with that key. Of the hosts detected clean: "fn_asr", "fp_asr", "asr"; "far": with a false
/// positive beyond kFar; "close": with an IoU below 0.75 as recorded. Of those within 30 m, and of the
/// others: "near_asr", "beyond_asr". Of those that the rule finds clean: a rule's name
/// (attack/host_outcome.h). Of all, found at that IoU: "recall50", "recall70", and as recorded
/// "clean_recall50", "clean_recall70".
Question question(const std::string& key);
/// The question over all hosts: found with that IoU or better, clean or attacked.
Question recall(double iou, bool clean);

/// The share with its 95 % interval over clusters and runs (base/intervals.h), as for all figures below.
Interval share(const Outcomes& outcomes, const Question& question);
/// Vehicles that count, each once whatever the meshes and runs.
int vehicles(const Outcomes& outcomes, const Question& question);

/// Whether detections have a distance, which some rules need; those in the picture's plane have none.
bool has_metres(const Outcomes& outcomes);

/// A summand of a difference.
struct Term {
  const Outcomes* of;
  double factor = 1;
};
/// A number of clusters for which Student's t is the normal law.
inline constexpr int kManyClusters = 1'000'000'000;
/// The clusters of an estimate: its degrees of freedom, rounded down, plus one. Runs crossed with clusters
/// lower the number.
int clusters_of(const Estimate& estimate);
/// A difference with the number of clusters of its interval.
struct Difference : Interval {
  int clusters = kManyClusters;
};
/// Σ factor · share, paired: all are of the same data, only hosts that stand in all count.
Difference difference(const std::vector<Term>& terms, const Question& question);
/// share(a) − share(b)
inline Difference difference(const Outcomes& a, const Outcomes& b, const Question& question) {
  return difference({{&a, 1}, {&b, -1}}, question);
}

/// The outcomes of `a` whose hosts also stand in `b`, in the run of the same number.
Outcomes shared_hosts(const Outcomes& a, const Outcomes& b);

/// Mean of the recall over IoU 0, 0.05, …, 1.
Interval mean_recall(const Outcomes& outcomes, bool clean);
/// The recall at each of those IoU: {iou, recall, low, high}, a list each.
nlohmann::json recall_curve(const Outcomes& outcomes, bool clean);

/// How a case went.
struct Step {
  enum class Status { missing, done, failed } status = Status::missing;
  std::string error;   ///< of a failed one
  double seconds = 0;  ///< that it took when it was run; 0: unknown
};
/// {status: "missing", "done" or "failed", error?, seconds?}
nlohmann::json to_json(const Step& step);

/// The clean "ap50" and "ap70" in mirage detect's result.json, each {value, low?, high?}. InputError naming
/// file and field.
nlohmann::json read_detection(const std::filesystem::path& file);

struct Evidence {
  std::map<std::string, Step> steps;                 ///< by case
  std::map<std::string, Judged> evaluations;         ///< by case; its repetitions by other seeds pooled
  std::map<std::string, nlohmann::json> detections;  ///< by case

  /// The outcomes of an evaluation's mesh; null if it is missing or failed.
  const Outcomes* of(const std::string& evaluation, const std::string& mesh = "learned") const;
};

/// Reads the results of the cases whose step is done; one that can't be read becomes a failed step.
Evidence gather(const Experiments& experiments, const std::filesystem::path& out,
                std::map<std::string, Step> steps);

}  // namespace mirage::paper
