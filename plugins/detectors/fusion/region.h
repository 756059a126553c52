// The searched region and its grids, stated once. Frame `velo`, metres.
#pragma once

#include <array>
#include <cstdint>

namespace mirage::fusion {

inline constexpr double kXMin = 0.0, kXMax = 70.0;
inline constexpr double kYMin = -40.0, kYMax = 40.0;
inline constexpr double kZMin = -2.6, kZMax = 1.0;

/// Voxels of the LiDAR input: 280 × 320 cells of 0.25 m, 18 layers of 0.2 m.
inline constexpr double kVoxel = 0.25, kLayer = 0.2;
inline constexpr std::int64_t kVoxelsX = 280, kVoxelsY = 320, kVoxelsZ = 18;

/// A grid of the bird's-eye view over the region: rows along x, columns along y.
struct Grid {
  std::int64_t rows, columns;
  double cell;   ///< m
  double reach;  ///< m: how far the point may be that gives a cell its image feature
};
/// The four scales of the backbone and of the fusion. Proposals live on the first. (18 rows of 4 m reach to
/// 72 m: the last is half empty.)
inline constexpr std::array<Grid, 4> kGrids = {
    {{140, 160, 0.5, 1.5}, {70, 80, 1.0, 2.0}, {35, 40, 2.0, 3.0}, {18, 20, 4.0, 4.0}}};
inline constexpr double kCell = kGrids[0].cell;
inline constexpr std::int64_t kCellsX = kGrids[0].rows, kCellsY = kGrids[0].columns;

/// Cell (row, column) is (along x, along y); its centre:
inline double cell_x(std::int64_t row, double cell) {
  return kXMin + (static_cast<double>(row) + 0.5) * cell;
}
inline double cell_y(std::int64_t column, double cell) {
  return kYMin + (static_cast<double>(column) + 0.5) * cell;
}

/// Regression is relative to the mean car of KITTI.
inline constexpr double kMeanLength = 3.9, kMeanWidth = 1.6;

}  // namespace mirage::fusion
