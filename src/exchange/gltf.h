// glTF 2.0 out and in (binary .glb). Axes and units are converted here and nowhere else: `velo`/adversary
// (x forward, y left, z up) ↔ glTF (y up). Colours: texture as 8-bit sRGB PNG for viewers; exact values
// travel in extras.
#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "geometry/mesh.h"
#include "scene/frame.h"
#include "simulation/insertion.h"
#include "simulation/render_scene.h"

namespace mirage {

/// Writes the adversary: each face tessellated into its C² congruent triangles with all UVs at one texel's
/// centre, so that every viewer shows SoftRas's atlas exactly; and the original vertices, faces and texels
/// (binary, float64) for a lossless way back. `about`, if not empty, goes into the asset's extras as
/// "mirage_object" and says where the object comes from. Its "licence", if any, is the asset's copyright.
void write_adversary(const std::filesystem::path& file, const TexturedMesh& adversary,
                     const nlohmann::json& about = {});
/// Reads a file of write_adversary: the identical mesh and texels. A foreign .glb is read as a plain mesh
/// with its base colour. InputError naming file and field (gltf_document.h says what is refused).
TexturedMesh read_adversary(const std::filesystem::path& file);

/// A whole scene for Blender and for viewers.
struct ExportScene {
  std::string name;
  TexturedMesh adversary;  ///< in `velo`, placed
  /// A plain mesh beside the adversary.
  struct Proxy {
    std::string name;   ///< also the role in extras
    std::string shape;  ///< extras' mirage_shape: "fitted" or "box" for the host; may be empty
    Mesh mesh;          ///< in `velo`
    Vec3d color = Vec3d(0.3, 0.3, 0.3);  ///< linear albedo
  };
  std::vector<Proxy> proxies;     ///< host vehicle, ground, …
  std::string camera = "camera";  ///< its name
  Calibration calibration;        ///< camera node; fx, fy, cx, cy, width, height in extras
  Lighting lighting;              ///< sun as KHR_lights_punctual directional; all of it in extras
  /// Whether the adversary was learned on this vehicle; in extras where it is known.
  std::optional<bool> learned_on = {};
  ImageF photograph;  ///< scene-linear RGB, of the camera's size; embedded as PNG. May be empty
  std::vector<SideCamera> others = {};  ///< more cameras with their photographs
};
/// Writes it as .glb, atomically. InputError for a mesh that check_mesh refuses; Failure if the file can't be
/// written.
void write_scene(const std::filesystem::path& file, const ExportScene& scene);

/// Reads a scene to draw it: all meshes of the default scene in `velo`, exact where the file has Mirage's
/// extras, else with their base colour (textures of foreign files are left out, with a warning); light,
/// cameras and their photographs from the scene's extras. Without those, the first camera node with
/// intrinsics in extras is taken, or one with a field of view and the image size `width` × `height`, and the
/// first directional light. InputError naming file and field, as read_adversary, also when there is no
/// camera, it or a light is singular or beyond the limits, or the photograph is not of the camera's size.
RenderScene read_scene(const std::filesystem::path& file, int width = 0, int height = 0);

// The vehicle under the adversary and the road, for Blender and viewers: they catch its shadow and bounce
// light.

/// A level square of road around `centre`, 40 m to every side, facing up.
Mesh ground_proxy(const Vec3d& centre);

/// Everything of one frame with the placed adversary. The host is the carrier's fitted shape where it has
/// one, with the road where its wheels stand, else car_proxy of the labelled box; its paint is taken from the
/// photograph. Without a carrier the adversary is alone. It has those of the frame's other cameras that may
/// see the adversary.
ExportScene host_scene(const Frame& frame, const Placement& placement, const TexturedMesh& adversary,
                       const std::string& name);

}  // namespace mirage
