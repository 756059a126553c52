// A grid of pixels that areas are summed up on, and its adjoint.
#pragma once

#include <cstddef>
#include <vector>

#include "base/image.h"
#include "sensors/coverage/walk.h"

namespace mirage::coverage {

/// Red, green, blue and coverage.
using Four = Eigen::Array4d;

/// A part of the window that is drawn by itself: all of it but the pixels with a limit within the object, and
/// each of these.
struct Canvas {
  PixelRect rect;                   ///< in the window
  std::size_t first = 0, last = 0;  ///< its edges
};

/// How a pixel's depth limit lies to the object.
enum class Limit : char { beyond, within, before };

/// Area to the right of each edge, summed up along the rows of a canvas.
class Areas {
 public:
  Areas(std::vector<Four>& memory, const PixelRect& rect)
      : sums_(memory), width_(rect.width()), height_(rect.height()) {
    sums_.assign(static_cast<std::size_t>(width_ + 1) * height_, Four::Zero());
  }
  void add(const Vec2d& from, const Vec2d& to, const Four& colour) {
    // Counter-clockwise in (x, y): the left of an area goes towards smaller y.
    const auto visit = [&](int i, int j, double dy, double x, double, double) {
      Four* at = row(j) + i;
      at[0] -= dy * (1 - x) * colour;
      at[1] -= dy * x * colour;
    };
    walk(from, to, width_, height_, visit, [&](int j, double dy) { row(j)[0] -= dy * colour; });
  }
  /// After the last edge: the sums of row j; each pixel's is what lies in it.
  const Four* finish(int j) {
    Four* at = row(j);
    for (int i = 1; i < width_; ++i) at[i] += at[i - 1];
    return at;
  }

 private:
  Four* row(int j) { return sums_.data() + static_cast<std::size_t>(j) * (width_ + 1); }

  std::vector<Four>& sums_;
  int width_, height_;
};

/// d loss / d (colour, coverage) of a canvas's pixels, and its sums over what lies right of a pixel.
struct UpstreamSums {
  int width = 0;
  std::vector<Four> at, right;

  template <class Of>
  void fill(const PixelRect& rect, const Of& of) {
    width = rect.width();
    const auto count = static_cast<std::size_t>(width) * rect.height();
    at.resize(count);
    right.resize(count);
    for (int j = 0; j < rect.height(); ++j) {
      Four sum = Four::Zero();
      for (int i = width; i-- > 0;) {
        const std::size_t k = static_cast<std::size_t>(j) * width + i;
        right[k] = sum;
        at[k] = of(rect.u0 + i, rect.v0 + j);
        sum += at[k];
      }
    }
  }
};

}  // namespace mirage::coverage
