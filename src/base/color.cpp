#include "base/color.h"

#include <array>
#include <bit>
#include <cmath>

namespace mirage {

namespace {

std::uint8_t level_of(float linear) {
  return static_cast<std::uint8_t>(std::lround(255 * srgb_from_linear(linear)));
}

/// level_of as a table that is looked up without a branch, by a value's sign, exponent and upper eight bits
/// of the mantissa. Values of an entry have two levels at most: it holds the lower one times 2^16, and so
/// much more that with the other bits of the first value of the upper level it carries over.
class LevelTable {
 public:
  LevelTable() : entries_(std::size_t{1} << (32 - kShift)) {
    for (std::uint32_t i = kWhite >> kShift; i <= kInfinity >> kShift; ++i) entries_[i] = 255u << 16;
    for (std::uint32_t i = kDark >> kShift; i < kWhite >> kShift; ++i) {
      const std::uint32_t first = i << kShift, level = level_of(std::bit_cast<float>(first));
      std::uint32_t low = first, high = first + (1u << kShift);
      while (low < high) {  // the first value of another level
        const std::uint32_t middle = low + (high - low) / 2;
        if (level_of(std::bit_cast<float>(middle)) == level)
          low = middle + 1;
        else
          high = middle;
      }
      entries_[i] = (level << 16) + (1u << 16) - (low - first);
    }
  }
  const std::uint32_t* data() const { return entries_.data(); }
  static constexpr int kShift = 15;

 private:
  // 6e-5, which is level 0 yet; 1; infinity.
  static constexpr std::uint32_t kDark = 0x38800000, kWhite = 0x3f800000, kInfinity = 0x7f800000;
  std::vector<std::uint32_t> entries_;
};

}  // namespace

void write_srgb_bytes(std::span<const float> linear, std::uint8_t* bytes) {
  static const LevelTable table;
  const std::uint32_t* entries = table.data();
  constexpr std::uint32_t kRest = (1u << LevelTable::kShift) - 1;
  for (std::size_t i = 0; i < linear.size(); ++i) {
    const auto bits = std::bit_cast<std::uint32_t>(linear[i]);
    bytes[i] = static_cast<std::uint8_t>((entries[bits >> LevelTable::kShift] + (bits & kRest)) >> 16);
  }
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
