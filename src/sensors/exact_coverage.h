// The picture of a mesh by an area-sampling camera, and its derivative, both exact.
//
// A pixel's colour is the mean of the visible colour over its square: with V_t ⊂ R² the part of the picture
// in which texel t of a face is the nearest surface (coverage/visible.h), c_t its colour and B the
// photograph's pixel,
//     A_i = Σ_t |V_t ∩ pixel i|,    I_i = Σ_t |V_t ∩ pixel i| c_t + (1 − A_i) B_i               (areas in
//     px²)
// Every V_t is a polygon: faces, their occluders, crossings of faces and borders of texels
// (perspective-correct barycentrics, TexelAtlas) are straight on screen. So there are no samples, no σ and no
// γ. By Green's theorem an area is a sum over the polygon's edges, each of which meets few pixels.
//
// The VJP is the derivative of these areas (Reynolds' transport theorem): over every visible edge e, with
// outward normal n and v the speed at which the edge moves,
//     d loss = Σ_i g_i · Σ_e ∫_{e ∩ pixel i} (c_inside − c_outside) (v · n) ds,        g = d loss / d (I, A)
// v is linear along an edge: silhouettes and mesh edges move with their two vertices, borders of texels with
// their points of the face, a crossing of faces F and G with both
// (v · n = −∂(1/z_G − 1/z_F) / |∇(1/z_G − 1/z_F)|). A hidden part has no influence and no gradient. Edges
// that coincide exactly (kinks of the loss) take one side's derivative. Ideas: Li, Aittala, Durand and
// Lehtinen (SIGGRAPH Asia 2018), Laine et al. (nvdiffrast, 2020), Pidhorskyi et al. (EdgeGrad, ECCV 2024).
#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <memory>
#include <vector>

#include "base/image.h"
#include "base/sizes.h"
#include "base/types.h"
#include "sensors/soft_rasterizer.h"

namespace mirage::coverage {

// The pixels that a straight edge crosses.

/// Follows the edge p → q through a grid of width × height unit pixels. Calls visit(i, j, dy, x, t, dt) for
/// each pixel (column i, row j) that it crosses: dy is the signed height of the part inside, x the middle of
/// that part in [0, 1] from the pixel's left, t the middle as a share of the edge, dt the part's share. Calls
/// left(j, dy) for the part left of the grid in row j. Ignores parts right of, above or below the grid.
template <class Visit, class Left>
void walk(const Vec2d& p, const Vec2d& q, int width, int height, const Visit& visit, const Left& left) {
  const double dx = q.x() - p.x(), dy = q.y() - p.y();
  const auto within = [&](const Vec2d& a) {
    return a.x() >= 0 && a.y() >= 0 && a.x() < width && a.y() < height;
  };
  if (within(p) && within(q)) {
    const int i = static_cast<int>(p.x()), j = static_cast<int>(p.y());
    if (i == static_cast<int>(q.x()) && j == static_cast<int>(q.y())) {
      visit(i, j, dy, (p.x() + q.x()) / 2 - i, 0.5, 1.0);
      return;
    }
  }
  constexpr double kNever = std::numeric_limits<double>::infinity();
  double begin = 0, end = 1;
  if (dy != 0) {
    const double top = -p.y() / dy, bottom = (height - p.y()) / dy;
    begin = std::max(begin, std::min(top, bottom));
    end = std::min(end, std::max(top, bottom));
  } else if (!(p.y() >= 0 && p.y() < height)) {
    return;
  }
  if (!(begin < end)) return;
  // Its crossings of the grid's left and right sides.
  double inner_begin = begin, inner_end = end, left_begin = end, left_end = end;
  if (dx > 0) {
    const double enters = -p.x() / dx, leaves = (width - p.x()) / dx;
    left_begin = begin, left_end = std::min(end, enters);
    inner_begin = std::max(begin, enters), inner_end = std::min(end, leaves);
  } else if (dx < 0) {
    const double enters = (width - p.x()) / dx, leaves = -p.x() / dx;
    inner_begin = std::max(begin, enters), inner_end = std::min(end, leaves);
    left_begin = std::max(begin, leaves);
  } else if (p.x() < 0) {
    left_begin = begin, inner_end = inner_begin;
  } else if (p.x() >= width) {
    return;
  }
  const int step_i = dx > 0 ? 1 : -1, step_j = dy > 0 ? 1 : -1;
  const auto row_of = [&](double t) {
    return static_cast<int>(std::clamp(p.y() + dy * t, 0.0, height - 1.0));
  };
  // The grid's own sides don't count: rounding may end the edge just before one.
  const auto next_row = [&](int j) {
    const int border = dy > 0 ? j + 1 : j;
    return dy == 0 || border == 0 || border == height ? kNever : (border - p.y()) / dy;
  };
  if (left_begin < left_end && dy != 0) {
    int j = row_of(left_begin);
    for (double t = left_begin; t < left_end; j += step_j) {
      const double to = std::clamp(next_row(j), t, left_end);
      left(j, dy * (to - t));
      t = to;
      if (to == left_end) break;
    }
  }
  if (!(inner_begin < inner_end)) return;
  const auto next_column = [&](int i) {
    const int border = dx > 0 ? i + 1 : i;
    return dx == 0 || border == 0 || border == width ? kNever : (border - p.x()) / dx;
  };
  int i = static_cast<int>(std::clamp(p.x() + dx * inner_begin, 0.0, width - 1.0)), j = row_of(inner_begin);
  double column = next_column(i), row = next_row(j);
  for (double t = inner_begin;;) {
    const double to = std::clamp(std::min(column, row), t, inner_end);
    if (to > t) {
      const double middle = (t + to) / 2;
      visit(i, j, dy * (to - t), p.x() + dx * middle - i, middle, to - t);
    }
    t = to;
    if (t >= inner_end) return;
    if (column <= row) {
      i += step_i;
      column = next_column(i);
    } else {
      j += step_j;
      row = next_row(j);
    }
  }
}

// A grid of pixels on which areas are summed, and its adjoint.

/// Red, green, blue and coverage.
using Four = Eigen::Array4d;

/// A part of the window that is drawn separately: all pixels without a limit within the object, or one pixel
/// with such a limit.
struct Canvas {
  PixelRect rect;                   ///< in the window
  std::size_t first = 0, last = 0;  ///< its edges
};

/// Position of a pixel's depth limit relative to the object.
enum class DepthLimit : char { behind_object, inside_object, before_object };

/// Area to the right of each edge, summed up along the rows of a canvas.
class Areas {
 public:
  /// `rect`: the canvas. Clears and fills `memory`, which must outlive it.
  Areas(std::vector<Four>& memory, const PixelRect& rect)
      : sums_(memory), width_(rect.width()), height_(rect.height()) {
    sums_.assign(as_size(width_ + 1) * as_size(height_), Four::Zero());
  }
  /// Adds an edge (pixels of the canvas); `colour`: its left colour less its right.
  void add(const Vec2d& from, const Vec2d& to, const Four& colour) {
    // Counter-clockwise in (x, y): the left of an area goes towards smaller y.
    const auto visit = [&](int i, int j, double dy, double x, double, double) {
      Four* at = row(j) + i;
      at[0] -= dy * (1 - x) * colour;
      at[1] -= dy * x * colour;
    };
    walk(from, to, width_, height_, visit, [&](int j, double dy) { row(j)[0] -= dy * colour; });
  }
  /// After the last edge: the sums of row j, for each pixel the part inside it.
  const Four* finish(int j) {
    Four* at = row(j);
    for (int i = 1; i < width_; ++i) at[i] += at[i - 1];
    return at;
  }

