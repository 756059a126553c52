// The attack's state between two iterations, and its file.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <vector>

#include "attack/adversary.h"
#include "attack/attack_settings.h"
#include "attack/observation.h"
#include "base/json_fields.h"

namespace mirage {

/// Loss terms of one iteration, means over its hosts.
struct LossRow {
  double hide = 0, false_positive = 0, laplacian = 0;
  int found = 0, hidden = 0;  ///< hosts found as recorded; those of them hidden (HostStep)
  /// The objective: the sum of the loss terms.
  double loss() const { return hide + false_positive + laplacian; }
};

/// State of --until-plateau: the objective on the validation vehicles, and the mesh with the lowest value.
struct HeldOutRecord {
  std::vector<long> iterations;  ///< steps before each check; rising
  std::vector<double> values;    ///< the objective then
  long best_iteration = -1;      ///< of the lowest value, the first of equal ones; −1 before any check
  double best = 0;               ///< that value
  TexturedMesh mesh;             ///< mesh at best_iteration

  /// Adds a value; keeps the mesh if it is lower than all before.
  void add(long iteration, double value, const TexturedMesh& adversary);
  /// Whether the last check came `steps` or more steps after the best one.
  bool plateau(int steps) const;
};

/// The resumable state of an attack.
struct AttackState {
  long iteration = 0;
  TexturedMesh adversary;
  Adam vertices, texels;
  std::vector<LossRow> losses;
  HeldOutRecord held_out;
  RenderedMesh rendered;  ///< with AttackSettings::renderer: the mesh drawn last
};

/// The state before the first iteration: the initial adversary, and optimisers with the settings' rates.
AttackState fresh_state(const AttackSettings& settings);
/// Failure unless all processes read the same number of steps from the file. `what`: the files' name in the
/// message ("checkpoints", "files").
void require_one_file(const std::filesystem::path& file, long steps, const char* what);
/// Writes the file atomically. Doubles read back bit for bit.
void write_checkpoint(const std::filesystem::path& file, const AttackState& state,
                      const nlohmann::json& identity);
/// {losses, hidden, found} of the rows, as in a checkpoint.
nlohmann::json losses_json(const std::vector<LossRow>& rows);
/// Inverse of losses_json, for `count` rows. InputError naming file and field for any other length or number.
std::vector<LossRow> read_losses(const JsonFields& json, std::size_t count);
/// The file loss.csv (attack/run.h). Atomic.
void write_losses(const std::filesystem::path& file, const std::vector<LossRow>& rows);
/// InputError naming the first setting in which the file's identity `written` differs from `expected`.
void check_identity(const std::filesystem::path& file, nlohmann::json written, const RunIdentity& expected);
/// InputError naming the field if the file is damaged, belongs to a run with another identity, or holds an
/// impossible state (numbers that are not finite, a mesh outside its box, more steps than rows of losses).
/// `settings`: those of the run.
AttackState read_checkpoint(const std::filesystem::path& file, const RunIdentity& identity,
                            const AttackSettings& settings);
/// The same for a run that starts from `start`: the mesh has its faces, and as many vertices and texels.
AttackState read_checkpoint(const std::filesystem::path& file, const RunIdentity& identity,
                            const AttackSettings& settings, const TexturedMesh& start);

}  // namespace mirage
