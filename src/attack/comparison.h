// Is one detector easier to fool than another? Both see the same vehicles with the same objects on their
// roofs. A vehicle counts if both find it as recorded. Its outcome is whether it vanishes
// (attack/host_outcome.h). The answer is the paired difference of shares, second detector minus first.
//
// An object learned against the first detector favours the second. So the first two objects may be each
// detector's own: the difference "own" then compares each detector under its own object.
//
// The power is reported, too: the smallest true difference that 80 % of equal data sets would detect
// (detectable_difference). So are the numbers of vehicles needed to detect 2, 5 and 10 points. One data set
// answers several questions (ranges, occlusions, objects), so p values are adjusted by Holm's method
// (Scandinavian Journal of Statistics 6, 1979).
#pragma once

#include <array>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "attack/evaluation.h"
#include "attack/host_outcome.h"
#include "attack/zoo.h"

namespace mirage {

/// Inputs of `mirage compare`.
struct ComparisonRequest : FrameSource {
  /// Two; `rig` is set by the data set.
  std::vector<DetectorOptions> detectors;
  std::vector<std::filesystem::path> runs;    ///< runs of mirage attack whose objects are used
  std::vector<std::filesystem::path> meshes;  ///< objects (attack/zoo.h)
  /// runs[0] was learned against the first detector and runs[1] against the second, according to their
  /// run.json.
  bool adaptive = false;
  TrustRun trust = TrustRun::no;
  std::size_t frames = 0;  ///< the first N of the data set; 0: all
  double min_view = 0.7;   ///< as AttackSettings::min_view
  EvaluationSettings settings;
};

/// The comparison on one part of the vehicles.
struct ComparedPart {
  std::string by, name;    ///< "all" and "", "range" and "15-30 m", "object" and the mesh's name, …
  int vehicles = 0;        ///< found as recorded by both
  ClusterCount clusters;   ///< clusters of these vehicles
  Interval first, second;  ///< shares of vehicles that vanish
  Interval difference;     ///< second − first, paired, by cluster
  double p = 1;            ///< two-sided; Holm-adjusted over all parts except the first, the main question
};
template <class Visitor, FieldsOf<ComparedPart> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "by", s.by, "name", s.name, "vehicles", s.vehicles, "clusters", s.clusters.count,
              "first", s.first, "second", s.second, "difference", s.difference, "p", s.p);
}

/// A vehicle that only the second detector misses.
struct NewlyMissedVehicle {
  HostId id;
  std::string object;
  double range = 0;                                ///< m
  double first_score = 0, second_clean_score = 0;  ///< first detector under attack, second as recorded
};
template <class Visitor, FieldsOf<NewlyMissedVehicle> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "frame", s.id.frame, "label", s.id.label, "object", s.object, "range", s.range,
              "first_score", s.first_score, "second_clean_score", s.second_clean_score);
}

/// Result of `mirage compare`. Differences are second detector minus first.
struct Comparison {
  std::vector<std::string> detectors, objects;  ///< names; objects of the runs come before the meshes
  int hosts = 0;                                ///< hosts tried
  std::array<int, 2> found{};                   ///< found as recorded by the first and by the second
  std::vector<ComparedPart> parts;              ///< "all" first; parts without vehicles are left out
  /// With `adaptive`: each detector under its own object, second − first.
  std::optional<ComparedPart> own;
  std::array<HiddenBound, 2> bounds;  ///< of each detector, under any of the objects
  double detectable = 1;              ///< detectable_difference() at 80 % power
  /// A difference of shares, and the number of vehicles needed to detect it.
  struct Needed {
    double difference;
    std::optional<long> vehicles;  ///< nullopt: over a million
  };
  std::vector<Needed> needed;             ///< for 2, 5 and 10 points
  std::vector<NewlyMissedVehicle> worse;  ///< nearest first

  /// Whether fewer than kFewFound of the vehicles, or none, are found by both: a difference over so few says
  /// little.
  bool few() const;
};
template <class Visitor, FieldsOf<Comparison::Needed> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "difference", s.difference, "vehicles", s.vehicles);
}

/// Compares the outcomes of both detectors on the same hosts and meshes, in any order. `objects`: names of
/// the meshes.
Comparison compare_outcomes(std::span<const HostOutcome> first, std::span<const HostOutcome> second,
                            const std::vector<std::string>& objects, bool adaptive);

/// Evaluates both detectors on every usable vehicle within both regions that no run has learned on, with the
/// runs' simulation settings. The first detector's seed draws the noise. FieldError unless there are two
/// different detectors and at least one object. FieldError for a run that is named twice, has another
/// placement than the request, or simulates differently from the first. With `adaptive`, also for a run that
/// attacked another detector. InputError if no vehicle is left. Warns if a detector finds few. `provenance`,
/// if not null, receives both detectors, the frames and the objects. Only the first rank gets a result.
Comparison compare(const ComparisonRequest& request, Provenance* provenance = nullptr);

/// {detectors, objects, hosts, found: [2], vehicles, clusters, difference, low, high, told, first, second,
/// own?, bounds: [2 × a HiddenBound], detectable, needed: [{difference, vehicles}], parts: [{by, name,
/// vehicles, first, second, difference, p}], worse: [{frame, label, object, range, first_score,
/// second_clean_score}]}
nlohmann::json to_json(const Comparison& comparison);

}  // namespace mirage
