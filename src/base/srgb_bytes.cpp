#include "base/srgb_bytes.h"

#include <array>
#include <cmath>

#include "base/color.h"

namespace mirage {

std::vector<std::uint8_t> srgb_bytes(const ImageF& linear) {
  std::vector<std::uint8_t> bytes(linear.data.size());
  for (std::size_t i = 0; i < bytes.size(); ++i)
    bytes[i] = static_cast<std::uint8_t>(std::lround(255 * srgb_from_linear(linear.data[i])));
  return bytes;
}

float linear_level(std::uint8_t level) {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> values{};
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = linear_from_srgb(static_cast<float>(i) / 255);
    return values;
  }();
  return table[level];
}

ImageF linear_image(std::span<const std::uint8_t> bytes, int width, int height) {
  ImageF image(width, height, 3);
  for (std::size_t i = 0; i < bytes.size(); ++i) image.data[i] = linear_level(bytes[i]);
  return image;
}

}  // namespace mirage
