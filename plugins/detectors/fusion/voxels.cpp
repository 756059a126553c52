#include "voxels.h"

#include <ATen/Dispatch.h>

#include <array>
#include <cmath>

#include "region.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

/// The lower corner of the 8 voxels around a point and its fractions towards the upper one.
template <class T>
struct Corner {
  std::array<std::int64_t, 3> low{};
  std::array<T, 3> fraction{};
  bool inside = false;
};

constexpr std::array<std::int64_t, 3> kSize = {kVoxelsX, kVoxelsY, kVoxelsZ};
constexpr std::array<double, 3> kPitch = {kVoxel, kVoxel, kLayer};

constexpr Window kGridWindow{0, 0, kVoxelsX, kVoxelsY};

template <class T>
Corner<T> corner_of(const T* point) {
  constexpr std::array<double, 3> origin = {kXMin, kYMin, kZMin};
  Corner<T> corner;
  for (int a = 0; a < 3; ++a) {
    const double at = (point[a] - origin[a]) / kPitch[a] - 0.5;
    if (!(at > -1 && at < static_cast<double>(kSize[a]))) return corner;
    const double low = std::floor(at);
    corner.low[a] = static_cast<std::int64_t>(low);
    corner.fraction[a] = static_cast<T>(at - low);
  }
  corner.inside = true;
  return corner;
}

/// Calls visit(index in the window's voxels, weights per axis, signs of their slopes) for the corners inside
/// the window and the grid.
template <class T, class Visit>
void for_each_corner(const Corner<T>& corner, const Window& in, const Visit& visit) {
  if (corner.low[0] + 1 < in.top || corner.low[0] >= in.bottom || corner.low[1] + 1 < in.left ||
      corner.low[1] >= in.right)
    return;
  for (int k = 0; k < 8; ++k) {
    std::array<std::int64_t, 3> at{};
    std::array<T, 3> weight{}, slope{};
    bool inside = true;
    for (int a = 0; a < 3; ++a) {
      const int upper = (k >> a) & 1;
      at[a] = corner.low[a] + upper;
      inside = inside && at[a] >= 0 && at[a] < kSize[a];
      weight[a] = upper ? corner.fraction[a] : 1 - corner.fraction[a];
      slope[a] = upper ? T(1) : T(-1);
    }
    inside = inside && at[0] >= in.top && at[0] < in.bottom && at[1] >= in.left && at[1] < in.right;
    if (inside) visit(((at[0] - in.top) * in.columns() + at[1] - in.left) * kVoxelsZ + at[2], weight, slope);
  }
}

template <class T>
void spread(const Tensor& points, const Window& in, Tensor& occupancy) {
  T* out = occupancy.data_ptr<T>();
  for (std::int64_t i = 0; i < points.size(0); ++i) {
    const Corner<T> corner = corner_of(points.data_ptr<T>() + i * points.size(1));
    if (!corner.inside) continue;
    for_each_corner(corner, in, [&](std::int64_t voxel, const auto& w, const auto&) {
      out[voxel] += w[0] * w[1] * w[2];
    });
  }
  for (std::int64_t k = 0; k < occupancy.numel(); ++k) out[k] /= 1 + out[k];
}

template <class T>
void gather(const Tensor& points, const Window& in, const Tensor& occupancy, const Tensor& d_occupancy,
            Tensor& d_points) {
  const T* d = d_occupancy.data_ptr<T>();
  const T* occupied = occupancy.data_ptr<T>();
  for (std::int64_t i = 0; i < points.size(0); ++i) {
    const Corner<T> corner = corner_of(points.data_ptr<T>() + i * points.size(1));
    if (!corner.inside) continue;
    T* out = d_points.data_ptr<T>() + i * points.size(1);
    for_each_corner(corner, in, [&](std::int64_t voxel, const auto& w, const auto& s) {
      // d (m / (1 + m)) / d m = 1 / (1 + m)² = (1 − occupancy)²
      const T empty = 1 - occupied[voxel], scaled = d[voxel] * empty * empty;
      out[0] += scaled * s[0] * w[1] * w[2] / static_cast<T>(kPitch[0]);
      out[1] += scaled * w[0] * s[1] * w[2] / static_cast<T>(kPitch[1]);
      out[2] += scaled * w[0] * w[1] * s[2] / static_cast<T>(kPitch[2]);
    });
  }
}

struct SoftOccupancy : torch::autograd::Function<SoftOccupancy> {
  static Tensor forward(AutogradContext* context, const Tensor& points) {
    const Tensor rows = points.contiguous();
    Tensor occupancy = torch::zeros({kVoxelsX, kVoxelsY, kVoxelsZ}, rows.options());
    AT_DISPATCH_FLOATING_TYPES(rows.scalar_type(), "soft_voxels",
                               [&] { spread<scalar_t>(rows, kGridWindow, occupancy); });
    context->save_for_backward({rows, occupancy});
    return occupancy;
  }

  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const variable_list saved = context->get_saved_variables();
    Tensor d_points = torch::zeros_like(saved[0]);
    AT_DISPATCH_FLOATING_TYPES(saved[0].scalar_type(), "soft_voxels", [&] {
      gather<scalar_t>(saved[0], kGridWindow, saved[1], gradients[0].contiguous(), d_points);
    });
    return {d_points};
  }
};

}  // namespace

Tensor soft_voxels(const Tensor& points) {
  return SoftOccupancy::apply(points).permute({2, 0, 1}).unsqueeze(0);
}

Tensor soft_voxels(const Tensor& points, const Window& in) {
  Tensor occupancy = torch::zeros({in.rows(), in.columns(), kVoxelsZ}, points.options());
  AT_DISPATCH_FLOATING_TYPES(points.scalar_type(), "soft_voxels",
                             [&] { spread<scalar_t>(points, in, occupancy); });
  return occupancy.permute({2, 0, 1}).unsqueeze(0);
}

Tensor soft_voxels_vjp(const Tensor& points, const Window& in, const Tensor& voxels, const Tensor& gradient) {
  Tensor d_points = torch::zeros_like(points);
  const auto rows = [](const Tensor& map) { return map.squeeze(0).permute({1, 2, 0}).contiguous(); };
  AT_DISPATCH_FLOATING_TYPES(points.scalar_type(), "soft_voxels",
                             [&] { gather<scalar_t>(points, in, rows(voxels), rows(gradient), d_points); });
  return d_points;
}

void add_voxels_of(const float* point, Dirty& dirty) {
  const Corner<float> corner = corner_of(point);
  if (!corner.inside) return;
  dirty.add(Window{corner.low[0], corner.low[1], corner.low[0] + 2, corner.low[1] + 2});
}

}  // namespace mirage::fusion
