// The searched region and its grids, stated once. Frame `velo`, metres.
#pragma once

#include <cstdint>

namespace mirage::fusion {

inline constexpr double kXMin = 0.0, kXMax = 51.2;
inline constexpr double kYMin = -25.6, kYMax = 25.6;
inline constexpr double kZMin = -2.6, kZMax = 1.0;

/// Voxels of the LiDAR input: 256 × 256 cells of 0.2 m, 18 layers of 0.2 m.
inline constexpr double kVoxel = 0.2;
inline constexpr std::int64_t kVoxelsX = 256, kVoxelsY = 256, kVoxelsZ = 18;

/// Proposals and the fine fusion live on 128 × 128 cells of 0.4 m, the coarse fusion on 64 × 64 of 0.8 m.
inline constexpr double kCell = 0.4;
inline constexpr std::int64_t kCellsX = 128, kCellsY = 128;
inline constexpr double kCoarseCell = 0.8;
inline constexpr std::int64_t kCoarseX = 64, kCoarseY = 64;

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
