// A scene of textured meshes drawn whole, by the soft rasteriser or by the ray-traced camera.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "base/image.h"
#include "geometry/mesh.h"
#include "sensors/camera.h"
#include "sensors/lighting.h"
#include "sensors/soft_rasterizer.h"
#include "simulation/insertion.h"

namespace mirage {

/// A camera of a scene.
struct SceneCamera {
  std::string name = "camera";
  PinholeCamera camera;
  Transform camera_from_velo = Transform::Identity();
  ImageF photograph;  ///< scene-linear RGB background; empty if the file has none
};

/// The content of a scene file, seen by its first camera. World is `velo`.
struct RenderScene : SceneCamera {
  /// A mesh of the scene and its role.
  struct Thing {
    std::string name, role;  ///< role: "adversary", "host", "ground" or whatever the file says; may be empty
    TexturedMesh textured;   ///< in `velo`; without texels it is grey (0.5)
  };
  std::vector<Thing> things;
  Lighting lighting;
  std::vector<SceneCamera> others;  ///< after the first
};

/// The soft rasteriser, or the ray-traced camera.
enum class SceneRenderer { soft, traced };

/// How a scene file is drawn.
struct SceneRenderSettings {
  SceneRenderer renderer = SceneRenderer::soft;
  SoftRasterSettings<double> raster;  ///< of the soft rasteriser; near, far and gamma are set by render_scene
  /// γ in units of (far − near). Default: 3 cm of depth, equal to the simulator's 1e-2 for an object on a
  /// roof.
  std::optional<double> gamma;
  int samples = 2;  ///< samples a pixel along each side
  PixelRect rect;   ///< the window to draw; empty: the whole image
  std::uint64_t seed = 0;
};

/// A drawn scene; its pictures are window-sized.
struct SceneImage {
  PixelRect rect;
  ImageF rgba;      ///< scene-linear colour over the background; coverage
  ImageF depth;     ///< planar depth of the surface at the pixel's centre, m; 0 where there is none
  int covered = 0;  ///< pixels with coverage > 0.5
  std::size_t faces = 0;
  double near = 0, far = 0, gamma = 0;  ///< as used by the soft rasteriser
};

/// Draws every thing of the scene over `background` (camera-sized, scene-linear RGB).
///
/// soft: the light model of sensors/lighting.h, one light a face, no shadows. Different atlas resolutions are
/// refined to their least common multiple, which changes no colour. Faces are clipped 0.1 m in front of the
/// camera. traced: the sun casts shadows and the sky, of the light model's ambient + hemisphere radiance, is
/// occluded; noise depends on the seed only.
///
/// InputError for a camera or a light with a number that is not finite, for an empty scene, a window
/// outside the image, a background of another size, or texels that would fill more than 4 GB.
SceneImage render_scene(const RenderScene& scene, const ImageF& background,
                        const SceneRenderSettings& settings = {});

/// The part of an image in a rectangle, which must lie inside it.
ImageF crop(const ImageF& image, const PixelRect& rect);

/// The same view in an image of another size; keeps the field of view along each side.
PinholeCamera resized(const PinholeCamera& camera, int width, int height);

// The picture of an inserted object as it was drawn, before the photograph saturates.

/// Channel c of a camera's drawing (CameraSight::rgba) at a pixel of the photograph; 0 outside its window.
double rgba_at(const CameraSight& seen, int u, int v, int c);

/// The window `rect` of `photograph` with the object of `simulated` over it, not clamped: over-exposed pixels
/// keep their radiance.
ImageF radiance_of(const Simulated& simulated, const ImageF& photograph, const PixelRect& rect);

/// Adds `difference` (rect-sized RGB, scene-linear; `rect` inside the photograph) to the picture: to the
/// object's radiance inside its window, to the photograph beside it. The picture saturates afterwards, and
/// simulate_vjp goes by that: it is the derivative of this sum for a difference held fixed.
void add_to_picture(const ImageF& difference, const PixelRect& rect, Simulated& simulated);

/// The smallest rectangle around both; an empty one does not count.
PixelRect united(const PixelRect& a, const PixelRect& b);

}  // namespace mirage
