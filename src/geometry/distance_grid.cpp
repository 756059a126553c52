#include "geometry/distance_grid.h"

#include <algorithm>
#include <cmath>

namespace mirage {

GridCell cell_at(const GridLayout& layout, const Vec3d& p) {
  GridCell cell;
  int low[3];
  double t[3];
  bool moved[3];
  Vec3d away = Vec3d::Zero();
  for (int a = 0; a < 3; ++a) {
    const double place = (p[a] - layout.origin[a]) / layout.spacing[a];
    const double kept = std::clamp(place, 0.0, static_cast<double>(layout.count[a] - 1));
    low[a] = std::min(static_cast<int>(kept), layout.count[a] - 2);
    t[a] = kept - low[a];
    moved[a] = kept != place;
    away[a] = (place - kept) * layout.spacing[a];
  }
  cell.outside = away.norm();
  for (int corner = 0; corner < 8; ++corner) {
    double w[3], slope[3];
    for (int a = 0; a < 3; ++a) {
      const bool high = corner >> a & 1;
      w[a] = high ? t[a] : 1 - t[a];
      slope[a] = moved[a] ? 0 : (high ? 1 : -1) / layout.spacing[a];
    }
    cell.nodes[corner] =
        layout.index(low[0] + (corner & 1), low[1] + (corner >> 1 & 1), low[2] + (corner >> 2 & 1));
    cell.weights[corner] = w[0] * w[1] * w[2];
    cell.gradients[corner] = {slope[0] * w[1] * w[2], w[0] * slope[1] * w[2], w[0] * w[1] * slope[2]};
  }
  return cell;
}

double DistanceGrid::at(const Vec3d& p) const {
  const GridCell cell = cell_at(layout, p);
  double value = cell.outside;
  for (int corner = 0; corner < 8; ++corner) value += cell.weights[corner] * values[cell.nodes[corner]];
  return value;
}

}  // namespace mirage
