// The placed adversary as the LiDAR sees it: the rays of the measured sweep that meet it, their returns, and
// the VJP.
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
    int texel = -1;  ///< its mean is the reflectivity; −1: a constant
  };
  /// One return on the adversary, with the values that its VJP needs.
  struct Return {
    LidarRay ray;  ///< the beam's axis, in the frame that the point is written in
    int face = 0;  ///< of the strongest part, as `hit`; hit.reflectance is the whole return's
    FaceReturn<double> hit;
    double range = 0;  ///< as reported: hit.range plus noise
    int beam = 0, firing = -1;
    int first = 0, count = 1, strongest = 0;  ///< parts
  };
  std::vector<Return> returns;
  std::vector<BeamSample> parts;
  std::size_t first = 0;  ///< index of the first new return in the simulated sweep
};

/// Traces the rays that can hit `placed`, merges their returns into result.sweep and fills the point counts.
LidarTape draw_in_lidar(const PreparedFrame& prepared, const TexturedMesh& placed,
                        const SimulationSettings& settings, Simulated& result);
/// Adds d loss / d placed vertices (`velo`), and d loss / d texels where reflectance comes from the albedo.
/// Discrete choices are held fixed: the face that a ray meets, hidden and lost returns, the strongest echo.
/// `d_points`: one for each point of the simulated sweep; only those of the new returns are read.
void draw_in_lidar_vjp(const LidarTape& tape, const TexturedMesh& placed, const SimulationSettings& settings,
                       const GradientView& d_points, std::vector<Vec3d>& d_vertices,
                       std::vector<Vec3d>& d_texels);

// The part of the LiDAR's derivative that visibility causes. A ray's return moves with the face that it
// meets. Whether the ray meets the object or the scene behind it changes when the object's silhouette passes
// the ray. A single sweep has no derivative there.
//
// The derivative here is that of the mean over all positions of the unit's raster, each laser and firing
// moved by up to half a pitch, as between two passes of a vehicle. By Reynolds' theorem it is the inner part,
// as above, plus an integral over the silhouette: rays gained for each metre that it moves, times the change
// of the loss when a ray ends on the object instead of behind it (for pictures: Li et al., "Differentiable
// Monte Carlo Ray Tracing through Edge Sampling", SIGGRAPH Asia 2018). The integral is taken at points half a
// pitch apart or closer.

/// Points on the silhouette, as the unit sees it.
struct LidarSilhouette {
  /// A point that represents a part of a silhouette edge.
  struct Sample {
    std::array<int, 2> vertices;  ///< of the edge
    double share = 0;             ///< weight of the second vertex in the point
    /// Rays that the object gains for each metre that the point moves along it (`velo`, 1/m).
    Vec3d gain = Vec3d::Zero();
    int near = 0;     ///< index of the place where a return appears when a ray is gained
    int behind = -1;  ///< index of the place where one vanishes, on scene or object; −1: none
  };
  std::vector<Sample> samples;
  /// Places where a return may appear or vanish, `velo`: SensorView::watched of a detector.
  std::vector<LidarPoint> places;
};

/// The silhouette of `placed` (`velo`) where the unit fires at it and neither the scene nor another part of
/// the object is in front of it. Rays ignore LidarEffects. Empty for a unit of one laser.
LidarSilhouette lidar_silhouette(const PreparedFrame& prepared, const TexturedMesh& placed);

/// Adds d loss / d placed vertices (`velo`). `presence`: d loss / d number of returns at each place.
void lidar_silhouette_vjp(const LidarSilhouette& silhouette, const GradientView& presence,
                          std::vector<Vec3d>& d_vertices);

}  // namespace mirage
