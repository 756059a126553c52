// The part of the LiDAR's derivative that lies in what it sees at all. A ray's return moves with the face
// that it meets (simulation/adversary_lidar.h); that it comes from the object, and no longer from what is
// behind it, is decided where the object's silhouette passes the ray, and there the derivative of a sweep is
// none.
//
// The derivative here is that of the mean over all places of the unit's raster, each laser and firing moved
// by up to half a pitch: what a vehicle meets that comes by twice. By Reynolds' theorem it is the inner part,
// as adversary_lidar.h has it, and an integral over the silhouette: rays gained for each metre that it moves,
// times what a ray changes that ends on it and no longer behind it (for pictures: Li et al., "Differentiable
// Monte Carlo Ray Tracing through Edge Sampling", SIGGRAPH Asia 2018). The integral is taken at points half a
// pitch apart or closer.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "geometry/mesh.h"
#include "simulation/simulation.h"

namespace mirage {

/// Points on the silhouette, as the unit sees it.
struct LidarSilhouette {
  struct Sample {
    std::array<int, 2> vertices;  ///< of the edge
    double share = 0;             ///< of the second vertex in the point
    /// Rays that the object gains for each metre that the point moves along it (`velo`, 1/m).
    Vec3d gain = Vec3d::Zero();
    int near = 0;     ///< place where a return appears when a ray is gained
    int behind = -1;  ///< and where one goes: the scene's or the object's own; −1: none was there
  };
  std::vector<Sample> samples;
  /// Places where a return may come or go, `velo`; what a detector is asked about (SensorView::watched).
  std::vector<LidarPoint> places;
};

/// The silhouette of `placed` (`velo`) where the unit fires at it, nothing of the scene is in front of it,
/// and no other part of the object. Rays are as without LidarEffects. Empty for a unit of one laser.
LidarSilhouette lidar_silhouette(const PreparedFrame& prepared, const TexturedMesh& placed);

/// Adds d loss / d placed vertices (`velo`). `presence`: d loss / d number of returns at each place.
template <class S>
void lidar_silhouette_vjp(const LidarSilhouette& silhouette, std::span<const S> presence,
                          std::vector<Vec3d>& d_vertices);

}  // namespace mirage
