#include "base/color.h"

#include <array>
#include <bit>
#include <cmath>

namespace mirage {

namespace {

std::uint8_t level_of(float linear) {
  return static_cast<std::uint8_t>(std::lround(255 * srgb_from_linear(linear)));
}

/// level_of as a table: of each range of values with the same exponent and upper eight bits of the mantissa,
/// the level of its first value, and the value from which the next level holds. A range is no wider than a
/// level.
struct LevelTable {
  static constexpr std::uint32_t kFirst = 0x38800000 >> 15;  // 6e-5, which is level 0 yet
  static constexpr std::uint32_t kLast = 0x3f800000 >> 15;   // 1
  std::array<std::uint8_t, kLast - kFirst> level;
  std::array<float, kLast - kFirst> next;
  LevelTable() {
    for (std::uint32_t i = 0; i < level.size(); ++i) {
      std::uint32_t low = (kFirst + i) << 15, high = low + (1u << 15);
      level[i] = level_of(std::bit_cast<float>(low));
      while (low < high) {  // the first value of another level
        const std::uint32_t middle = low + (high - low) / 2;
        if (level_of(std::bit_cast<float>(middle)) == level[i])
          low = middle + 1;
        else
          high = middle;
      }
      next[i] = std::bit_cast<float>(low);
    }
  }
  std::uint8_t operator()(float linear) const {
    if (!(linear > std::bit_cast<float>(kFirst << 15))) return 0;
    if (linear >= 1) return 255;
    const std::uint32_t i = (std::bit_cast<std::uint32_t>(linear) >> 15) - kFirst;
    return static_cast<std::uint8_t>(level[i] + (linear >= next[i]));
  }
};

}  // namespace

void write_srgb_bytes(std::span<const float> linear, std::uint8_t* bytes) {
  static const LevelTable table;
  for (std::size_t i = 0; i < linear.size(); ++i) bytes[i] = table(linear[i]);
}

std::vector<std::uint8_t> srgb_bytes(const ImageF& linear) {
  std::vector<std::uint8_t> bytes(linear.data.size());
  write_srgb_bytes(linear.data, bytes.data());
  return bytes;
}

void through_srgb_slope(std::span<const std::uint8_t> levels, std::span<float> gradient) {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> slopes{};
    for (std::size_t i = 0; i < slopes.size(); ++i) {
      const float linear = linear_level(static_cast<std::uint8_t>(i));
      slopes[i] = 255 * (linear <= 0.0031308f ? 12.92f : 1.055f / 2.4f * std::pow(linear, 1 / 2.4f - 1));
    }
    return slopes;
  }();
  const float* slopes = table.data();
  for (std::size_t i = 0; i < gradient.size(); ++i) gradient[i] *= slopes[levels[i]];
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
