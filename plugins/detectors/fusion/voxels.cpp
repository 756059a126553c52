#include "voxels.h"

#include <array>
#include <cmath>

#include "region.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

/// The lower corner of the 8 voxels around a point and its fractions towards the upper one.
struct Corner {
  std::array<std::int64_t, 3> low{};
  std::array<float, 3> fraction{};
  bool inside = false;
};

constexpr std::array<std::int64_t, 3> kSize = {kVoxelsX, kVoxelsY, kVoxelsZ};

Corner corner_of(const float* point) {
  constexpr std::array<double, 3> origin = {kXMin, kYMin, kZMin};
  Corner corner;
  for (int a = 0; a < 3; ++a) {
    const double at = (point[a] - origin[a]) / kVoxel - 0.5;
    if (!(at > -1 && at < static_cast<double>(kSize[a]))) return corner;
    const double low = std::floor(at);
    corner.low[a] = static_cast<std::int64_t>(low);
    corner.fraction[a] = static_cast<float>(at - low);
  }
  corner.inside = true;
  return corner;
}

/// Calls visit(voxel index, weights per axis, signs of their slopes) for the corners inside the grid.
template <class Visit>
void for_each_corner(const Corner& corner, const Visit& visit) {
  for (int k = 0; k < 8; ++k) {
    std::array<std::int64_t, 3> at{};
    std::array<float, 3> weight{}, slope{};
    bool inside = true;
    for (int a = 0; a < 3; ++a) {
      const int upper = (k >> a) & 1;
      at[a] = corner.low[a] + upper;
      inside = inside && at[a] >= 0 && at[a] < kSize[a];
      weight[a] = upper ? corner.fraction[a] : 1 - corner.fraction[a];
      slope[a] = upper ? 1.f : -1.f;
    }
    if (inside) visit((at[0] * kVoxelsY + at[1]) * kVoxelsZ + at[2], weight, slope);
  }
}

struct TrilinearMass : torch::autograd::Function<TrilinearMass> {
  static Tensor forward(AutogradContext* context, const Tensor& points) {
    context->save_for_backward({points});
    const Tensor rows = points.contiguous();
    Tensor mass = torch::zeros({kVoxelsX, kVoxelsY, kVoxelsZ}, rows.options());
    float* out = mass.data_ptr<float>();
    for (std::int64_t i = 0; i < rows.size(0); ++i) {
      const Corner corner = corner_of(rows.data_ptr<float>() + i * rows.size(1));
      if (!corner.inside) continue;
      for_each_corner(
          corner, [&](std::int64_t voxel, const auto& w, const auto&) { out[voxel] += w[0] * w[1] * w[2]; });
    }
    return mass;
  }

  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const Tensor rows = context->get_saved_variables()[0].contiguous();
    const Tensor d_mass = gradients[0].contiguous();
    Tensor d_points = torch::zeros_like(rows);
    const float* d = d_mass.data_ptr<float>();
    const std::int64_t columns = rows.size(1);
    for (std::int64_t i = 0; i < rows.size(0); ++i) {
      const Corner corner = corner_of(rows.data_ptr<float>() + i * columns);
      if (!corner.inside) continue;
      float* out = d_points.data_ptr<float>() + i * columns;
      for_each_corner(corner, [&](std::int64_t voxel, const auto& w, const auto& s) {
        const float scaled = d[voxel] / static_cast<float>(kVoxel);
        out[0] += scaled * s[0] * w[1] * w[2];
        out[1] += scaled * w[0] * s[1] * w[2];
        out[2] += scaled * w[0] * w[1] * s[2];
      });
    }
    return {d_points};
  }
};

}  // namespace

Tensor soft_voxels(const Tensor& points) {
  const Tensor mass = TrilinearMass::apply(points);
  return (mass / (1 + mass)).permute({2, 0, 1}).unsqueeze(0);
}

}  // namespace mirage::fusion
