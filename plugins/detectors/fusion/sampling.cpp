#include "sampling.h"

#include <ATen/Dispatch.h>

#include <algorithm>
#include <cmath>

#include "base/sizes.h"

namespace mirage::fusion {
namespace {

constexpr double kMinPointDepth = 0.5;  // m

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

/// The two cells along one axis and the share of the upper one.
template <class T>
struct Pair {
  std::int64_t low, high;
  T share;
  bool inside;  // the result moves with the place
};

template <class T>
Pair<T> pair_at(T at, std::int64_t size) {
  const auto last = static_cast<T>(size - 1);
  // Written so that NaN lands on 0.
  const T clamped = at > 0 ? std::min(at, last) : T(0);
  const auto low = static_cast<std::int64_t>(clamped);
  return {low, std::min(low + 1, size - 1), clamped - static_cast<T>(low), at > 0 && at < last};
}

/// The four cells around a place, as offsets into the map, and their weights.
template <class T>
struct Around {
  Around(const T* place, const Tensor& cells)
      : x(pair_at(place[0], cells.size(1))), y(pair_at(place[1], cells.size(0))) {
    const std::int64_t width = cells.size(1), channels = cells.size(2);
    at = {(y.low * width + x.low) * channels, (y.low * width + x.high) * channels,
          (y.high * width + x.low) * channels, (y.high * width + x.high) * channels};
    weight = {(1 - y.share) * (1 - x.share), (1 - y.share) * x.share, y.share * (1 - x.share),
              y.share * x.share};
  }
  Pair<T> x, y;
  std::array<std::int64_t, 4> at;
  std::array<T, 4> weight;
};

template <class T>
void read_places(const Tensor& cells, const Tensor& places, Tensor& read) {
  const std::int64_t channels = cells.size(2);
  const T* f = cells.data_ptr<T>();
  T* out = read.data_ptr<T>();
  for (std::int64_t i = 0; i < places.size(0); ++i, out += channels) {
    const auto [x, y, at, weight] = Around<T>(places.data_ptr<T>() + 2 * i, cells);
    for (std::int64_t c = 0; c < channels; ++c)
      out[c] = weight[0] * f[at[0] + c] + weight[1] * f[at[1] + c] + weight[2] * f[at[2] + c] +
               weight[3] * f[at[3] + c];
  }
}

template <class T>
void read_places_vjp(const Tensor& cells, const Tensor& places, const Tensor& d_read, Tensor& d_cells,
                     Tensor& d_places) {
  const std::int64_t channels = cells.size(2);
  const T* f = cells.data_ptr<T>();
  const T* d = d_read.data_ptr<T>();
  T* df = d_cells.data_ptr<T>();
  for (std::int64_t i = 0; i < places.size(0); ++i, d += channels) {
    const auto [x, y, at, weight] = Around<T>(places.data_ptr<T>() + 2 * i, cells);
    T along_x = 0, along_y = 0;
    for (std::int64_t c = 0; c < channels; ++c) {
      for (std::size_t k = 0; k < 4; ++k) df[at[k] + c] += weight[k] * d[c];
      const T f00 = f[at[0] + c], f01 = f[at[1] + c], f10 = f[at[2] + c], f11 = f[at[3] + c];
      along_x += d[c] * ((1 - y.share) * (f01 - f00) + y.share * (f11 - f10));
      along_y += d[c] * ((1 - x.share) * (f10 - f00) + x.share * (f11 - f01));
    }
    T* dp = d_places.data_ptr<T>() + 2 * i;
    if (x.inside) dp[0] = along_x;
    if (y.inside) dp[1] = along_y;
  }
}

struct Bilinear : torch::autograd::Function<Bilinear> {
  static Tensor forward(AutogradContext* context, const Tensor& map, const Tensor& at) {
    // H × W × C in memory
    const Tensor cells = map.squeeze(0).permute({1, 2, 0}).contiguous(), places = at.contiguous();
    context->save_for_backward({cells, places});
    Tensor read = torch::empty({places.size(0), cells.size(2)}, cells.options());
    AT_DISPATCH_FLOATING_TYPES(cells.scalar_type(), "bilinear",
                               [&] { read_places<scalar_t>(cells, places, read); });
    return read;
  }

