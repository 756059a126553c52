// A dense image: row-major, channels interleaved, row 0 on top, pixel (u, v) = (column, row).
// Inside the program colour images are scene-linear float RGB (src/README.md, Conventions).
#pragma once

#include <cstddef>
#include <vector>

namespace mirage {

template <class T>
struct Image {
  int width = 0, height = 0, channels = 0;
  std::vector<T> data;

  Image() = default;
  Image(int width_, int height_, int channels_, T fill = T())
      : width(width_),
        height(height_),
        channels(channels_),
        data(static_cast<std::size_t>(width_) * height_ * channels_, fill) {}

  T* pixel(int u, int v) { return data.data() + (static_cast<std::size_t>(v) * width + u) * channels; }
  const T* pixel(int u, int v) const {
    return data.data() + (static_cast<std::size_t>(v) * width + u) * channels;
  }
  T& at(int u, int v, int c = 0) { return pixel(u, v)[c]; }
  const T& at(int u, int v, int c = 0) const { return pixel(u, v)[c]; }
  bool empty() const { return data.empty(); }
};

using ImageF = Image<float>;

/// Half-open pixel rectangle [u0, u1) × [v0, v1).
struct PixelRect {
  int u0 = 0, v0 = 0, u1 = 0, v1 = 0;
  int width() const { return u1 > u0 ? u1 - u0 : 0; }
  int height() const { return v1 > v0 ? v1 - v0 : 0; }
  bool empty() const { return width() == 0 || height() == 0; }
};

}  // namespace mirage
