// Draws a projected mesh into pixels and takes the gradient back: one class for each rasteriser, so that
// camera_pass.cpp need not know which one draws.
#pragma once

#include <memory>
#include <vector>

#include "geometry/mesh.h"
#include "sensors/camera.h"
#include "sensors/projection.h"
#include "sensors/raster_batch.h"
#include "simulation/adversary_lidar.h"
#include "simulation/object_light.h"
#include "simulation/placement.h"
#include "simulation/simulation.h"

namespace mirage {

/// m; faces are clipped at this depth before they are drawn.
inline constexpr double kNearPlane = 0.1;

/// A window of the camera's picture; `background`: window-sized RGB. No depth limit.
RasterTarget<float> window_of(const PinholeCamera& camera, const PixelRect& rect, ImageF background,
                              int supersampling = 1);

/// One drawing of one mesh. vjp() and unobstructed_area() refer to the last draw() and take its arguments
/// again.
class CameraPass {
 public:
  virtual ~CameraPass() = default;
  /// RGBA of the target's window: the object over the background, and the silhouette S.
  virtual Image<double> draw(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                             const RasterTarget<float>& target) = 0;
  /// d loss / d screen mesh, given d loss / d RGBA.
  virtual ScreenGradient<double> vjp(const ScreenMesh<double>& mesh,
                                     const SoftRasterSettings<double>& settings,
                                     const RasterTarget<float>& target,
                                     const Image<double>& d_rgba) const = 0;
  /// Pixels² that the mesh covers with nothing in front of it, up to one picture's size beyond the picture.
  virtual double unobstructed_area(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                                   const PinholeCamera& camera) const = 0;
};

/// The fast soft rasteriser, the plain one in double (`reference`), or exact areas (`exact_coverage`).
std::unique_ptr<CameraPass> camera_pass(const SimulationSettings& settings);

/// Sum of the silhouette over an RGBA window, pixels².
double silhouette_area(const Image<double>& rgba);

// The drawing of the placed adversary in a camera; insertion.h composes it with the other sensors.

/// Camera side: the rasterised mesh and the values that its VJP needs.
struct CameraTape {
  std::vector<Vec3d> p_camera;  ///< vertices
  std::shared_ptr<const ObjectLight> light;
  ProjectedMesh projected;
  SoftRasterSettings<double> settings;
  RasterTarget<float> target;
  CameraEffects effects;
  Image<double> softened;            ///< of expose_object(), for its VJP
  std::shared_ptr<CameraPass> pass;  ///< null if the object touches no pixel
};

/// Projects, shades and rasterises `placed` (in `velo`) into the photograph of one of the frame's cameras.
/// Fills `result`; the image of another camera than the first only if the object touches it.
CameraTape draw_in_camera(const PreparedFrame& prepared, const Placement& placement,
                          const TexturedMesh& placed, const SimulationSettings& settings, CameraSight& result,
                          std::size_t camera = 0);
/// Whether `placed` (in `velo`) may touch the camera's picture: a cheap test, true in doubt.
bool may_see(const Calibration& calibration, const Mesh& placed, const SimulationSettings& settings);
/// Adds d loss / d placed vertices (`velo`) and d loss / d texels. `d_image`: height × width × 3 of the
/// photograph's size; only the pixels of result.rect are read.
void draw_in_camera_vjp(const CameraTape& tape, const TexturedMesh& placed, const Calibration& calibration,
                        const CameraSight& result, const GradientView& d_image,
                        std::vector<Vec3d>& d_vertices, std::vector<Vec3d>& d_texels);

// Lens and sensor effects on the pixels of an inserted object. A recorded photograph contains both; a drawn
// object does not.

/// `rgba`: a window of the picture with the object over `photograph` (the same window, RGB), not saturated,
/// and its silhouette S; the object ends kBlurReach pixels before the window does, but for the picture's
/// own edges. Blurs the object's colour and silhouette and composites them over the photograph. Then adds
/// noise scaled by the object's coverage of a pixel (the photograph has its own). It depends on the seed and
/// the pixel's place in the picture, (u0 + u, v0 + v). Returns `rgba` before the noise, for
/// expose_object_vjp; empty without noise.
Image<double> expose_object(const CameraEffects& effects, const ImageF& photograph, int u0, int v0,
                            Image<double>& rgba);

/// Turns d loss / d rgba after expose_object into that before it, in place. `softened`: its result.
void expose_object_vjp(const CameraEffects& effects, const ImageF& photograph, int u0, int v0,
                       const Image<double>& softened, Image<double>& d_rgba);

}  // namespace mirage
