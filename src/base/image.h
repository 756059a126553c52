// A dense image: row-major, channels interleaved, row 0 on top, pixel (u, v) = (column, row).
// Inside the program colour images are scene-linear float RGB (src/README.md, Conventions).
#pragma once

#include <cstddef>
#include <vector>

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
        data(static_cast<std::size_t>(width_) * height_ * channels_, fill) {}

  /// The channels of column u, row v; not checked.
  T* pixel(int u, int v) { return data.data() + (static_cast<std::size_t>(v) * width + u) * channels; }
  /// The channels of column u, row v; not checked.
  const T* pixel(int u, int v) const {
    return data.data() + (static_cast<std::size_t>(v) * width + u) * channels;
  }
  /// Channel c of column u, row v; not checked.
  T& at(int u, int v, int c = 0) { return pixel(u, v)[c]; }
  /// Channel c of column u, row v; not checked.
  const T& at(int u, int v, int c = 0) const { return pixel(u, v)[c]; }
  /// Whether it has no values.
  bool empty() const { return data.empty(); }
};

/// What pictures, depths and masks are held in.
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

}  // namespace mirage
