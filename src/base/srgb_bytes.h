// Pictures as files and compressors keep them: 8 bits a channel, sRGB-encoded.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image.h"

namespace mirage {

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
