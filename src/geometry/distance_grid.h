// Signed distances sampled on a regular grid, read back by trilinear interpolation.
#pragma once

#include <array>
#include <vector>

#include "base/types.h"

namespace mirage {

/// Nodes of a regular grid: node (i, j, k) stands at origin + spacing ∘ (i, j, k) and has the number
/// i + nx (j + ny k).
struct GridLayout {
  Vec3d origin = Vec3d::Zero();
  Vec3d spacing = Vec3d::Ones();  ///< m
  std::array<int, 3> count = {0, 0, 0};

  /// Number of nodes.
  std::size_t size() const { return static_cast<std::size_t>(count[0]) * count[1] * count[2]; }
  /// Place of a node among the values: i runs fastest.
  std::size_t index(int i, int j, int k) const {
    return i + static_cast<std::size_t>(count[0]) * (j + static_cast<std::size_t>(count[1]) * k);
  }
  /// Where a node lies (m).
  Vec3d node(int i, int j, int k) const { return origin + spacing.cwiseProduct(Vec3d(i, j, k)); }
};

/// The eight nodes around a point, their trilinear weights and the weights' derivatives (1/m) to the point.
/// A point outside the grid is moved to the nearest point of it; `outside` is how far (m), and the weights
/// don't change along the axes on which it was moved.
struct GridCell {
  std::array<std::size_t, 8> nodes;
  std::array<double, 8> weights;
  std::array<Vec3d, 8> gradients;
  double outside = 0;
};
/// The cell around p, or around the nearest point of the grid where p is outside.
GridCell cell_at(const GridLayout& layout, const Vec3d& p);

/// Signed distances (m) at the nodes of a grid.
struct DistanceGrid {
  GridLayout layout;
  std::vector<float> values;  ///< m, negative inside; one a node

  /// Trilinear value at p (m), beyond the grid plus the distance to it.
  double at(const Vec3d& p) const;
};

}  // namespace mirage
