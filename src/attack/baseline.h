// Baseline meshes, the controls of a learned mesh. Any object on a roof disturbs a detector, and a larger one
// more. These separate that effect from the learned one:
//     start       a random mesh around the attack's start, 0.75 of the box (Tu et al.'s random baseline, and
//                 the run's random.glb): smaller than a learned mesh may become
//     sized       a random mesh with exactly the learned mesh's extents and centre along each axis: an effect
//                 above it ("net") is not due to size
//     ellipsoid   an ellipsoid that fills the box
//     cuboid      a cuboid that fills the box: no mesh is larger
// The last three are painted with random patches: texels drawn one by one would average to grey at 20 m.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "attack/run.h"
#include "geometry/mesh.h"

namespace mirage {

/// The kinds of baseline listed above.
enum class Baseline { start, sized, ellipsoid, cuboid };
constexpr auto words_of(Baseline) {
  return std::to_array<const char*>({"start", "sized", "ellipsoid", "cuboid"});
}
/// "random mesh", "random mesh of its size", …
std::string describe(Baseline kind);
/// Words separated by commas, "all" or "none". FieldError naming baseline for any other word.
std::vector<Baseline> parse_baselines(const std::string& words);

/// `count` meshes of the kind, with seeds run.seed, run.seed + 1, …; buildable if the run is.
std::vector<TexturedMesh> baseline_meshes(const Run& run, Baseline kind, int count);

/// Mid-grey ellipsoid or cuboid that fills the box; buildable if `buildable` is on.
TexturedMesh filling_shape(Baseline kind, const AdversaryLimits& limits, const BuildableSettings& buildable);

/// Moves and stretches the mesh along each axis so that its bounds are exactly `target`. Along axes where it
/// has no extent, it is only moved.
void fit_bounds(Mesh& mesh, const Eigen::AlignedBox3d& target);

/// Paints connected patches of faces, each in one random colour; at least one patch, at most one a face.
void paint_patches(TexturedMesh& mesh, int patches, std::uint64_t seed);

}  // namespace mirage
