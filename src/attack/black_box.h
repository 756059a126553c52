// `mirage attack --attack black-box`: a mesh learned from a detector's scores alone.
//
//   1. Starts. The paper's ellipsoid, and an ellipsoid and a cuboid filling the box, are judged on a fixed
//      sample of the training vehicles; the best goes on.
//   2. Search. Its size, warp and colours by few numbers, by an evolution strategy. The meshes of a
//      generation are judged on the same `batch` vehicles of the sample, those of the next on others
//      (attack/attack_hosts.h). The objective is that of the gradient attack.
//   3. Where the strategy has arrived is judged on the whole sample, and is kept if it is better than the
//      start.
//
// A query is a pass of the detector over a frame with the object. The number asked for is never exceeded;
// what is less than a generation is left.
//
//     OUT/checkpoint.json  identity, and losses of each mesh looked at; the strategy is restored by them
//     OUT/loss.csv         a row a mesh
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "attack/adversary.h"
#include "attack/attack_result.h"
#include "attack/attack_settings.h"
#include "attack/attack_step.h"

namespace mirage {

// What searches of several meshes have in common (`--attack auto` and `black-box`): what they refuse, where
// they start, and the vehicles that a mesh is judged on.

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
  std::shared_ptr<CleanDetectionCache> clean_cache;
  RunIdentity identity;
};
/// What came of a search.
struct SearchOutcome {
  AttackState state;          ///< its mesh the learned one
  StepTimings stages;         ///< of this process
  long steps = 0, first = 0;  ///< in all, and before this process
  std::optional<AutoReport> automatic;
  std::optional<BlackBoxReport> black_box;
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

/// Whether the object's colours reach what is attacked: a picture or a sensor beside it that the detector
/// reads and `target` includes, or returns whose reflectance is the colour's (LidarEffects::albedo).
bool sees_colours(const AttackSettings& settings, const Capabilities& can);

/// kSearchHosts of them at most, drawn by seed.
std::vector<Host> search_hosts(std::vector<Host> hosts, std::uint64_t seed);

// The lowest of a function of many numbers, given its values alone: CMA-ES (Hansen, "The CMA Evolution
// Strategy: A Tutorial", arXiv 1604.00772), by pagmo.

/// Numbers are drawn a generation at a time from a normal distribution, which moves to the better half of
/// them and takes their spread. Draws depend only on the seed and the values added: adding the same values
/// again restores a search.
class Evolution {
 public:
  /// From zero, with standard deviation 1 at first; ≥ 5 `samples` a generation.
  Evolution(std::size_t numbers, int samples, std::uint64_t seed);
  ~Evolution();
  /// The point at which to evaluate the function next.
  const std::vector<double>& next() const;
  /// Reports the function's value at next(); finite.
  void add(double value);
  /// The distribution's mean: the better half of the last whole generation, weighted by rank.
  const std::vector<double>& centre() const { return centre_; }

 private:
  struct Method;
  void draw();

  std::unique_ptr<Method> method_;
  std::vector<double> centre_, values_;  // values of this generation, so far
  std::vector<std::vector<double>> generation_;
};

// A mesh by few numbers: large changes of the whole, for a search without gradients.
//
// Modes are products of Legendre polynomials of u = x / half lengths of the box, of low total degree. A
// vertex of the start goes to
//     x' = exp(s) ∘ x + half ∘ Σ_k a_k P_k(u),
// clamped into the box, a texel at u to sigmoid(logit(start) + Σ_k c_k P_k(u)), each channel its own c_k. The
// mesh stays its own mirror image across the plane y = 0, as cars are: along x and z, and in colour, k runs
// over polynomials that are even in y, along y over odd ones. exp(s) stands for those that stretch an axis.

/// How numbers make a mesh of a start.
class MeshModes {
 public:
  /// `texture`: whether anything sees colours. `parts` says which numbers there are: size alone its three,
  /// shape those and the warp's, texture its own.
  MeshModes(const TexturedMesh& start, const AdversaryLimits& limits, AttackParts parts, bool texture);
  /// How many numbers.
  std::size_t size() const { return size_; }
  /// The start changed by `numbers` (size() of them), within the limits. Each is in units of what a search
  /// draws at first.
  TexturedMesh mesh(std::span<const double> numbers) const;

 private:
  TexturedMesh start_;
  AdversaryLimits limits_;
  bool sizes_, warps_, paints_;
  std::size_t size_ = 0;
  std::vector<std::array<std::vector<double>, 3>> warp_;  ///< of each vertex: the modes along x, y, z
  std::vector<std::vector<double>> paint_;                ///< of each texel: those of a colour
};

/// How queries are spent.
struct BlackBoxPlan {
  int samples = 0;  ///< meshes a generation
  long generations = 0;
};
/// For `starts` starts, `numbers` numbers that make a mesh, and a sample of `vehicles`. FieldError naming
/// queries if they are too few for a generation.
BlackBoxPlan black_box_plan(const AttackSettings& settings, std::size_t starts, std::size_t numbers,
                            std::size_t vehicles);

/// Writes run.json and the files above. The same bits however often it was stopped, on any number of
/// processes. Its steps are meshes looked at, and it has their losses.
SearchOutcome run_black_box(const SearchRun& run);

}  // namespace mirage