  static variable_list backward(AutogradContext* context, const variable_list& gradients) {
    const variable_list saved = context->get_saved_variables();
    Tensor d_cells = torch::zeros_like(saved[0]), d_places = torch::zeros_like(saved[1]);
    AT_DISPATCH_FLOATING_TYPES(saved[0].scalar_type(), "bilinear", [&] {
      read_places_vjp<scalar_t>(saved[0], saved[1], gradients[0].contiguous(), d_cells, d_places);
    });
    return {d_cells.permute({2, 0, 1}).unsqueeze(0), d_places};
  }
};

/// The lower corner of the 8 voxels around a point and its fractions towards the upper one.
template <class T>
struct Corner {
  std::array<std::int64_t, 3> low{};
  std::array<T, 3> fraction{};
  bool inside = false;
};

constexpr std::array<std::int64_t, 3> kSize = {kVoxelsX, kVoxelsY, kVoxelsZ};
constexpr std::array<double, 3> kPitch = {kVoxel, kVoxel, kLayer};

template <class T>
Corner<T> corner_of(const T* point) {
  constexpr std::array<double, 3> origin = {kXMin, kYMin, kZMin};
  Corner<T> corner;
  for (std::size_t a = 0; a < 3; ++a) {
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
    for (std::size_t a = 0; a < 3; ++a) {
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

std::optional<PixelDepth> seen_at(const float* p, const Projection& m, int width, int height) {
  const double w = m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11];
  if (!(w > kMinPointDepth)) return {};
  const double u = (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]) / w;
  const double v = (m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7]) / w;
  if (!(u >= -0.5 && u < width - 0.5 && v >= -0.5 && v < height - 0.5)) return {};
  return PixelDepth{u, v, w};
}

torch::Tensor projected(const torch::Tensor& points, const Projection& projection) {
  const std::vector<double> m(projection.begin(), projection.end());
  const torch::Tensor matrix = torch::tensor(m, points.dtype()).view({3, 4});
  return torch::matmul(points, matrix.narrow(1, 0, 3).t()) + matrix.select(1, 3);
}

torch::Tensor centres_of(std::span<const std::int64_t> cells, const Grid& grid) {
  torch::Tensor centres = torch::empty({static_cast<std::int64_t>(cells.size()), 3});
  float* centre = centres.data_ptr<float>();
  for (const std::int64_t cell : cells) {
    *centre++ = static_cast<float>(cell_x(cell / grid.columns, grid.cell));
    *centre++ = static_cast<float>(cell_y(cell % grid.columns, grid.cell));
    *centre++ = -1;  // halfway up a car
  }
  return centres;
}

Window cells_reached(const Grid& grid, double x, double y) {
  const auto first = [&](double at) {
    return std::max<std::int64_t>(0, std::llround(std::floor((at - grid.reach) / grid.cell)));
  };
  const auto last = [&](double at, std::int64_t count) {
    return std::min<std::int64_t>(count - 1, std::llround(std::floor((at + grid.reach) / grid.cell)));
  };
  return {first(x - kXMin), first(y - kYMin), last(x - kXMin, grid.rows) + 1,
          last(y - kYMin, grid.columns) + 1};
}

bool feeds_cells(const float* p, const Projection& projection, int width, int height) {
  return p[0] >= kXMin && p[0] < kXMax && p[1] >= kYMin && p[1] < kYMax && std::isfinite(p[2]) &&
         seen_at(p, projection, width, height);
}

std::vector<std::int64_t> nearest_in(const Grid& grid, std::span<const float> points,
                                     std::span<const std::int64_t> candidates, const Window& cells) {
  std::vector<std::int64_t> best(as_size(cells.area()), -1);
  std::vector<double> distance(best.size(), grid.reach * grid.reach);
  for (const std::int64_t i : candidates) {
    const double x = points[as_size(4 * i)], y = points[as_size(4 * i + 1)];
    const Window offered = intersection(cells_reached(grid, x, y), cells);
    for (std::int64_t row = offered.top; row < offered.bottom; ++row) {
      const double dx = x - cell_x(row, grid.cell);
      for (std::int64_t column = offered.left; column < offered.right; ++column) {
        const double dy = y - cell_y(column, grid.cell), squared = dx * dx + dy * dy;
        const std::size_t at = as_size((row - cells.top) * cells.columns() + column - cells.left);
        // Points are offered in their order: of two at the same distance the first one stays.
        if (squared > distance[at] || (squared == distance[at] && best[at] >= 0)) continue;
        distance[at] = squared;
        best[at] = i;
      }
    }
  }
  return best;
}

std::array<NearestPoints, kGrids.size()> nearest_points(std::span<const float> points,
                                                        const Projection& projection, int width, int height) {
  std::vector<std::int64_t> visible;
  for (std::size_t i = 0; i < points.size() / 4; ++i)
    if (feeds_cells(points.data() + 4 * i, projection, width, height))
      visible.push_back(static_cast<std::int64_t>(i));
  std::array<NearestPoints, kGrids.size()> nearest;
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    const Grid& grid = kGrids[level];
    const auto best = nearest_in(grid, points, visible, {0, 0, grid.rows, grid.columns});
    for (std::size_t cell = 0; cell < best.size(); ++cell) {
      if (best[cell] < 0) continue;
      nearest[level].cells.push_back(static_cast<std::int64_t>(cell));
      nearest[level].points.push_back(best[cell]);
    }
  }
  return nearest;
}

Tensor bilinear(const Tensor& map, const Tensor& at) {
  return Bilinear::apply(map, at);
}

Tensor places_in_map(const Tensor& pixels, int stride) {
  // Pixel centres are whole numbers, and so are those of the map's places: both edges lie at −1/2.
  return (pixels + 0.5) / stride - 0.5;
}

Tensor features_at(const Tensor& map, const Tensor& points, const Projection& projection, int stride) {
  const Tensor uvw = projected(points, projection);
  return bilinear(map, places_in_map(uvw.narrow(1, 0, 2) / uvw.narrow(1, 2, 1), stride));
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

void add_voxels_of(const float* point, ChangedRegion& dirty) {
  const Corner<float> corner = corner_of(point);
  if (!corner.inside) return;
  dirty.add(Window{corner.low[0], corner.low[1], corner.low[0] + 2, corner.low[1] + 2});
}

}  // namespace mirage::fusion
