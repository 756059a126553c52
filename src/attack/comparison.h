// Is one detector easier to fool than another? Both see the same vehicles with the same objects on their
// roofs; a vehicle counts where both find it as recorded. The outcome of a vehicle is whether it vanishes
// (attack/host_outcome.h), and the answer is the paired difference of shares, second detector less first.
//
// An object that was learned against the first detector flatters the second. So the first two objects may be
// each detector's own: then the difference of "own" is that of each detector under its own object.
//
// The power is reported, too: the smallest true difference that 80 % of such sets would detect
// (detectable_difference), and the numbers of vehicles that would detect 2, 5 and 10 points. Several
// questions are asked of one set (ranges, occlusions, objects); their p values are Holm's (Scandinavian
// Journal of Statistics 6, 1979).
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

/// What `mirage compare` is asked for.
struct ComparisonRequest : FrameSource {
  /// Two; `rig` is set by the data set.
  std::vector<DetectorOptions> detectors;
  std::vector<std::filesystem::path> runs;    ///< folders of mirage attack, whose objects are compared under
  std::vector<std::filesystem::path> meshes;  ///< objects (attack/zoo.h)
  /// The first of `runs` was learned against the first detector, the second against the second: as their
  /// run.json say.
  bool adaptive = false;
  TrustRun trust = TrustRun::no;
  std::size_t frames = 0;  ///< the first so many of the data set; 0: all
  double min_view = 0.7;   ///< as AttackSettings::min_view
  EvaluationSettings settings;
};

/// One question.
struct ComparedPart {
  std::string by, name;    ///< "all" and "", "range" and "15-30 m", "object" and the mesh's name, …
  int vehicles = 0;        ///< found as recorded by both
  ClusterCount clusters;   ///< of these
  Interval first, second;  ///< shares that vanish
  Interval difference;     ///< second − first, paired, by cluster
  double p = 1;            ///< two-sided, Holm's over all parts but the first, which is the main question
};
template <class Visitor, FieldsOf<ComparedPart> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "by", s.by, "name", s.name, "vehicles", s.vehicles, "clusters", s.clusters.count,
              "first", s.first, "second", s.second, "difference", s.difference, "p", s.p);
}

/// A vehicle that only the second detector loses.
struct NewlyMissedVehicle {
  HostId id;
  std::string object;
  double range = 0;                                ///< m
  double first_score = 0, second_clean_score = 0;  ///< the first's under attack, the second's as recorded
};
template <class Visitor, FieldsOf<NewlyMissedVehicle> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "frame", s.id.frame, "label", s.id.label, "object", s.object, "range", s.range,
              "first_score", s.first_score, "second_clean_score", s.second_clean_score);
}

/// What `mirage compare` answers. Differences are second detector less first.
struct Comparison {
  std::vector<std::string> detectors, objects;  ///< names; objects: those of the runs before the meshes
  int hosts = 0;                                ///< tried
  std::array<int, 2> found{};                   ///< of them, as recorded by the first and by the second
  std::vector<ComparedPart> parts;              ///< "all" first; parts without vehicles are left out
  /// Each under its own object, second − first, with `adaptive`.
  std::optional<ComparedPart> own;
  std::array<HiddenBound, 2> bounds;  ///< of the first and the second, under any of the objects
  double detectable = 1;              ///< smallest true difference told in 80 % of such sets
  /// A difference of shares, and how many vehicles would tell it.
  struct Needed {
    double difference;
    std::optional<long> vehicles;  ///< none: more than any plan takes
  };
  std::vector<Needed> needed;             ///< for 2, 5 and 10 points
  std::vector<NewlyMissedVehicle> worse;  ///< nearest first

  /// Whether both find fewer than kFewFound of the vehicles, or none: of a difference over so few little
  /// follows.
  bool few() const;
};
template <class Visitor, FieldsOf<Comparison::Needed> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "difference", s.difference, "vehicles", s.vehicles);
}

/// From outcomes of the same hosts and meshes by both detectors, in any order. `objects`: names of the
/// meshes.
Comparison compare_outcomes(std::span<const HostOutcome> first, std::span<const HostOutcome> second,
                            const std::vector<std::string>& objects, bool adaptive);

/// Evaluates both detectors on every usable vehicle within the regions of both that no run has learned on, as
/// the runs simulate; noise is drawn by the first detector's seed. FieldError for anything but two detectors
/// that differ, for no object, for a run that is named twice, is of another placement than the request's or
/// simulates otherwise than the first, and, with `adaptive`, for one that attacked another detector.
/// InputError where no vehicle is left. Warns where a detector finds few. `provenance`, if it is not null,
/// learns what both detectors, the frames and the objects are. Ranks but the first get nothing.
Comparison compare(const ComparisonRequest& request, Provenance* provenance = nullptr);

/// {detectors, objects, hosts, found: [2], vehicles, clusters, difference, low, high, told, first, second,
/// own?, bounds: [2 × a HiddenBound], detectable, needed: [{difference, vehicles}], parts: [{by, name,
/// vehicles, first, second, difference, p}], worse: [{frame, label, object, range, first_score,
/// second_clean_score}]}
nlohmann::json to_json(const Comparison& comparison);

}  // namespace mirage
