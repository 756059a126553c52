// A dense image: row-major, channels interleaved, row 0 on top, pixel (u, v) = (column, row).
// Inside the program colour images are scene-linear float RGB (src/README.md, Conventions).
#pragma once

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "base/sizes.h"

namespace mirage {

/// A picture, row by row from the top, `channels` values a pixel.
template <class T>
struct Image {
  int width = 0, height = 0, channels = 0;
  std::vector<T> data;

  Image() = default;
  /// Every value is `fill`.
  Image(int width_, int height_, int channels_, T fill = T())
      : width(width_),
        height(height_),
        channels(channels_),
        data(as_size(width_) * as_size(height_) * as_size(channels_), fill) {}

  /// The channels of column u, row v; not checked.
  T* pixel(int u, int v) {
    return data.data() + (as_size(v) * as_size(width) + as_size(u)) * as_size(channels);
  }
  /// The channels of column u, row v; not checked.
  const T* pixel(int u, int v) const {
    return data.data() + (as_size(v) * as_size(width) + as_size(u)) * as_size(channels);
  }
  /// Channel c of column u, row v; not checked.
  T& at(int u, int v, int c = 0) { return pixel(u, v)[c]; }
  /// Channel c of column u, row v; not checked.
  const T& at(int u, int v, int c = 0) const { return pixel(u, v)[c]; }
  /// Whether it has no values.
  bool empty() const { return data.empty(); }
};

/// The type of pictures, depth maps and masks.
using ImageF = Image<float>;

/// Half-open pixel rectangle [u0, u1) × [v0, v1).
struct PixelRect {
  int u0 = 0, v0 = 0, u1 = 0, v1 = 0;
  /// Columns; 0 where the edges are in the wrong order.
  int width() const { return u1 > u0 ? u1 - u0 : 0; }
  /// Rows; 0 where the edges are in the wrong order.
  int height() const { return v1 > v0 ? v1 - v0 : 0; }
  /// Whether it holds no pixel.
  bool empty() const { return width() == 0 || height() == 0; }
};

// The one place that converts between scene-linear values and the sRGB encoding (IEC 61966-2-1).

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

/// Rounded to the nearest level; values outside [0, 1] are clamped. Row by row, channels together.
std::vector<std::uint8_t> srgb_bytes(const ImageF& linear);
/// The same into the caller's memory, one byte for each value.
void write_srgb_bytes(std::span<const float> linear, std::uint8_t* bytes);
/// d loss / d level to d loss / d linear value, in place: by the curve's own slope at the levels, as rounding
/// has none.
void through_srgb_slope(std::span<const std::uint8_t> levels, std::span<float> gradient);
/// The scene-linear value of one level.
float linear_level(std::uint8_t level);
/// width × height × 3, scene-linear. `bytes` has as many values.
ImageF linear_image(std::span<const std::uint8_t> bytes, int width, int height);

// Image files through OpenImageIO (base/picture_codec.h). PNG and JPEG hold 8-bit sRGB (16-bit PNG: depth),
// EXR scene-linear float.

/// Pixels of the largest picture that is read, given or recorded: 8192×8192. A header of a few bytes can
/// claim 60000×60000, so every reader checks the size before it allocates.
inline constexpr std::uint64_t kMaxPixels = 1ull << 26;

/// The size that a picture's header must state; 0: any size within kMaxPixels.
struct PictureSize {
  int width = 0, height = 0;
};

/// Reads an 8-bit sRGB picture (PNG, JPEG) into scene-linear RGB (H×W×3), its colours as they are stored:
/// alpha is left out. InputError naming the file if it is unreadable, no regular file, larger than
/// kMaxPixels, not of the `expected` size, or turned by its EXIF orientation (calibrations are of pixels as
/// they are stored).
ImageF read_srgb(const std::filesystem::path& path, PictureSize expected = {});
/// Writes scene-linear RGB (3 channels; or 1, as grey) as 8-bit sRGB PNG, atomically.
void write_srgb(const std::filesystem::path& path, const ImageF& linear);
/// The PNG file's bytes, for embedding.
std::string encode_srgb_png(const ImageF& linear);
/// The reverse of encode_srgb_png, for any picture in memory (PNG, JPEG): scene-linear RGB. InputError with
/// `where` as the file and `field`, as read_srgb.
ImageF decode_srgb(std::string_view bytes, const std::string& where, const std::string& field,
                   PictureSize expected = {});
/// The size in the file's header, without reading pixels; at most kMaxPixels.
PictureSize read_image_size(const std::filesystem::path& path);

/// Depth (m, one channel) as KITTI's depth benchmark stores it: 16-bit PNG of round(256 · depth), 0 where
/// there is none. Quantised to 1/256 m; depths beyond 255.99 m are stored as that. Written atomically.
void write_depth_png(const std::filesystem::path& path, const ImageF& depth);
/// InputError if it is not a 16-bit grey PNG.
ImageF read_depth_png(const std::filesystem::path& path);

/// Whole numbers (one channel, 0 … 65535) as 16-bit grey PNG, atomically: which object each pixel shows.
void write_index_png(const std::filesystem::path& path, const Image<std::uint16_t>& indices);
/// InputError if it is not a 16-bit grey PNG.
Image<std::uint16_t> read_index_png(const std::filesystem::path& path);

/// Reads an EXR as it is: float, all channels of the first part; `names`, if given, receives their names.
/// InputError as read_srgb's.
ImageF read_exr(const std::filesystem::path& path, PictureSize expected = {},
                std::vector<std::string>* names = nullptr);
/// Writes float channels unchanged (32-bit), atomically.
void write_exr(const std::filesystem::path& path, const ImageF& image);

}  // namespace mirage
