// What lens and sensor add to an ideal picture, scene-linear: a Gaussian blur and the sensor's noise. Every
// effect is off at its default; generated pictures (generator/appearance.h), objects put into recorded ones
// (simulation/camera_pass.h) and the ladder of light take them from here.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include "base/fields.h"
#include "base/image.h"

namespace mirage {

struct CameraEffects {
  /// σ of the point spread function (px): lens, the colour filter's interpolation and rectification together.
  double blur_sigma = 0;
  /// Variance of the noise per unit of signal: photons are counted.
  double shot = 0;
  /// σ of the noise in the dark.
  double read_sigma = 0;

  /// Another draw of the noise. Not a setting: an attack's expectation draws it.
  std::uint64_t draw = 0;

  bool noisy() const { return shot > 0 || read_sigma > 0; }
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

/// "ideal": none; "unit": both, as every camera has them; or some of blur (kLensBlur) and noise (shot 7e-5,
/// read 1.25e-3: the middle of what generated pictures have). FieldError naming camera_effects otherwise.
CameraEffects parse_camera_effects(const std::string& words);
inline void set_from_text(const std::string& text, CameraEffects& effects) {
  effects = parse_camera_effects(text);
}
/// "ideal", or "some".
std::string text_of(const CameraEffects& effects);

/// σ of the noise of a signal; a negative one has the dark's.
inline double noise_sigma(double signal, double shot, double read_sigma) {
  return std::sqrt(read_sigma * read_sigma + shot * std::max(0.0, signal));
}

/// How far soften() spreads a pixel, px.
inline constexpr int kBlurReach = 2;

/// A Gaussian of that σ (px, (0, 1]), separable, five taps, every channel; beyond the edges the picture goes
/// on as it ends. T is float or double.
template <class T>
void soften(Image<T>& image, double sigma);
/// The transpose: d loss / d image before, of d loss / d image after.
void soften_vjp(Image<double>& d_image, double sigma);

}  // namespace mirage
