// The placed adversary as each sensor draws it; the pieces that insertion.h composes.
#pragma once

#include <memory>
#include <vector>

#include "geometry/mesh.h"
#include "sensors/projection.h"
#include "simulation/adversary_lidar.h"
#include "simulation/camera_pass.h"
#include "simulation/object_light.h"
#include "simulation/placement.h"
#include "simulation/simulation.h"

namespace mirage {

/// Camera side: what was rasterised, and what its VJP needs.
struct CameraTape {
  std::vector<Vec3d> p_camera;  ///< vertices
  std::shared_ptr<const ObjectLight> light;
  ProjectedMesh projected;
  SoftRasterSettings<double> settings;
  RasterTarget<float> target;
  CameraEffects effects;
  Image<double> softened;            ///< what expose_object_vjp needs
  std::shared_ptr<CameraPass> pass;  ///< none where the object touches no pixel
};

/// Projects, shades and rasterises `placed` (in `velo`) into the photograph; fills image, rect, rgba,
/// visible_share and adversary_pixels.
CameraTape draw_in_camera(const PreparedFrame& prepared, const Placement& placement,
                          const TexturedMesh& placed, const SimulationSettings& settings, Simulated& result);
/// Adds d loss / d placed vertices (`velo`) and d loss / d texels.
/// `d_image`: height × width × 3 of the photograph's size, S float or double; the rect's pixels are read.
template <class S>
void draw_in_camera_vjp(const CameraTape& tape, const TexturedMesh& placed, const Calibration& calibration,
                        const Simulated& result, const S* d_image, std::vector<Vec3d>& d_vertices,
                        std::vector<Vec3d>& d_texels);
/// The same for a picture of the library's own.
inline void draw_in_camera_vjp(const CameraTape& tape, const TexturedMesh& placed,
                               const Calibration& calibration, const Simulated& result, const ImageF& d_image,
                               std::vector<Vec3d>& d_vertices, std::vector<Vec3d>& d_texels) {
  draw_in_camera_vjp(tape, placed, calibration, result, d_image.data.data(), d_vertices, d_texels);
}

}  // namespace mirage
