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
  int found = 0, hidden = 0;  ///< hosts found as recorded, and of them those hidden (HostStep)
  /// The objective: the sum of its terms.
  double loss() const { return hide + false_positive + laplacian; }
};

/// What --until-plateau remembers: the objective on vehicles that are not learned on, and the mesh with the
/// lowest.
struct HeldOutRecord {
  std::vector<long> iterations;  ///< after how many steps; rising
  std::vector<double> values;    ///< the objective then
  long best_iteration = -1;      ///< of the lowest value, the first of equal ones; −1 before any
  double best = 0;               ///< that value
  TexturedMesh mesh;             ///< as it was then

  /// Adds a value; keeps the mesh if it is lower than all before.
  void add(long iteration, double value, const TexturedMesh& adversary);
  /// Whether the last check found that `steps` steps have brought nothing.
  bool plateau(int steps) const;
};

/// What an attack goes on from.
struct AttackState {
  long iteration = 0;
  TexturedMesh adversary;
  Adam vertices, texels;
  std::vector<LossRow> losses;
  HeldOutRecord held_out;
  RenderedMesh rendered;  ///< with AttackSettings::renderer: what the pictures at hand are of
};

/// Before the first iteration: the initial adversary and optimisers with the settings' rates.
AttackState fresh_state(const AttackSettings& settings);
/// Failure unless all processes found as many steps in the file: `what` they see ("checkpoints", "files").
void require_one_file(const std::filesystem::path& file, long steps, const char* what);
/// Atomic. Doubles are written so that they read back bit for bit.
void write_checkpoint(const std::filesystem::path& file, const AttackState& state,
                      const nlohmann::json& identity);
/// {losses, hidden, found} of rows, as a checkpoint has them, and back: `count` rows.
nlohmann::json losses_json(const std::vector<LossRow>& rows);
/// The rows that losses_json wrote. InputError naming file and field for any other length or number.
std::vector<LossRow> read_losses(const JsonFields& json, std::size_t count);
/// The file loss.csv (attack/run.h). Atomic.
void write_losses(const std::filesystem::path& file, const std::vector<LossRow>& rows);
/// InputError naming the first setting in which the identity `written` in the file differs from that asked
/// for.
void check_identity(const std::filesystem::path& file, nlohmann::json written, const RunIdentity& expected);
/// InputError when the file is damaged, holds what no run can reach (numbers that are not finite, a mesh
/// outside its box, more steps than rows of losses) or belongs to a run with another identity: the field is
/// named. `settings`: the run's.
AttackState read_checkpoint(const std::filesystem::path& file, const RunIdentity& identity,
                            const AttackSettings& settings);
/// The same of a run that starts from `start`: its faces, and as many vertices and texels.
AttackState read_checkpoint(const std::filesystem::path& file, const RunIdentity& identity,
                            const AttackSettings& settings, const TexturedMesh& start);

}  // namespace mirage
