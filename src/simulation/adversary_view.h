// The placed adversary as each sensor draws it; the pieces that insertion.h composes.
#pragma once

#include <array>
#include <vector>

#include "geometry/mesh.h"
#include "sensors/exact_coverage.h"
#include "sensors/projection.h"
#include "sensors/raster_batch.h"
#include "simulation/adversary_lidar.h"
#include "simulation/simulation.h"

namespace mirage {

/// Camera side: what was rasterised, and what its VJP needs.
struct CameraTape {
  std::vector<Vec3d> p_camera;  ///< vertices
  std::vector<Vec3d> normals;   ///< unnormalised face normals, `velo`
  std::vector<Vec3d> light;     ///< plain: light factor of each face
  LightVisibility visibility;   ///< visible: what stands in the light's way, and the light of each texel
  VisibleLight<double> visible;
  double gloss = 0;  ///< of the visible light
  ProjectedMesh projected;
  SoftRasterSettings<double> settings;
  RasterTarget<float> target;
  bool reference = false;
  mutable RasterTape raster;  ///< its VJP needs working memory
  bool exact_coverage = false;
  ExactTape exact;  ///< in place of `raster` where exact_coverage
};

/// Projects, shades and rasterises `placed` (in `velo`) into the photograph; fills image, rect, rgba,
/// visible_share and adversary_pixels.
/// `rooftop`: what the visible light's surroundings come from; null for an object in free space.
CameraTape draw_in_camera(const PreparedFrame& prepared, const Label& host, const TexturedMesh& placed,
                          const SimulationSettings& settings, Simulated& result,
                          const Rooftop* rooftop = nullptr);
/// Adds d loss / d placed vertices (`velo`) and d loss / d texels.
/// `d_image`: height × width × 3 of the photograph's size, S float or double; the rect's pixels are read.
template <class S>
void draw_in_camera_vjp(const CameraTape& tape, const TexturedMesh& placed, const Calibration& calibration,
                        const Lighting& lighting, const Simulated& result, const S* d_image,
                        std::vector<Vec3d>& d_vertices, std::vector<Vec3d>& d_texels);
/// The same for a picture of the library's own.
inline void draw_in_camera_vjp(const CameraTape& tape, const TexturedMesh& placed,
                               const Calibration& calibration, const Lighting& lighting,
                               const Simulated& result, const ImageF& d_image, std::vector<Vec3d>& d_vertices,
                               std::vector<Vec3d>& d_texels) {
  draw_in_camera_vjp(tape, placed, calibration, lighting, result, d_image.data.data(), d_vertices, d_texels);
}

}  // namespace mirage
