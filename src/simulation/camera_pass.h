// How a projected mesh becomes pixels, and how a gradient comes back: one class for each rasteriser, so that
// who draws (adversary_camera.cpp) does not ask which it is.
#pragma once

#include <memory>

#include "sensors/camera.h"
#include "sensors/raster_batch.h"
#include "simulation/simulation.h"

namespace mirage {

/// m; faces are clipped at this depth before they are drawn.
inline constexpr double kNearPlane = 0.1;

/// A window of the camera's picture; `background`: window-sized RGB. No depth limit.
RasterTarget<float> window_of(const PinholeCamera& camera, const PixelRect& rect, ImageF background,
                              int supersampling = 1);

/// One drawing of one mesh. vjp() and unobstructed_area() are of the last draw(), whose arguments they are
/// given again.
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

}  // namespace mirage
