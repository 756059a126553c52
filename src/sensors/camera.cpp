#include "sensors/camera.h"

#include <array>

#include "base/sizes.h"

namespace mirage {
namespace {

/// Weights of the pixel, of its neighbours and of their neighbours.
template <class T>
std::array<T, kBlurReach + 1> taps_of(double sigma) {
  double taps[kBlurReach + 1], total = 0;
  for (int k = 0; k <= kBlurReach; ++k) {
    taps[k] = k == 0 ? 1 : std::exp(-0.5 * k * k / (sigma * sigma));
    total += k == 0 ? taps[k] : 2 * taps[k];
  }
  return {static_cast<T>(taps[0] / total), static_cast<T>(taps[1] / total), static_cast<T>(taps[2] / total)};
}

/// The transpose along one axis: adds each pixel, weighted, to its neighbours.
void spread(const Image<double>& from, const std::array<double, kBlurReach + 1>& taps, bool across,
            Image<double>& to) {
  for (int v = 0; v < from.height; ++v)
    for (int u = 0; u < from.width; ++u)
      for (int k = -kBlurReach; k <= kBlurReach; ++k) {
        const double weight = taps[as_size(std::abs(k))];
        double* at = across ? to.pixel(std::clamp(u + k, 0, from.width - 1), v)
                            : to.pixel(u, std::clamp(v + k, 0, from.height - 1));
        for (int c = 0; c < from.channels; ++c) at[c] += weight * from.at(u, v, c);
      }
}

}  // namespace

CameraEffects parse_camera_effects(const std::string& words) {
  CameraEffects effects;
  if (words == "ideal") return effects;
  std::vector<std::string> choices = {"blur", "noise"};
  if (words.find(',') == words.npos) choices.insert(choices.begin(), {"ideal", "unit"});
  if (words.empty()) throw unknown_word("camera_effects", words, choices);
  for (const std::string& word : listed_words(words == "unit" ? "blur,noise" : words)) {
    if (word == "blur") {
      effects.blur_sigma = kLensBlur;
    } else if (word == "noise") {
      effects.shot = 7e-5;
      effects.read_sigma = 1.25e-3;
    } else {
      throw unknown_word("camera_effects", word, choices);
    }
  }
  return effects;
}

std::string text_of(const CameraEffects& effects) {
  return effects.any() ? "some" : "ideal";
}

template <class T>
void soften(Image<T>& image, double sigma) {
  const auto [a, b, c] = taps_of<T>(sigma);
  Image<T> across = image;
  const int w = image.width, h = image.height;
  for (int v = 0; v < h; ++v)
    for (int u = 0; u < w; ++u)
      for (int k = 0; k < image.channels; ++k) {
        const auto x = [&](int i) { return image.at(std::clamp(i, 0, w - 1), v, k); };
        across.at(u, v, k) = a * x(u) + b * (x(u - 1) + x(u + 1)) + c * (x(u - 2) + x(u + 2));
      }
  for (int v = 0; v < h; ++v)
    for (int u = 0; u < w; ++u)
      for (int k = 0; k < image.channels; ++k) {
        const auto y = [&](int i) { return across.at(u, std::clamp(i, 0, h - 1), k); };
        image.at(u, v, k) = a * y(v) + b * (y(v - 1) + y(v + 1)) + c * (y(v - 2) + y(v + 2));
      }
}
template void soften(Image<float>&, double);
template void soften(Image<double>&, double);

void soften_vjp(Image<double>& d_image, double sigma) {
  const auto taps = taps_of<double>(sigma);
  Image<double> d_across(d_image.width, d_image.height, d_image.channels);
  spread(d_image, taps, false, d_across);
  std::fill(d_image.data.begin(), d_image.data.end(), 0.0);
  spread(d_across, taps, true, d_image);
}

}  // namespace mirage
