// The attack's state between two iterations, and its file.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <vector>

#include "attack/adversary.h"
#include "attack/attack.h"

namespace mirage {

/// More than any machine does; also the most that --iterations takes.
inline constexpr long kMostIterations = 1'000'000'000;

/// Loss terms of one iteration, means over its hosts.
struct LossRow {
  double hide = 0, false_positive = 0, laplacian = 0;
  int hidden = -1;  ///< hosts that no proposal found (HostStep); −1 where an older checkpoint did not say
  double loss() const { return hide + false_positive + laplacian; }
};

struct AttackState {
  long iteration = 0;
  TexturedMesh adversary;
  Adam vertices, texels;
  std::vector<LossRow> losses;
};

AttackState fresh_state(const AttackSettings& settings);
/// Atomic. Doubles are written so that they read back bit for bit.
void write_checkpoint(const std::filesystem::path& file, const AttackState& state,
                      const nlohmann::json& identity);
/// InputError when the file is damaged, holds what no run can reach (numbers that are not finite, a mesh
/// outside its box, more steps than rows of losses) or belongs to a run with other settings: the field is
/// named.
AttackState read_checkpoint(const std::filesystem::path& file, const nlohmann::json& identity);

}  // namespace mirage
