// Pinhole camera. Frame `camera`: x right, y down, z forward. Pixel (u, v): the centre of the top-left pixel
// is (0, 0), as for KITTI's P2 (Hartley & Zisserman, Multiple View Geometry, section 6.1).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include "base/fields.h"
#include "base/image.h"
#include "base/types.h"

namespace mirage {

/// A camera without distortion: u = fx x / z + cx, v = fy y / z + cy, in `camera`; pixel centres are
/// integers.
struct PinholeCamera {
  double fx = 0, fy = 0, cx = 0, cy = 0;  ///< pixels
  int width = 0, height = 0;              ///< pixels

  /// Pixel coordinates of a point in front of the camera (p_camera.z > 0).
  template <class S>
  Vec2<S> project(const Vec3<S>& p_camera) const {
    return {S(fx) * p_camera.x() / p_camera.z() + S(cx), S(fy) * p_camera.y() / p_camera.z() + S(cy)};
  }
  /// The point at depth z (planar, metres) behind pixel (u, v).
  Vec3d unproject(double u, double v, double z) const { return {(u - cx) / fx * z, (v - cy) / fy * z, z}; }
};

// Effects of lens and sensor on an ideal, scene-linear picture: a Gaussian blur and the sensor's noise. Every
// effect is off by default. Generated pictures (generator/generator.h), objects inserted into recorded ones
// (simulation/camera_pass.h) and the ladder of light use them.

struct CameraEffects {
  /// σ of the point spread function (px): lens, the colour filter's interpolation and rectification together.
  double blur_sigma = 0;
  /// Variance of the noise per unit of signal (photon noise).
  double shot = 0;
  /// σ of the noise without light.
  double read_sigma = 0;

  /// Seed of the noise, besides the frame, the camera and the pixel. Not a setting.
  std::uint64_t seed = 0;

  /// Whether pixels get any noise.
  bool noisy() const { return shot > 0 || read_sigma > 0; }
  /// Whether the picture differs from the ideal one.
  bool any() const { return blur_sigma > 0 || noisy(); }
};

template <class Visitor, FieldsOf<CameraEffects> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "blur_sigma", .range = kShare}, s.blur_sigma);  // soften() has no taps for more
  visit({.name = "shot", .range = kShare}, s.shot);
  visit({.name = "read_sigma", .range = kShare}, s.read_sigma);
}

/// σ (px) of a car's camera; generated pictures have 0.5 to 0.85.
inline constexpr double kLensBlur = 0.7;

/// "ideal": no effect; "unit": both, as in every camera; or some of blur (kLensBlur) and noise (shot 7e-5,
/// read 1.25e-3: the middle of the range of generated pictures). FieldError naming camera_effects otherwise.
CameraEffects parse_camera_effects(const std::string& words);
/// parse_camera_effects, with its errors.
inline void set_from_text(const std::string& text, CameraEffects& effects) {
  effects = parse_camera_effects(text);
}
/// "ideal" or "some".
std::string text_of(const CameraEffects& effects);

/// σ of the noise of a signal; a negative signal counts as 0.
inline double noise_sigma(double signal, double shot, double read_sigma) {
  return std::sqrt(read_sigma * read_sigma + shot * std::max(0.0, signal));
}

/// Reach of soften() around a pixel, px.
inline constexpr int kBlurReach = 2;

/// Blurs every channel by a Gaussian of that σ (px, (0, 1]), separable, five taps; edge pixels repeat beyond
/// the edges. T is float or double.
template <class T>
void soften(Image<T>& image, double sigma);
/// The transpose: turns d loss / d image after soften() into that before it.
void soften_vjp(Image<double>& d_image, double sigma);

}  // namespace mirage
