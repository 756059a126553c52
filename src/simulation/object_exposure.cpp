#include "simulation/object_exposure.h"

#include "base/random.h"

namespace mirage {
namespace {

/// Standard normals of the three channels of a pixel of the picture.
Vec3d noise_at(const CameraEffects& effects, int u, int v) {
  RandomStream random(effects.draw, "sensor noise on the object",
                      static_cast<std::uint64_t>(v) << 32 | static_cast<std::uint64_t>(u));
  Vec3d noise;
  for (double& n : noise) n = random.normal();
  return noise;
}

/// Calls with each pixel's place in the window.
template <class Each>
void each_pixel(const Image<double>& window, const Each& each) {
  for (int v = 0; v < window.height; ++v)
    for (int u = 0; u < window.width; ++u) each(u, v);
}

}  // namespace

Image<double> expose_object(const CameraEffects& effects, const ImageF& photograph, int u0, int v0,
                            Image<double>& rgba) {
  if (effects.blur_sigma > 0) {
    each_pixel(rgba, [&](int u, int v) {
      double* p = rgba.pixel(u, v);
      for (int c = 0; c < 3; ++c) p[c] -= (1 - p[3]) * photograph.at(u, v, c);
    });
    soften(rgba, effects.blur_sigma);
    each_pixel(rgba, [&](int u, int v) {
      double* p = rgba.pixel(u, v);
      for (int c = 0; c < 3; ++c) p[c] += (1 - p[3]) * photograph.at(u, v, c);
    });
  }
  if (!effects.noisy()) return {};
  Image<double> softened = rgba;
  each_pixel(rgba, [&](int u, int v) {
    double* p = rgba.pixel(u, v);
    if (p[3] <= 0) return;
    const Vec3d noise = noise_at(effects, u0 + u, v0 + v);
    for (int c = 0; c < 3; ++c) p[c] += p[3] * noise[c] * noise_sigma(p[c], effects.shot, effects.read_sigma);
  });
  return softened;
}

void expose_object_vjp(const CameraEffects& effects, const ImageF& photograph, int u0, int v0,
                       const Image<double>& softened, Image<double>& d_rgba) {
  if (effects.noisy())
    each_pixel(d_rgba, [&](int u, int v) {
      const double* p = softened.pixel(u, v);
      double* d = d_rgba.pixel(u, v);
      if (p[3] <= 0) return;
      const Vec3d noise = noise_at(effects, u0 + u, v0 + v);
      for (int c = 0; c < 3; ++c) {
        const double sigma = noise_sigma(p[c], effects.shot, effects.read_sigma);
        d[3] += d[c] * noise[c] * sigma;
        if (p[c] > 0 && sigma > 0) d[c] += d[c] * p[3] * noise[c] * effects.shot / (2 * sigma);
      }
    });
  if (effects.blur_sigma <= 0) return;
  each_pixel(d_rgba, [&](int u, int v) {
    double* d = d_rgba.pixel(u, v);
    for (int c = 0; c < 3; ++c) d[3] -= d[c] * photograph.at(u, v, c);
  });
  soften_vjp(d_rgba, effects.blur_sigma);
  each_pixel(d_rgba, [&](int u, int v) {
    double* d = d_rgba.pixel(u, v);
    for (int c = 0; c < 3; ++c) d[3] += d[c] * photograph.at(u, v, c);
  });
}

}  // namespace mirage
