// The placed adversary as the LiDAR sees it: which rays of the measured sweep meet it, what comes back, and
// the VJP of that.
#pragma once

#include <array>
#include <vector>

#include "geometry/mesh.h"
#include "sensors/lidar_model.h"
#include "simulation/simulation.h"

namespace mirage {

/// The returns on the adversary.
struct LidarTape {
  /// One ray of a beam that met the adversary; its share of the return's reflectance is `weight`.
  struct BeamSample {
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
  std::vector<BeamSample> parts;
  std::size_t first = 0;  ///< index of the first new return in the simulated sweep
};

/// Traces the rays that can hit `placed` and merges the returns; fills sweep and the point counts.
LidarTape draw_in_lidar(const PreparedFrame& prepared, const TexturedMesh& placed,
                        const SimulationSettings& settings, Simulated& result);
/// Adds d loss / d placed vertices (`velo`), and d loss / d texels where reflectance comes from the albedo.
/// The derivative holds the choices fixed: which face a ray meets, what is hidden or lost, which echo is
/// strongest.
/// `d_points`: one a point of the simulated sweep, of which the new returns' are read.
void draw_in_lidar_vjp(const LidarTape& tape, const TexturedMesh& placed, const SimulationSettings& settings,
                       const GradientView& d_points, std::vector<Vec3d>& d_vertices,
                       std::vector<Vec3d>& d_texels);

// The part of the LiDAR's derivative that lies in what it sees at all. A ray's return moves with the face
// that it meets; that it comes from the object, and no longer from what is behind it, is decided where the
// object's silhouette passes the ray, and there the derivative of a sweep is none.
//
// The derivative here is that of the mean over all places of the unit's raster, each laser and firing moved
// by up to half a pitch: what a vehicle meets that comes by twice. By Reynolds' theorem it is the inner part,
// as above, and an integral over the silhouette: rays gained for each metre that it moves,
// times what a ray changes that ends on it and no longer behind it (for pictures: Li et al., "Differentiable
// Monte Carlo Ray Tracing through Edge Sampling", SIGGRAPH Asia 2018). The integral is taken at points half a
// pitch apart or closer.

/// Points on the silhouette, as the unit sees it.
struct LidarSilhouette {
  /// A point that stands for a part of a silhouette's edge.
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
void lidar_silhouette_vjp(const LidarSilhouette& silhouette, const GradientView& presence,
                          std::vector<Vec3d>& d_vertices);

}  // namespace mirage
