#include "validation/fidelity/raster_rungs.h"

#include <stdexcept>

#include "base/color.h"

namespace mirage {
namespace {

/// The frame and the mesh with sRGB numbers in the place of radiances: what a renderer does that multiplies
/// light into the texture's bytes.
Simulated simulate_in_srgb(const HostScene& scene, const SimulationSettings& settings) {
  PreparedFrame prepared = *scene.prepared;
  for (float& value : prepared.frame.image.data) value = srgb_from_linear(value);
  HostScene bytes = scene;
  bytes.prepared = &prepared;
  for (Vec3d& texel : bytes.adversary.atlas.texels)
    for (double& channel : texel) channel = srgb_from_linear(static_cast<float>(channel));
  Simulated simulated = simulate_host(bytes, settings);
  for (float& value : simulated.image.data) value = linear_from_srgb(value);
  for (int v = 0; v < simulated.rgba.height; ++v)
    for (int u = 0; u < simulated.rgba.width; ++u)
      for (int c = 0; c < 3; ++c)
        simulated.rgba.at(u, v, c) = linear_from_srgb(static_cast<float>(simulated.rgba.at(u, v, c)));
  return simulated;
}

Simulated simulate_uniform(const HostScene& scene, const SimulationSettings& settings) {
  PreparedFrame prepared = *scene.prepared;
  Lighting& light = prepared.frame.lighting;
  light.ambient += light.hemisphere / 2;
  light.hemisphere.setZero();
  HostScene uniform = scene;
  uniform.prepared = &prepared;
  return simulate_host(uniform, settings);
}

}  // namespace

const std::vector<std::string>& raster_rungs() {
  static const std::vector<std::string> rungs = {"hard",
                                                 "soft",
                                                 "sRGB shading",
                                                 "uniform ambient",
                                                 "visible light",
                                                 "visible light, exact areas",
                                                 "fine light, exact areas",
                                                 "lens",
                                                 "sensor"};
  return rungs;
}

const std::set<std::string>& feature_rungs() {
  static const std::set<std::string> rungs = {"hard", "soft", "visible light"};
  return rungs;
}

Simulated draw_raster_rung(const std::string& rung, const HostScene& scene) {
  if (rung == "soft") return simulate_host(scene, scene.simulation);
  SimulationSettings settings = hard_limit(scene.simulation, true);
  settings.supersampling = scene.simulation.supersampling;
  if (rung == "sRGB shading") return simulate_in_srgb(scene, settings);
  if (rung == "uniform ambient") return simulate_uniform(scene, settings);
  if (rung.ends_with(", exact areas")) settings.exact_coverage = true;
  if (rung.starts_with("visible light"))
    settings.light = LightModel::visible;
  else if (rung == "fine light, exact areas")
    settings.light = LightModel::fine;
  else if (rung == "lens")
    settings.camera_effects = parse_camera_effects("blur");
  else if (rung == "sensor")
    settings.camera_effects = parse_camera_effects("noise");
  else if (rung != "hard")
    throw std::logic_error("no rung of the rasteriser: " + rung);
  return simulate_host(scene, settings);
}

}  // namespace mirage
