// The result of an attack, besides the files in its folder.
#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "attack/attack_settings.h"
#include "attack/buildable.h"
#include "attack/clean_detections.h"
#include "base/intervals.h"
#include "frames/hosts.h"

namespace mirage {

/// With until_plateau: the objective on the validation vehicles, and whether it ended the attack.
struct PlateauReport {
  bool stopped = false;          ///< ended at the plateau; false: after all iterations
  std::vector<long> iterations;  ///< of the checks on validation vehicles, rising
  std::vector<double> values;    ///< the objective then
  long best_iteration = 0;       ///< of the lowest value
  double best = 0;               ///< that value
  long kept_iteration = 0;       ///< of the mesh that was written
  std::size_t vehicles = 0;      ///< held out
  std::size_t frames = 0;        ///< frames of these vehicles
  int steps = 0, every = 0;      ///< AttackSettings::until_plateau, validation_every
};

template <class Visitor, FieldsOf<PlateauReport> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "stopped", s.stopped, "iterations", s.iterations, "values", s.values, "best_iteration",
              s.best_iteration, "best", s.best, "kept_iteration", s.kept_iteration, "vehicles", s.vehicles,
              "frames", s.frames, "steps", s.steps, "every", s.every);
}

/// With AttackSearch::automatic: starts, candidates and search (attack/portfolio.h). `held_out`: the
/// objective on the validation vehicles.
struct AutoReport {
  /// A mesh that candidates may start from.
  struct Start {
    std::string name;
    double held_out = 0;
  };
  /// One attack of the portfolio.
  struct Candidate {
    std::string start;
    AttackTarget target = AttackTarget::both;
    double vertex_rate = 0, texel_rate = 0;
    std::uint64_t seed = 0;
    long steps = 0;
    int rounds = 0;           ///< rounds that it entered
    double held_out = 0;      ///< at its best look
    long kept_iteration = 0;  ///< iteration of that look
  };
  /// The gradient-free search of shapes.
  struct Search {
    int generations = 0;         ///< 0: no search
    std::size_t vehicles = 0;    ///< for judging each shape
    long steps = 0;              ///< cost of the search
    std::vector<double> values;  ///< of the shapes, in their order
  };
  std::vector<Candidate> candidates;
  std::size_t chosen = 0;  ///< index into candidates
  std::vector<Start> starts;
  Search search;
  std::size_t vehicles = 0;  ///< held out
  long steps = 0;            ///< spent in all
};

template <class Visitor, FieldsOf<AutoReport::Start> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "start", s.name, "held_out", s.held_out);
}
template <class Visitor, FieldsOf<AutoReport::Candidate> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "start", s.start, "target", s.target, "vertex_rate", s.vertex_rate, "texel_rate",
              s.texel_rate, "seed", s.seed, "steps", s.steps, "rounds", s.rounds, "held_out", s.held_out,
              "kept_iteration", s.kept_iteration);
}
template <class Visitor, FieldsOf<AutoReport::Search> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "generations", s.generations, "vehicles", s.vehicles, "steps", s.steps, "values",
              s.values);
  visit.derived("shapes", s.values.size());
}
template <class Visitor, FieldsOf<AutoReport> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "candidates", s.candidates, "chosen", s.chosen, "starts", s.starts, "search", s.search,
              "vehicles", s.vehicles, "steps", s.steps);
}

/// With AttackSearch::black_box: the search and its cost (attack/black_box.h).
struct BlackBoxReport {
  std::size_t vehicles = 0;  ///< in the search's sample
  long queries = 0;          ///< passes of the detector with the object, in all
  std::size_t numbers = 0;   ///< parameters of a mesh
  int samples = 0;           ///< meshes a generation
  long generations = 0;
  /// A mesh that the search may start from.
  struct Start {
    std::string name;
    double loss = 0;  ///< the objective on the search's vehicles
  };
  std::vector<Start> starts;
  std::string start;  ///< name of the start that was used
  double loss = 0;    ///< of the mesh that was written, on the same vehicles
};
template <class Visitor, FieldsOf<BlackBoxReport::Start> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "start", s.name, "loss", s.loss);
}
template <class Visitor, FieldsOf<BlackBoxReport> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "vehicles", s.vehicles, "queries", s.queries, "numbers", s.numbers, "samples", s.samples,
              "generations", s.generations, "starts", s.starts, "start", s.start, "loss", s.loss);
}

/// Result of this process and of the run that it resumed.
struct AttackResult {
  AttackSearch attack = AttackSearch::plain;
  int vehicles_train = 0, vehicles_test = 0, iterations = 0;
  long steps = 0;   ///< done by this process: 0 for a finished run
  double loss = 0;  ///< mean of the last tenth of the iterations
  double seconds_per_iteration = 0;
  CleanPerformance found_clean;             ///< of the training vehicles
  ClusterCount clusters;                    ///< of the vehicles held back
  RoofCount rooftops;                       ///< of the vehicles of both splits
  PlaceChoice placement;                    ///< of the object
  SkippedHosts left_out;                    ///< by the placement, in both splits
  BuildableReport buildable;                ///< of the adversary
  nlohmann::json stages;                    ///< where this process's time went (attack/observation.h)
  std::optional<PlateauReport> plateau;     ///< of a plain attack with until_plateau
  std::optional<AutoReport> automatic;      ///< with AttackSearch::automatic
  std::optional<BlackBoxReport> black_box;  ///< with AttackSearch::black_box
};

/// result.json of an attack: {attack, vehicles_train, vehicles_test, clusters, found_clean, rooftops,
/// iterations, loss, seconds_per_iteration, stages, placement, placed: to_json(PlaceChoice), left_out,
/// buildable, plateau (null without one), auto?, black_box?}
nlohmann::json to_json(const AttackResult& result);

}  // namespace mirage
