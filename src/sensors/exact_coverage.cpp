#include "sensors/exact_coverage.h"

#include <fmt/format.h>

#include <array>
#include <cmath>

#include "base/error.h"
#include "sensors/coverage/outline.h"

namespace mirage {

struct ExactTape::State {
  coverage::Visible visible;
  coverage::Outline outline;
  std::vector<coverage::Canvas> canvases;
  std::vector<coverage::DepthLimit> limits;  ///< of the window's pixels; empty: none in the object's reach
  std::vector<coverage::Four> areas;         ///< scratch
};

ExactTape::ExactTape() : state(std::make_unique<State>()) {}
ExactTape::~ExactTape() = default;

namespace {

using coverage::Areas;
using coverage::Canvas;
using coverage::DepthLimit;
using coverage::Edge;
using coverage::Four;
using coverage::Outline;
using coverage::Piece;
using coverage::Visible;

Four colour_of(const ScreenMesh<double>& mesh, int texel) {
  if (texel < 0) return Four::Zero();
  const Vec3d& c = mesh.texels[as_size(texel)];
  return {c[0], c[1], c[2], 1};
}

void check_drawable(const ScreenMesh<double>& mesh) {
  if (mesh.texture != Texture::atlas)
    throw InputError("exact coverage", "texture", "is not an atlas of texels",
                     "draw colours of vertices with the soft rasteriser");
  for (std::size_t t = 0; t < mesh.texels.size(); ++t)
    if (!mesh.texels[t].allFinite())
      throw InputError("exact coverage", fmt::format("texel {}", t), "not finite", "correct the colour");
}

template <class S>
std::vector<DepthLimit> find_limits(const Visible& visible, const RasterTarget<S>& target) {
  std::vector<coverage::DepthLimit> limits;
  if (target.depth_limit.empty() || visible.faces.empty()) return limits;
  double nearest = 0, farthest = std::numeric_limits<double>::infinity();  // 1/z
  for (const auto& face : visible.faces) {
    nearest = std::max(nearest, face.nearest);
    farthest = std::min(farthest, face.farthest);
  }
  bool any = false;
  for (const S limit : target.depth_limit.data) {
    const double z = static_cast<double>(limit);
    limits.push_back(z * nearest <= 1   ? DepthLimit::before_object
                     : z * farthest < 1 ? DepthLimit::inside_object
                                        : DepthLimit::behind_object);
    any |= limits.back() != DepthLimit::behind_object;
  }
  if (!any) limits.clear();
  return limits;
}

/// Whether a piece can be in a canvas, or to its right, where the row sums begin.
bool meets(const Visible& visible, const Piece& piece, const PixelRect& rect) {
  const auto& face = visible.faces[as_size(piece.face)];
  return face.low.x() < rect.u1 && face.high.x() > rect.u0 && face.low.y() < rect.v1 &&
         face.high.y() > rect.v0;
}

void outline_all(const ScreenMesh<double>& mesh, const PixelRect& rect, double limit,
                 ExactTape::State& state) {
  const std::size_t first = state.outline.edges.size();
  for (const Piece& piece : state.visible.pieces)
    if (meets(state.visible, piece, rect))
      coverage::outline_piece(mesh, state.visible, piece, state.outline, limit);
  state.canvases.push_back({rect, first, state.outline.edges.size()});
}

template <class S>
void draw_canvas(const ScreenMesh<double>& mesh, const RasterTarget<S>& target, const Canvas& canvas,
                 ExactTape::State& state, Image<double>& rgba) {
  Areas areas(state.areas, canvas.rect);
  const Vec2d origin(canvas.rect.u0, canvas.rect.v0);
  const auto& points = state.outline.points;
  for (std::size_t e = canvas.first; e < canvas.last; ++e) {
    const Edge& edge = state.outline.edges[e];
    const Four step = colour_of(mesh, edge.inside) - colour_of(mesh, edge.outside);
    areas.add(points[as_size(edge.from)].p - origin, points[as_size(edge.to)].p - origin, step);
  }
  // Snaps sums that are 0 or 1 up to rounding: a colour out of range would count as saturated.
  constexpr double kRounding = 1e-12;
  for (int j = 0; j < canvas.rect.height(); ++j) {
    const Four* sums = areas.finish(j);
    for (int i = 0; i < canvas.rect.width(); ++i) {
      const int u = canvas.rect.u0 + i, v = canvas.rect.v0 + j;
      double* out = rgba.pixel(u, v);
      const S* photograph = target.background.pixel(u, v);
      for (int c = 0; c < 4; ++c) {
        double value = sums[i][c];
        if (c < 3) value += (1 - sums[i][3]) * static_cast<double>(photograph[c]);
        if (std::abs(value) < kRounding) value = 0;
        if (std::abs(value - 1) < kRounding) value = 1;
        out[c] = value;
      }
    }
  }
}

}  // namespace

template <class S>
void draw_exact(const ScreenMesh<double>& mesh, const RasterTarget<S>& target, ExactTape& tape) {
  check_drawable(mesh);
  ExactTape::State& state = *tape.state;
  const int width = target.rect.width(), height = target.rect.height();
  coverage::find_visible(mesh, target.width, target.height, target.rect, state.visible);
  tape.area = state.visible.area;
  state.outline.points.clear();
  state.outline.edges.clear();
  state.canvases.clear();
  state.limits = find_limits(state.visible, target);
  tape.rgba = Image<double>(width, height, 4);
  if (target.rect.empty()) return;
  outline_all(mesh, {0, 0, width, height}, std::numeric_limits<double>::infinity(), state);
  draw_canvas(mesh, target, state.canvases.back(), state, tape.rgba);
  for (std::size_t k = 0; k < state.limits.size(); ++k) {
    if (state.limits[k] == DepthLimit::behind_object) continue;
    const int u = static_cast<int>(k) % width, v = static_cast<int>(k) / width;
    if (state.limits[k] == DepthLimit::inside_object) {
      outline_all(mesh, {u, v, u + 1, v + 1}, static_cast<double>(target.depth_limit.data[k]), state);
      draw_canvas(mesh, target, state.canvases.back(), state, tape.rgba);
      continue;
    }
    for (int c = 0; c < 3; ++c) tape.rgba.at(u, v, c) = static_cast<double>(target.background.at(u, v, c));
    tape.rgba.at(u, v, 3) = 0;
  }
}

template <class S>
ScreenGradient<double> draw_exact_vjp(const ScreenMesh<double>& mesh, const RasterTarget<S>& target,
                                      const Image<double>& d_rgba, const ExactTape& tape) {
  const ExactTape::State& state = *tape.state;
  const auto& points = state.outline.points;
  const int width = target.rect.width();
  ScreenGradient<double> gradient;
  const std::array<Vec3d, 3> none{Vec3d::Zero(), Vec3d::Zero(), Vec3d::Zero()};
  gradient.faces.assign(mesh.faces.size(), none);
  gradient.texels.assign(mesh.texels.size(), Vec3d::Zero());
  gradient.corner_barycentrics.assign(mesh.corner_barycentrics.size(), none);

  std::vector<Vec2d> edge_gradients(points.size(), Vec2d::Zero());
  coverage::UpstreamSums upstream;
  for (std::size_t which = 0; which < state.canvases.size(); ++which) {
    const Canvas& canvas = state.canvases[which];
    upstream.fill(canvas.rect, [&](int u, int v) -> Four {
      if (which == 0 && !state.limits.empty() &&
          state.limits[as_size(v) * as_size(width) + as_size(u)] != DepthLimit::behind_object)
        return Four::Zero();
      const double* d = d_rgba.pixel(u, v);
      const S* photograph = target.background.pixel(u, v);
      Four result(d[0], d[1], d[2], d[3]);
      for (int c = 0; c < 3; ++c) result[3] -= result[c] * static_cast<double>(photograph[c]);
      return result;
    });
    const Vec2d origin(canvas.rect.u0, canvas.rect.v0);
    for (std::size_t e = canvas.first; e < canvas.last; ++e) {
      const Edge& edge = state.outline.edges[e];
      const auto from = as_size(edge.from), to = as_size(edge.to);
      const Four step = colour_of(mesh, edge.inside) - colour_of(mesh, edge.outside);
      Four area = Four::Zero();  // Σ g · area right of the edge
      double at_from = 0, at_to = 0;
      const auto visit = [&](int i, int j, double dy, double x, double t, double dt) {
        const std::size_t k = as_size(j) * as_size(upstream.width) + as_size(i);
        const Four& g = upstream.at[k];
        area -= dy * ((1 - x) * g + upstream.right[k]);
        const double push = dt * (step * g).sum();
        at_from += (1 - t) * push;
        at_to += t * push;
      };
      const auto left = [&](int j, double dy) {
        const std::size_t k = as_size(j) * as_size(upstream.width);
        area -= dy * (upstream.at[k] + upstream.right[k]);
      };
      coverage::walk(points[from].p - origin, points[to].p - origin, canvas.rect.width(),
                     canvas.rect.height(), visit, left);
      if (edge.inside >= 0) gradient.texels[as_size(edge.inside)] += area.head<3>().matrix();
      if (edge.outside >= 0) gradient.texels[as_size(edge.outside)] -= area.head<3>().matrix();
      const Vec2d along = points[to].p - points[from].p, outward(along.y(), -along.x());
      edge_gradients[from] += at_from * outward;
      edge_gradients[to] += at_to * outward;
    }
  }

  const double longer = std::max(target.width, target.height);
  std::vector<coverage::FaceGradient> face_gradients(state.visible.faces.size());
  coverage::add_edge_gradients(mesh, state.visible, state.outline, edge_gradients, longer, face_gradients);
  const double pixels = longer / 2;  // an NDC
  for (std::size_t i = 0; i < face_gradients.size(); ++i) {
    const auto& face = state.visible.faces[i];
    const auto f = as_size(face.face);
    for (int k = 0; k < 3; ++k) {
      const auto corner = as_size(face.corner[k]);
      const Vec2d& d = face_gradients[i].s[k];
      gradient.faces[f][corner] += Vec3d(pixels * d.x(), -pixels * d.y(), face_gradients[i].z[k]);
      if (!gradient.corner_barycentrics.empty())
        gradient.corner_barycentrics[f][corner] += face_gradients[i].barycentrics[k];
    }
  }
  return gradient;
}

#define MIRAGE_INSTANTIATE(S)                                                                          \
  template void draw_exact<S>(const ScreenMesh<double>&, const RasterTarget<S>&, ExactTape&);          \
  template ScreenGradient<double> draw_exact_vjp<S>(const ScreenMesh<double>&, const RasterTarget<S>&, \
                                                    const Image<double>&, const ExactTape&);
MIRAGE_INSTANTIATE(float)
MIRAGE_INSTANTIATE(double)
#undef MIRAGE_INSTANTIATE

}  // namespace mirage
