// What searches of several meshes have in common (`--attack auto` and `black-box`): what they refuse, where
// they start, and the vehicles that a mesh is judged on.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "attack/attack_step.h"

namespace mirage {

/// Of how many vehicles a mesh is judged, if there are so many.
inline constexpr std::size_t kSearchHosts = 24;

/// FieldError for settings that do not go with --attack auto or black-box; none for a plain attack.
void check_search(const AttackSettings& settings);

/// What a search needs of a run that is set up (attack.cpp).
struct SearchRun {
  const AttackSettings& settings;
  const DetectorPool& detectors;
  FrameStore& store;
  const std::vector<Host>& train;
  std::shared_ptr<CleanSights> sights;
  RunIdentity identity;
};
/// A mesh to start from.
struct NamedStart {
  std::string name;
  TexturedMesh mesh;
  double value = 0;  ///< the objective of it as it is
};
/// The paper's and, where a shape is learned, an ellipsoid and a cuboid that fill the box.
std::vector<NamedStart> search_starts(const AttackSettings& settings);
/// Whether vertices move one by one.
bool learns_shape(const AttackSettings& settings);

/// kSearchHosts of them at most, drawn by seed.
std::vector<Host> search_hosts(std::vector<Host> hosts, std::uint64_t seed);

}  // namespace mirage
