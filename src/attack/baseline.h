// What a learned mesh is compared with. An object on a roof disturbs a detector by being there at all, and
// the more the larger it is; these separate that from what was learned:
//     start       a random mesh around the attack's start, 0.75 of the box (Tu et al.'s random baseline, and
//                 the run's random.glb): smaller than a learned mesh may become
//     sized       a random mesh with exactly the learned one's extents and centre along each axis: what is
//                 left above it ("net") is not size
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

/// See above.
enum class Baseline { start, sized, ellipsoid, cuboid };
constexpr auto words_of(Baseline) {
  return std::to_array<const char*>({"start", "sized", "ellipsoid", "cuboid"});
}
/// "random mesh", "random mesh of its size", …
std::string describe(Baseline kind);
/// Words separated by commas, "all" or "none". FieldError naming baseline for any other word.
std::vector<Baseline> parse_baselines(const std::string& words);

/// `count` meshes of the kind, by the seeds run.seed, run.seed + 1, …; those of a buildable run are
/// buildable.
std::vector<TexturedMesh> baseline_meshes(const Run& run, Baseline kind, int count);

/// Ellipsoid or cuboid that fills the box, mid-grey; with `buildable` on, a buildable one.
TexturedMesh filling_shape(Baseline kind, const AdversaryLimits& limits, const BuildableSettings& buildable);

/// Moves and stretches the mesh along each axis so that its bounds are exactly `target`. Axes along which it
/// has no extent are only moved.
void fit_bounds(Mesh& mesh, const Eigen::AlignedBox3d& target);

/// Connected patches of faces, each of one random colour; at least one, at most a patch a face.
void paint_patches(TexturedMesh& mesh, int patches, std::uint64_t seed);

}  // namespace mirage