 private:
  Four* row(int j) { return sums_.data() + as_size(j) * as_size(width_ + 1); }

  std::vector<Four>& sums_;
  int width_, height_;
};

/// d loss / d (colour, coverage) of a canvas's pixels, and its sums over the pixels to the right of each.
struct UpstreamSums {
  int width = 0;
  std::vector<Four> at, right;

  /// Fills both; of(u, v) is d loss / d colour and coverage of a pixel of the window.
  template <class Of>
  void fill(const PixelRect& rect, const Of& of) {
    width = rect.width();
    const auto count = as_size(width) * as_size(rect.height());
    at.resize(count);
    right.resize(count);
    for (int j = 0; j < rect.height(); ++j) {
      Four sum = Four::Zero();
      for (int i = width; i-- > 0;) {
        const std::size_t k = as_size(j) * as_size(width) + as_size(i);
        right[k] = sum;
        at[k] = of(rect.u0 + i, rect.v0 + j);
        sum += at[k];
      }
    }
  }
};

}  // namespace mirage::coverage

namespace mirage {

/// Data of a forward pass for its VJP. Its memory is reused from call to call.
class ExactTape {
 public:
  ExactTape();
  ~ExactTape();

  Image<double> rgba;  ///< window-sized: I and A
  double area = 0;     ///< px² of the whole object, up to one image's size beyond the image; no depth limit

  struct State;
  std::unique_ptr<State> state;
};

/// Draws both sides of all faces (Texture::atlas only), with perspective-correct texture; ignores
/// `supersampling`. In each pixel, surfaces are cut along z = limit; the part behind the depth limit is not
/// drawn. Skips faces without an area (kNoArea), with a coordinate that is not finite or a depth ≤ 0.
/// InputError, naming it, for a colour that is not finite and for Texture::vertex.
template <class S>
void draw_exact(const ScreenMesh<double>& mesh, const RasterTarget<S>& target, ExactTape& tape);

/// VJP of the last draw_exact into this tape, of the same mesh and target; d_rgba is window-sized RGBA.
/// Fills ScreenGradient::corner_barycentrics if the mesh has parts of clipped faces.
template <class S>
ScreenGradient<double> draw_exact_vjp(const ScreenMesh<double>& mesh, const RasterTarget<S>& target,
                                      const Image<double>& d_rgba, const ExactTape& tape);

}  // namespace mirage
