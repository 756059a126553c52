#include "generator/appearance.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/random.h"
#include "sensors/camera_effects.h"

namespace mirage::generator {
namespace {

// Shot and read noise of the camera, in scene-linear values.
void add_sensor_noise(ImageF& image, std::uint64_t seed, std::uint64_t index, std::uint64_t moment) {
  RandomStream level(seed, "sensor noise level", index);
  const double shot = level.uniform(2e-5, 1.2e-4), read = level.uniform(0.5e-3, 2e-3);
  for (int v = 0; v < image.height; ++v) {
    RandomStream random(seed, "sensor noise", moment * 100003 + v);
    for (int i = 0; i < image.width * 3; ++i) {
      float& x = image.pixel(0, v)[i];
      x = std::max(0.f, x + static_cast<float>(random.normal() * noise_sigma(x, shot, read)));
    }
  }
}

}  // namespace

SceneLight make_light(std::uint64_t seed, std::uint64_t index) {
  RandomStream random(seed, "light", index);
  const auto f = [&](double a, double b) { return static_cast<float>(random.uniform(a, b)); };
  SceneLight light;
  Lighting& l = light.lighting;
  const double azimuth = random.uniform(-std::numbers::pi, std::numbers::pi),
               elevation = random.uniform(0.25, 1.05);
  l.to_sun_velo = Vec3d(std::cos(azimuth) * std::cos(elevation), std::sin(azimuth) * std::cos(elevation),
                        std::sin(elevation));
  const double overcast = random.uniform() < 0.25 ? random.uniform(0.6, 1.0) : random.uniform(0.0, 0.2);
  const float exposure = f(0.85, 1.5);
  const float warm = std::clamp(1.2f - static_cast<float>(elevation), 0.f, 1.f);
  const float strength = 2.3f * (1 - 0.93f * static_cast<float>(overcast)) * exposure;
  const Vec3f sun = strength * Vec3f(1.04f, 0.97f - 0.05f * warm, 0.86f - 0.18f * warm);
  l.sun = sun.cast<double>();
  const float o = static_cast<float>(overcast);
  const float bright = f(0.3, 0.85) * exposure;
  light.sky.horizon = bright * ((1 - o) * Vec3f(0.80f, 0.92f, 1.05f) + o * Vec3f(0.95f, 0.96f, 1.0f));
  light.sky.zenith = bright * ((1 - o) * Vec3f(0.11f, 0.21f, 0.43f) + o * Vec3f(0.8f, 0.82f, 0.86f));
  light.sky.glow = (1 - o) * 0.9f * exposure;
  light.sky.clouds = random.uniform() < 0.7 ? f(0.2, 0.75) : 0;
  light.sky.variant = random.next_u32();
  light.sky.seen = f(1.0, 1.9);
  const Vec3f to_sun = l.to_sun_velo.cast<float>(), sky = light.sky.irradiance(to_sun);
  // What bounces from ground and walls: a mean albedo of 0.12, a share of them in the sun.
  const Vec3f bounce =
      0.16f * (0.45f * std::max(0.f, to_sun.z()) * sun + 0.6f * sky).cwiseProduct(Vec3f(1.05f, 1, 0.9f));
  l.ambient = bounce.cast<double>();
  // Lighting's hemisphere term adds to the ambient: with a share (1 + n·up)/2 of open sky in view.
  l.hemisphere = (sky - bounce).cwiseMax(0.f).cast<double>();
  return light;
}

void expose(ImageF& image, std::uint64_t seed, std::uint64_t index, std::uint64_t moment) {
  soften(image, RandomStream(seed, "lens", index).uniform(0.5, 0.85));
  add_sensor_noise(image, seed, index, moment);
}

}  // namespace mirage::generator
