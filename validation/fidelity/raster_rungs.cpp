#include "validation/fidelity/raster_rungs.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "base/color.h"
#include "validation/fidelity/picture_errors.h"

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

namespace {

/// From the rung "hard" to two others, as a camera sees them.
void add_changes(const HostScene& scene, const PixelRect& rect, std::map<std::string, double>& features) {
  const ImageF& photograph = scene.prepared->frame.image;
  const auto picture = [&](const Simulated& drawn) {
    ImageF window = radiance_of(drawn, photograph, rect);
    saturate(window);
    return window;
  };
  const Simulated hard = draw_raster_rung("hard", scene);
  ImageF mask = coverage_of(hard, rect);
  const ImageF from = picture(hard);
  features["soft_change"] = relative_error(from, picture(draw_raster_rung("soft", scene)), mask);
  features["light_change"] = relative_error(from, picture(draw_raster_rung("visible light", scene)), mask);
}

}  // namespace

const std::vector<std::string>& scene_feature_names() {
  static const std::vector<std::string> names = {
      "camera_elevation",  "light_change",      "log_pixels",    "range",     "roof_height",  "soft_change",
      "sun_along_heading", "sun_behind_camera", "sun_elevation", "sun_share", "visible_share"};
  return names;
}

std::map<std::string, double> scene_features(const HostScene& scene, const Simulated& simulated) {
  const Frame& frame = scene.prepared->frame;
  const Lighting& light = frame.lighting;
  const Vec3d roof = bounds(scene.placed.mesh).center();
  const Vec3d to_camera = frame.calibration.camera_from_velo.inverse().translation() - roof;
  const double yaw = scene.host->box.bev.yaw;
  const auto cosine = [](const Vec3d& a, const Vec3d& b) {
    const double lengths = a.head<2>().norm() * b.head<2>().norm();
    return lengths > 1e-9 ? a.head<2>().dot(b.head<2>()) / lengths : 0;
  };
  const auto brightness = [](const Vec3d& rgb) { return rgb.mean(); };
  const double sun = brightness(light.sun) * std::max(0.0, light.to_sun_velo.z()),
               sky = brightness(light.ambient + light.hemisphere);
  std::map<std::string, double> features = {
      {"sun_elevation", std::asin(std::clamp(light.to_sun_velo.z(), -1.0, 1.0))},
      {"sun_behind_camera", cosine(light.to_sun_velo, to_camera)},
      {"sun_along_heading", cosine(light.to_sun_velo, Vec3d(std::cos(yaw), std::sin(yaw), 0))},
      {"sun_share", sun + sky > 0 ? sun / (sun + sky) : 0},
      {"roof_height", bounds(scene.placed.mesh).min().z() - scene.host->box.bottom},
      {"range", std::hypot(scene.host->box.bev.x, scene.host->box.bev.y)},
      {"camera_elevation", std::atan2(to_camera.z(), to_camera.head<2>().norm())},
      {"log_pixels", std::log(1.0 + simulated.adversary_pixels)},
      {"visible_share", simulated.visible_share},
      {"soft_change", 0},
      {"light_change", 0}};
  if (const PixelRect rect = full_rect(simulated, frame.image); !simulated.rect.empty())
    add_changes(scene, rect, features);
  return features;
}

}  // namespace mirage
