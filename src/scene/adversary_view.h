// The placed adversary as each sensor draws it; the pieces that insertion.h composes.
#pragma once

#include <array>
#include <vector>

#include "geometry/mesh.h"
#include "scene/insertion.h"
#include "sensors/lidar_return.h"

namespace mirage {

/// Camera side: what was rasterised, and what its VJP needs.
struct CameraTape {
  std::vector<Vec3d> p_camera;  ///< vertices
  std::vector<Vec3d> normals;   ///< unnormalised face normals, `velo`
  std::vector<Vec3d> light;     ///< light factor of each face
  ScreenMesh<double> screen;
  SoftRasterSettings<double> settings;
  RasterTarget<double> target;  ///< on the supersampled grid
  int supersampling = 1;
};

/// LiDAR side: the returns on the adversary.
struct LidarTape {
  struct Return {
    LidarRay ray;
    int face = 0;
    FaceReturn<double> hit;
  };
  std::vector<Return> returns;
  std::size_t first = 0;  ///< index of the first new return in the simulated sweep
};

/// Projects, shades and rasterises `placed` (in `velo`) into the photograph; fills image, rect, rgba,
/// visible_share and adversary_pixels.
CameraTape draw_in_camera(const PreparedFrame& prepared, const Label& host, const TexturedMesh& placed,
                          const SimulationSettings& settings, Simulated& result);
/// Adds d loss / d placed vertices (`velo`) and d loss / d texels.
void draw_in_camera_vjp(const CameraTape& tape, const TexturedMesh& placed, const Calibration& calibration,
                        const Lighting& lighting, const Simulated& result, const ImageF& d_image,
                        std::vector<Vec3d>& d_vertices, std::vector<Vec3d>& d_texels);

/// Traces the rays that can hit `placed` and merges the returns; fills sweep and the point counts.
LidarTape draw_in_lidar(const PreparedFrame& prepared, const TexturedMesh& placed,
                        const SimulationSettings& settings, Simulated& result);
/// Adds d loss / d placed vertices (`velo`).
void draw_in_lidar_vjp(const LidarTape& tape, const TexturedMesh& placed, const SimulationSettings& settings,
                       const std::vector<std::array<float, 4>>& d_points, std::vector<Vec3d>& d_vertices);

}  // namespace mirage
