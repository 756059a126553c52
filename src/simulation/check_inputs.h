// Checks of the simulation's inputs: a number that is not finite would spread into every pixel, point and
// gradient that it touches. Each check throws one InputError that names the input.
#pragma once

#include "simulation/placement.h"
#include "simulation/sensor_pass.h"
#include "simulation/simulation.h"

namespace mirage {

/// Photograph (finite, of the calibration's size), sweep, calibration, labels (DontCare has no box),
/// lighting.
void check_frame(const Frame& frame);
/// Beams (at least one), steps and limits.
void check_lidar(const LidarModel& lidar);
/// The pose and the carrier's box.
void check_placement(const Placement& placement);
/// A mesh with faces and texels, of any size. InputError naming `where`.
void check_textured(const TexturedMesh& object, const std::string& where);
/// A user's object for a roof: a mesh with faces and texels, kMinObject to kMaxObject long, within 2 m of its
/// origin, which is set on the roof. InputError naming `where`, with the size and a guess at its unit.
void check_object(const TexturedMesh& object, const std::string& where);
/// Warns, naming `where`, of an object (extents, m) that is longer than any car's roof.
void warn_of_large_object(const Vec3d& size, const std::string& where);
/// The window of a camera's photograph and of its depth, which must be of the image's size; +∞ is a depth.
void check_window(const PreparedFrame& prepared, std::size_t camera, const PixelRect& rect);
/// Everything but raster.near and far, which simulate() sets itself.
void check_settings(const SimulationSettings& settings);
/// Sizes of the upstream gradients and the values that simulate_vjp reads: the window's pixels and the new
/// returns. Failure for a number that is not finite: it comes from a detector, not from the user's files.
void check_upstream(const Simulated& simulated, const Upstream& upstream);

}  // namespace mirage
