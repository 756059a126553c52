// Pictures as files and compressors keep them: 8 bits a channel, sRGB-encoded.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image.h"

namespace mirage {

/// Rounded to the nearest level; what is outside [0, 1] is clamped. Row by row, channels together.
std::vector<std::uint8_t> srgb_bytes(const ImageF& linear);
/// The scene-linear value of one level.
float linear_level(std::uint8_t level);
/// width × height × 3, scene-linear. `bytes` has as many values.
ImageF linear_image(std::span<const std::uint8_t> bytes, int width, int height);

}  // namespace mirage
