// Which point feeds which cell of the bird's-eye view (Liang et al., ContFuse, ECCV 2018, with K = 1).
#pragma once

#include <torch/torch.h>

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "region.h"
#include "window.h"

namespace mirage::fusion {

/// Row-major 3 × 4 projection: (u w, v w, w) = M (x, y, z, 1).
using Projection = std::array<double, 12>;

/// Pixel and depth (m) of a point (x, y, z) in the camera. Empty behind the camera, closer than half a metre
/// (which bounds the division) and outside the picture.
struct PixelDepth {
  double u, v, depth;
};
std::optional<PixelDepth> seen_at(const float* point, const Projection& projection, int width, int height);

/// points: n × 3. Rows (u w, v w, w) of the projection; differentiable.
torch::Tensor projected(const torch::Tensor& points, const Projection& projection);

/// The cells' centres, from which offsets are measured: n × 3.
torch::Tensor centres_of(std::span<const std::int64_t> cells, const Grid& grid);

/// cells[k] (row · columns + column) takes its image feature at points[k].
struct NearestPoints {
  std::vector<std::int64_t> cells, points;
};

/// For each cell of each grid the point nearest to its centre in the ground plane, within the grid's reach,
/// among the points that the camera sees (in front of it and inside width × height). `points`: N × 4 floats.
/// Of points at the same distance the first one counts. The selection is discrete and carries no gradient,
/// everything after it does.
std::array<NearestPoints, kGrids.size()> nearest_points(std::span<const float> points,
                                                        const Projection& projection, int width, int height);

/// A part of nearest_points: whether a point (x, y, z) is in the region and seen by the camera.
bool feeds_cells(const float* point, const Projection& projection, int width, int height);
/// Cells that such a point may be nearest to: those whose centres it reaches, and a cell around them.
Window cells_reached(const Grid& grid, double x, double y);
/// For each cell of a window, row by row, the nearest of `candidates`, which are in the order of the points;
/// −1 where none is within reach.
std::vector<std::int64_t> nearest_in(const Grid& grid, std::span<const float> points,
                                     std::span<const std::int64_t> candidates, const Window& cells);

// Features of a map at scattered places, with the exact derivative.

/// map: 1 × C × H × W; at: N × 2, (column, row) with (0, 0) the centre of the first cell; both on the CPU,
/// float or double. Result: N × C, bilinear, the border's values outside (and no slope there). Differentiable
/// in both.
torch::Tensor bilinear(const torch::Tensor& map, const torch::Tensor& at);

/// Positions of pixels in a map with one place for each stride × stride pixels, as bilinear() takes them.
torch::Tensor places_in_map(const torch::Tensor& pixels, int stride);
/// bilinear() at the pixels of points (N × 3).
torch::Tensor features_at(const torch::Tensor& map, const torch::Tensor& points, const Projection& projection,
                          int stride);

// LiDAR points to a soft occupancy grid, with its exact derivative.

/// All columns of voxels.
inline constexpr Window kGridWindow{0, 0, kVoxelsX, kVoxelsY};

/// points: N × (x, y, z, …) float or double, `velo`, on the CPU. Each point spreads a unit of mass over the 8
/// voxels whose centres surround it, with tri-linear weights; mass outside the grid is dropped, and so are
/// points that are not finite. Result: 1 × 18 × 280 × 320 (layers as channels; rows along x, columns along
/// y), channels-last. Differentiable in x, y and z; reflectance is not read, because sensors and generated
/// sweeps disagree about it. Bounded to [0, 1) by m / (1 + m), so that near, dense cars look like far, thin
/// ones. `further`: K × (x, y, z, …) points whose unit of mass is `masses` (K) instead, differentiable in
/// these; their places have no derivative.
torch::Tensor soft_voxels(const torch::Tensor& points, const torch::Tensor& further = {},
                          const torch::Tensor& masses = {});
/// A window of the same (zero beyond the grid), of float points; no gradient.
torch::Tensor soft_voxels(const torch::Tensor& points, const Window& in);
/// Its VJP: d points (N × 4) from the gradient in the window's voxels.
torch::Tensor soft_voxels_vjp(const torch::Tensor& points, const Window& in, const torch::Tensor& voxels,
                              const torch::Tensor& gradient);
/// The derivative in the masses of further points, where these are 0: K.
torch::Tensor soft_voxels_masses(const torch::Tensor& further, const Window& in, const torch::Tensor& voxels,
                                 const torch::Tensor& gradient);
/// Adds the columns of voxels that a point reaches.
void add_voxels_of(const float* point, ChangedRegion& dirty);

}  // namespace mirage::fusion
