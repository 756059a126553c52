// A detector's grade: which objects it holds against, and how far away.
//
// A cell is a level of objects in a band of distance. It *holds* if at most kScoreLimit of its cars vanish
// (attack/host_outcome.h) with 95 % confidence; a car counts if any object of the level hides it. It *does
// not hold* if more do with 95 % confidence. Otherwise it cannot be told, and the number of cars needed to
// decide is reported. The levels, each with its grade:
//     C  loads    everyday roof loads
//     B  shapes   large shapes that were not learned
//     A  learned  against this detector, and zoo solids that were learned on the same rig
// A band gets the best grade whose cells hold, together with those of all lower grades. D: not even C holds,
// or more than kScoreLimit of the cars are missed as recorded with 95 % confidence (a missed car cannot
// vanish). The grade is the worst of the bands within kBoundRange. Without an object learned against this
// very detector there is no grade: a detector hardened against known objects would pass.
#pragma once

#include <array>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "attack/attack.h"
#include "attack/evaluate_run.h"
#include "attack/host_outcome.h"

namespace mirage {

/// The largest allowed share of cars that vanish.
inline constexpr double kScoreLimit = 0.05;
/// m, band edges: a car that brakes with 6 m/s² after one second stops within 20, 40 and 70 m from 38, 60 and
/// 85 km/h.
inline constexpr std::array<double, 4> kScoreBands = {0, 20, 40, 70};

/// Levels of objects, as above; recorded: no object on the roof.
enum class ObjectLevel { recorded, loads, shapes, learned };
constexpr auto words_of(ObjectLevel) {
  return std::to_array<const char*>({"recorded", "loads", "shapes", "learned"});
}

/// Whether a cell holds, as above; open: the data cannot tell.
enum class CellStatus { holds, fails, open };
constexpr auto words_of(CellStatus) {
  return std::to_array<const char*>({"holds", "does not hold", "cannot be told"});
}

/// An object that was judged.
struct ScoredObject {
  std::string name;
  ObjectLevel level = ObjectLevel::shapes;
  std::string row;          ///< objects of one row are judged together
  bool against_it = false;  ///< learned against the detector that is judged
};

/// The objects of a row in one band of distance.
struct ScoreCell {
  HiddenBound bound;
  CellStatus status = CellStatus::open;
  /// If open: approximate number of cars at this distance needed to decide, if the share stays the same.
  std::optional<long> needed;
};
template <class Visitor, FieldsOf<ScoreCell> S>
void visit_fields(Visitor& visit, S& s) {
  visit_fields(visit, s.bound);
  visit_named(visit, "held", s.status, "needed_vehicles", s.needed);
}

/// The objects of one level that are judged together.
struct ScoreRow {
  ObjectLevel level = ObjectLevel::recorded;
  std::string name;
  std::vector<std::string> objects;  ///< empty: no object on the roof
  /// FP ASR, mean over the objects: share of the cars found as recorded that get a new box on no road user.
  std::optional<Interval> phantoms;
  std::vector<ScoreCell> cells;  ///< one a band
};
template <class Visitor, FieldsOf<ScoreRow> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "level"}, s.level);
  visit({.name = "name", .plain = true}, s.name);
  visit_named(visit, "objects", s.objects, "cells", s.cells);
  if (s.phantoms) visit({.name = "phantoms"}, *s.phantoms);
}

/// The grade, and its cells.
struct Score {
  std::vector<ScoreRow> rows;  ///< by level
  std::string grade;           ///< "A" to "D"; empty: no object was learned against this detector
  std::array<std::string, kScoreBands.size() - 1> by_band;
  /// Approximate number of frames needed to decide all open cells of objects within kBoundRange.
  std::optional<long> frames_needed;
  std::vector<std::string> answer;  ///< in sentences, the grade first
};

/// Grades a detector from the outcomes of objects[mesh] on the same hosts, which stand in `frames` frames.
Score score_outcomes(std::span<const HostOutcome> hosts, const std::vector<ScoredObject>& objects,
                     std::size_t frames);

/// Inputs of `mirage score`.
struct ScoreRequest {
  std::filesystem::path out;
  DetectorOptions detector;  ///< `rig` is set by the data set
  /// As EvaluationRequest::overrides. "data" gives the frames to judge on; without it they are generated in
  /// OUT/judged, with a seed on which no shipped detector was trained.
  Overrides overrides;
  int frames = 200;  ///< number of generated frames to judge on
  /// Frames to learn on; empty: generated for the same rig, in OUT/learn. If they are the frames to judge on,
  /// the frames that the attack holds back are judged.
  std::filesystem::path learn_data;
  int learn_frames = 24;              ///< number of generated frames to learn on
  bool adaptive = true;               ///< learn objects against the detector, in OUT/learned-SIZE
  std::vector<double> sizes = {0.8};  ///< of the objects: L of AdversaryLimits (limits_of_size), m
  int iterations = 60;                ///< attack steps for each object with gradients
  int queries = 2000;                 ///< passes of a black-box attack without gradients
  std::vector<std::filesystem::path> meshes = {kZoo};  ///< objects that are not learned here
  std::uint64_t seed = 0;
  bool quiet = false;
};

/// An object that score() learned.
struct LearnedObject {
  double size = 0;
  AttackSettings settings;
  AttackResult result;
};
template <class Visitor, FieldsOf<LearnedObject> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "size", s.size, "attack", s.settings.attack, "steps", s.result.iterations, "vehicles",
              s.result.vehicles_train);
}

/// Everything that score() learns, judges and concludes.
struct ScoreResult {
  Score score;
  RunEvaluation evaluation;
  Audit points;  ///< audit with another frame's sweep only; no row for a detector without LiDAR
  std::vector<LearnedObject> learned;
};

/// Generates, learns and judges; resumes where it was stopped. FieldError if OUT/judged or OUT/learn holds
/// another number of frames. InputError as run_attack() and evaluate_run().
ScoreResult score(const ScoreRequest& request);

/// {detector, weights, defense, grade (null without one), answer: [text], limit, within_m, bands: [m],
/// by_band: [grade], rows: [{level, name, objects, phantoms?: {value, low, high}, cells: [as HiddenBound, and
/// held, needed_vehicles]}], frames, frames_needed, hosts, vehicles, clusters, reliance, reliance_words,
/// points?: as a row of to_json(Audit), points_words?, uses: {image?, points?}: true, false or null, learned:
/// [{size, attack, steps, vehicles}]}
nlohmann::json to_json(const ScoreResult& result);

/// Reads results of `mirage score` (files, or folders with result.json) as [{score, provenance}]. InputError
/// naming file and field for anything else.
nlohmann::json read_scores(const std::vector<std::filesystem::path>& files);

}  // namespace mirage
