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

/// Adds each point's mass (`masses`: one a point, null for ones) to the voxels.
template <class T>
void spread(const Tensor& points, const T* masses, const Window& in, Tensor& sums) {
  T* out = sums.data_ptr<T>();
  for (std::int64_t i = 0; i < points.size(0); ++i) {
    const Corner<T> corner = corner_of(points.data_ptr<T>() + i * points.size(1));
    if (!corner.inside) continue;
    const T mass = masses ? masses[i] : T(1);
    for_each_corner(corner, in, [&](std::int64_t voxel, const auto& w, const auto&) {
      out[voxel] += mass * w[0] * w[1] * w[2];
    });
  }
}

template <class T>
void bound(Tensor& sums) {
  T* out = sums.data_ptr<T>();
  for (std::int64_t k = 0; k < sums.numel(); ++k) out[k] /= 1 + out[k];
}

/// Calls visit(point, d loss / d its mass in the voxel, weights, slopes) for the voxels of every point.
template <class T, class Visit>
void for_each_mass(const Tensor& points, const Window& in, const Tensor& occupancy, const Tensor& d_occupancy,
                   const Visit& visit) {
  const T* d = d_occupancy.data_ptr<T>();
  const T* occupied = occupancy.data_ptr<T>();
  for (std::int64_t i = 0; i < points.size(0); ++i) {
    const Corner<T> corner = corner_of(points.data_ptr<T>() + i * points.size(1));
    if (!corner.inside) continue;
    for_each_corner(corner, in, [&](std::int64_t voxel, const auto& w, const auto& s) {
      // d (m / (1 + m)) / d m = 1 / (1 + m)² = (1 − occupancy)²
      const T empty = 1 - occupied[voxel];
      visit(i, d[voxel] * empty * empty, w, s);
    });
  }
}

template <class T>
void gather(const Tensor& points, const Window& in, const Tensor& occupancy, const Tensor& d_occupancy,
            Tensor& d_points) {
  T* rows = d_points.data_ptr<T>();
  for_each_mass<T>(points, in, occupancy, d_occupancy,
                   [&](std::int64_t i, T d_mass, const auto& w, const auto& s) {
                     T* out = rows + i * points.size(1);
                     out[0] += d_mass * s[0] * w[1] * w[2] / static_cast<T>(kPitch[0]);
                     out[1] += d_mass * w[0] * s[1] * w[2] / static_cast<T>(kPitch[1]);
                     out[2] += d_mass * w[0] * w[1] * s[2] / static_cast<T>(kPitch[2]);
                   });
}

template <class T>
void gather_masses(const Tensor& points, const Window& in, const Tensor& occupancy, const Tensor& d_occupancy,
                   Tensor& d_masses) {
  T* out = d_masses.data_ptr<T>();
  for_each_mass<T>(
      points, in, occupancy, d_occupancy,
      [&](std::int64_t i, T d_mass, const auto& w, const auto&) { out[i] += d_mass * w[0] * w[1] * w[2]; });
}

/// Points, further points and their masses.
struct SoftOccupancy : torch::autograd::Function<SoftOccupancy> {
  static Tensor forward(AutogradContext* context, const Tensor& points, const Tensor& further,
                        const Tensor& masses) {
    const Tensor rows = points.contiguous(), more = further.contiguous(), mass = masses.contiguous();
    Tensor occupancy = torch::zeros({kVoxelsX, kVoxelsY, kVoxelsZ}, rows.options());
    AT_DISPATCH_FLOATING_TYPES(rows.scalar_type(), "soft_voxels", [&] {
      spread<scalar_t>(rows, nullptr, kGridWindow, occupancy);
      spread<scalar_t>(more, mass.data_ptr<scalar_t>(), kGridWindow, occupancy);
      bound<scalar_t>(occupancy);
    });
    context->save_for_backward({rows, more, occupancy});
    return occupancy;
  }

  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const variable_list saved = context->get_saved_variables();
    const Tensor &rows = saved[0], &more = saved[1], &occupancy = saved[2], d = gradients[0].contiguous();
    Tensor d_points = torch::zeros_like(rows), d_masses = torch::zeros({more.size(0)}, rows.options());
    AT_DISPATCH_FLOATING_TYPES(rows.scalar_type(), "soft_voxels", [&] {
      gather<scalar_t>(rows, kGridWindow, occupancy, d, d_points);
      gather_masses<scalar_t>(more, kGridWindow, occupancy, d, d_masses);
    });
    return {d_points, Tensor(), d_masses};
  }
};

/// Of a window's maps, as the network has them: voxels as rows × columns × layers.
Tensor layers_last(const Tensor& map) {
  return map.squeeze(0).permute({1, 2, 0}).contiguous();
}

}  // namespace

Tensor soft_voxels(const Tensor& points) {
  return soft_voxels(points, Tensor(), Tensor());
}

Tensor soft_voxels(const Tensor& points, const Tensor& further, const Tensor& masses) {
  // Autograd takes no undefined tensors.
  const bool any = further.defined();
  return SoftOccupancy::apply(points, any ? further : torch::empty({0, 4}, points.options()),
                              any ? masses : torch::empty({0}, points.options()))
      .permute({2, 0, 1})
      .unsqueeze(0);
}

Tensor soft_voxels(const Tensor& points, const Window& in) {
  Tensor occupancy = torch::zeros({in.rows(), in.columns(), kVoxelsZ}, points.options());
  AT_DISPATCH_FLOATING_TYPES(points.scalar_type(), "soft_voxels", [&] {
    spread<scalar_t>(points, nullptr, in, occupancy);
    bound<scalar_t>(occupancy);
  });
  return occupancy.permute({2, 0, 1}).unsqueeze(0);
}

Tensor soft_voxels_vjp(const Tensor& points, const Window& in, const Tensor& voxels, const Tensor& gradient) {
  Tensor d_points = torch::zeros_like(points);
  AT_DISPATCH_FLOATING_TYPES(points.scalar_type(), "soft_voxels", [&] {
    gather<scalar_t>(points, in, layers_last(voxels), layers_last(gradient), d_points);
  });
  return d_points;
}

Tensor soft_voxels_masses(const Tensor& further, const Window& in, const Tensor& voxels,
                          const Tensor& gradient) {
  Tensor d_masses = torch::zeros({further.size(0)}, further.options());
  AT_DISPATCH_FLOATING_TYPES(further.scalar_type(), "soft_voxels", [&] {
    gather_masses<scalar_t>(further, in, layers_last(voxels), layers_last(gradient), d_masses);
  });
  return d_masses;
}

void add_voxels_of(const float* point, Dirty& dirty) {
  const Corner<float> corner = corner_of(point);
  if (!corner.inside) return;
  dirty.add(Window{corner.low[0], corner.low[1], corner.low[0] + 2, corner.low[1] + 2});
}

}  // namespace mirage::fusion
