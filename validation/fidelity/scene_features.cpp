#include "validation/fidelity/scene_features.h"

#include <algorithm>
#include <cmath>

#include "validation/fidelity/picture_errors.h"
#include "validation/fidelity/raster_rungs.h"

namespace mirage {
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
