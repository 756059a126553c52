// The placed adversary as the LiDAR sees it: which rays of the measured sweep meet it, what comes back, and
// the VJP of that.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "geometry/mesh.h"
#include "sensors/lidar_return.h"
#include "simulation/simulation.h"

namespace mirage {

/// The returns on the adversary.
struct LidarTape {
  /// One ray of a beam that met the adversary; its share of the return's reflectance is `weight`.
  struct Part {
    Vec3d direction;  ///< in `velo` of the sweep's moment 0, where the adversary is placed
    int face = 0;
    FaceReturn<double> hit;
    double weight = 1;
    double reflectivity = 0;
    int texel = -1;  ///< whose mean is the reflectivity; −1: a constant
  };
  /// One return on the adversary, and what its VJP needs.
  struct Return {
    LidarRay ray;  ///< the beam's axis, in the frame that the point is written in
    int face = 0;  ///< of the strongest part, and its hit; hit.reflectance is the whole return's
    FaceReturn<double> hit;
    double range = 0;  ///< reported: hit.range and its noise
    int beam = 0, firing = -1;
    int first = 0, count = 1, strongest = 0;  ///< parts
  };
  std::vector<Return> returns;
  std::vector<Part> parts;
  std::size_t first = 0;  ///< index of the first new return in the simulated sweep
};

/// Traces the rays that can hit `placed` and merges the returns; fills sweep and the point counts.
LidarTape draw_in_lidar(const PreparedFrame& prepared, const TexturedMesh& placed,
                        const SimulationSettings& settings, Simulated& result);
/// Adds d loss / d placed vertices (`velo`), and d loss / d texels where reflectance comes from the albedo.
/// The derivative holds the choices fixed: which face a ray meets, what is hidden or lost, which echo is
/// strongest.
template <class S>
void draw_in_lidar_vjp(const LidarTape& tape, const TexturedMesh& placed, const SimulationSettings& settings,
                       std::span<const std::array<S, 4>> d_points, std::vector<Vec3d>& d_vertices,
                       std::vector<Vec3d>& d_texels);
/// The same for points as Simulated has them.
inline void draw_in_lidar_vjp(const LidarTape& tape, const TexturedMesh& placed,
                              const SimulationSettings& settings,
                              const std::vector<std::array<float, 4>>& d_points,
                              std::vector<Vec3d>& d_vertices, std::vector<Vec3d>& d_texels) {
  draw_in_lidar_vjp<float>(tape, placed, settings, d_points, d_vertices, d_texels);
}

}  // namespace mirage
