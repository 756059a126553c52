// What an attack ends with, beside the files in its folder.
#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "attack/attack_settings.h"
#include "attack/buildable.h"
#include "attack/clean_sights.h"
#include "base/intervals.h"
#include "frames/hosts.h"

namespace mirage {

/// With until_plateau: the objective on vehicles held out, and whether it ended the attack.
struct PlateauReport {
  bool stopped = false;          ///< at the plateau; false: after all iterations
  std::vector<long> iterations;  ///< at which the vehicles held out were looked at, rising
  std::vector<double> values;    ///< the objective then
  long best_iteration = 0;       ///< of the lowest value
  double best = 0;               ///< that value
  long kept_iteration = 0;       ///< of the mesh that was written
  std::size_t vehicles = 0;      ///< held out
  std::size_t frames = 0;        ///< that these stand in
  int steps = 0, every = 0;      ///< AttackSettings::until_plateau, validation_every
};

/// {stopped, best_iteration, best, kept_iteration, vehicles, frames, steps, every, iterations, values}
nlohmann::json to_json(const PlateauReport& report);

/// With AttackSearch::automatic: what was tried (attack/portfolio.h). `held_out`: the objective on the
/// vehicles held out.
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
    int rounds = 0;           ///< taken part in
    double held_out = 0;      ///< at its best look
    long kept_iteration = 0;  ///< of that look
  };
  /// Of shapes, without gradients.
  struct Search {
    int generations = 0;         ///< 0: there was none
    std::size_t vehicles = 0;    ///< that each shape was judged on
    long steps = 0;              ///< that it cost
    std::vector<double> values;  ///< of the shapes, in their order
  };
  std::vector<Candidate> candidates;
  std::size_t chosen = 0;  ///< its place among them
  std::vector<Start> starts;
  Search search;
  std::size_t vehicles = 0;  ///< held out
  long steps = 0;            ///< spent in all
};

/// {candidates: [{start, target, vertex_rate, texel_rate, seed, steps, rounds, held_out, kept_iteration}],
/// chosen, starts: [{start, held_out}], search: {generations, shapes, vehicles, steps, values}, vehicles,
/// steps}
nlohmann::json to_json(const AutoReport& report);

/// With AttackSearch::black_box: what was looked at (attack/black_box.h).
struct BlackBoxReport {
  std::size_t vehicles = 0;  ///< that the search looked at
  long queries = 0;          ///< passes of the detector with the object, in all
  std::size_t numbers = 0;   ///< that make a mesh
  int samples = 0;           ///< meshes a generation
  long generations = 0;
  std::vector<AutoReport::Start> starts;  ///< `held_out`: the objective on the vehicles that it looks at
  std::string start;                      ///< the one searched from
  double loss = 0;                        ///< of the mesh that was written, on the same vehicles
};

/// {vehicles, queries, numbers, samples, generations, starts: [{start, loss}], start, loss}
nlohmann::json to_json(const BlackBoxReport& report);

/// Of this process and the run that it went on with.
struct AttackResult {
  AttackSearch attack = AttackSearch::plain;
  int vehicles_train = 0, vehicles_test = 0, iterations = 0;
  long steps = 0;   ///< of these, by this process: 0 of a run that was finished
  double loss = 0;  ///< mean of the last tenth of the iterations
  double seconds_per_iteration = 0;
  FoundClean found_clean;                   ///< of the training vehicles
  ClusterCount clusters;                    ///< of the vehicles held back
  RoofCount rooftops;                       ///< of the vehicles of both splits
  PlaceChoice placement;                    ///< of the object
  HostsLeftOut left_out;                    ///< by the placement, in both splits
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
