// The one place that converts between scene-linear values and the sRGB encoding (IEC 61966-2-1).
#pragma once

#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image.h"

namespace mirage {

/// Linear [0, 1] → sRGB-encoded [0, 1]. Values outside are clamped.
inline float srgb_from_linear(float linear) {
  if (!(linear > 0)) return 0;
  if (linear >= 1) return 1;
  return linear <= 0.0031308f ? 12.92f * linear : 1.055f * std::pow(linear, 1 / 2.4f) - 0.055f;
}

/// sRGB-encoded [0, 1] → linear [0, 1].
inline float linear_from_srgb(float encoded) {
  if (!(encoded > 0)) return 0;
  if (encoded >= 1) return 1;
  return encoded <= 0.04045f ? encoded / 12.92f : std::pow((encoded + 0.055f) / 1.055f, 2.4f);
}

/// Rec. 709 luminance of a linear RGB triple.
template <class S>
S luminance(const S* rgb) {
  return S(0.2126) * rgb[0] + S(0.7152) * rgb[1] + S(0.0722) * rgb[2];
}

// Pictures as files and compressors keep them: 8 bits a channel, sRGB-encoded.

/// Rounded to the nearest level; what is outside [0, 1] is clamped. Row by row, channels together.
std::vector<std::uint8_t> srgb_bytes(const ImageF& linear);
/// The same into memory of the caller's, as many bytes as values.
void write_srgb_bytes(std::span<const float> linear, std::uint8_t* bytes);
/// d loss / d level to d loss / d linear value, in place: by the curve's own slope at the levels, as rounding
/// has none.
void through_srgb_slope(std::span<const std::uint8_t> levels, std::span<float> gradient);
/// The scene-linear value of one level.
float linear_level(std::uint8_t level);
/// width × height × 3, scene-linear. `bytes` has as many values.
ImageF linear_image(std::span<const std::uint8_t> bytes, int width, int height);

}  // namespace mirage
