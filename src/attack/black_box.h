// `mirage attack --attack black-box`: a mesh learned from a detector's scores alone.
//
//   1. Starts. The paper's ellipsoid, and an ellipsoid and a cuboid filling the box, are judged on a fixed
//      sample of the training vehicles; the best goes on.
//   2. Search. An evolution strategy varies the start's size, warp and colours by few parameters. All meshes
//      of a generation are judged on the same `batch` vehicles of the sample, the next generation on others
//      (attack/attack_hosts.h). The objective is that of the gradient attack.
//   3. The strategy's final mean is judged on the whole sample, and is kept if it is better than the start.
//
// A query is a pass of the detector over a frame with the object. The requested number is never exceeded; a
// remainder below one generation stays unused.
//
//     OUT/checkpoint.json  identity, and losses of each judged mesh; the strategy is restored from them
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

// Common parts of the searches over meshes (`--attack auto` and `black-box`): refused settings, starts, and
// the vehicles for judging a mesh.

/// Largest number of vehicles for judging a mesh.
inline constexpr std::size_t kSearchHosts = 24;

/// FieldError for settings that --attack auto or black-box does not support; no error for a plain attack.
void check_search(const AttackSettings& settings);

/// The parts of a prepared run that a search uses (attack.cpp).
struct SearchRun {
  const AttackSettings& settings;
  const DetectorPool& detectors;
  FrameStore& store;
  const std::vector<Host>& train;
  std::shared_ptr<CleanDetectionCache> clean_cache;
  RunIdentity identity;
};
/// Result of a search.
struct SearchOutcome {
  AttackState state;          ///< its mesh is the learned one
  StepTimings stages;         ///< of this process
  long steps = 0, first = 0;  ///< in total, and before this process
  std::optional<AutoReport> automatic;
  std::optional<BlackBoxReport> black_box;
};
/// A mesh to start from.
struct NamedStart {
  std::string name;
  TexturedMesh mesh;
  double value = 0;  ///< the objective of the unchanged mesh
};
/// The paper's start and, if a shape is learned, an ellipsoid and a cuboid that fill the box.
std::vector<NamedStart> search_starts(const AttackSettings& settings);
/// Whether vertices are learned one by one.
bool learns_shape(const AttackSettings& settings);

/// Whether the object's colours affect the target: through a picture or sensor that the detector reads and
/// `target` includes, or through returns whose reflectance follows the colour (LidarEffects::albedo).
bool sees_colours(const AttackSettings& settings, const Capabilities& can);

/// At most kSearchHosts of the hosts, drawn by seed.
std::vector<Host> search_hosts(std::vector<Host> hosts, std::uint64_t seed);

// Minimum of a function of many variables from its values alone: CMA-ES (Hansen, "The CMA Evolution Strategy:
// A Tutorial", arXiv 1604.00772), by pagmo.

/// CMA-ES draws a generation of points from a normal distribution, and moves mean and spread to the better
/// half. Draws depend only on the seed and the added values: adding the same values again restores a search.
class Evolution {
 public:
  /// Starts at zero with standard deviation 1; `samples` ≥ 5 a generation.
  Evolution(std::size_t numbers, int samples, std::uint64_t seed);
  ~Evolution();
  /// The point at which to evaluate the function next.
  const std::vector<double>& next() const;
  /// Reports the function's value at next(), which must be finite.
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

// A mesh by few parameters: large, global changes, for a search without gradients.
//
// Modes are products of Legendre polynomials of u = x / half lengths of the box, of low total degree. A
// vertex of the start goes to
//     x' = exp(s) ∘ x + half ∘ Σ_k a_k P_k(u),
// clamped into the box, a texel at u to sigmoid(logit(start) + Σ_k c_k P_k(u)), each channel its own c_k. The
// mesh stays symmetric about the plane y = 0, as cars are. Along x and z, and in colour, k runs over
// polynomials that are even in y; along y, over odd ones. exp(s) replaces the modes that stretch an axis.

/// Maps parameters to a mesh, relative to a start.
class MeshModes {
 public:
  /// `texture`: whether colours have any effect. `parts` selects the parameters: size has its three, shape
  /// has those and the warp's, texture has its own.
  MeshModes(const TexturedMesh& start, const AdversaryLimits& limits, AttackParts parts, bool texture);
  /// Number of parameters.
  std::size_t size() const { return size_; }
  /// The start changed by `numbers` (size() of them), within the limits. Each is in units of a search's
  /// initial standard deviation.
  TexturedMesh mesh(std::span<const double> numbers) const;

 private:
  TexturedMesh start_;
  AdversaryLimits limits_;
  bool sizes_, warps_, paints_;
  std::size_t size_ = 0;
  std::vector<std::array<std::vector<double>, 3>> warp_;  ///< per vertex: modes along x, y, z
  std::vector<std::vector<double>> paint_;                ///< per texel: modes of a colour
};

/// The split of the queries.
struct BlackBoxPlan {
  int samples = 0;  ///< meshes in a generation
  long generations = 0;
};
/// Plan for `starts` starts, `numbers` parameters of a mesh, and a sample of `vehicles`. FieldError naming
/// queries if they are too few for one generation.
BlackBoxPlan black_box_plan(const AttackSettings& settings, std::size_t starts, std::size_t numbers,
                            std::size_t vehicles);

/// Writes run.json and the files above. Returns the same bits however often the run was stopped, on any
/// number of processes. `steps` counts judged meshes, and the state has their losses.
SearchOutcome run_black_box(const SearchRun& run);

}  // namespace mirage
