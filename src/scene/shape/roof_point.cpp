#include <algorithm>
#include <cmath>
#include <limits>

#include "base/error.h"
#include "scene/shape/shape_fit.h"

namespace mirage {

Vec3d roof_point(const Mesh& vehicle, double depth) {
  constexpr double kCell = 0.025, kNone = -std::numeric_limits<double>::infinity();
  if (vehicle.faces.empty())
    throw InputError("vehicle mesh", "faces", "there are none", "give a mesh with faces");
  const Eigen::AlignedBox3d box = bounds(vehicle);
  const double floor = box.max().z() - depth;
  const int nx = static_cast<int>(box.sizes().x() / kCell) + 1,
            ny = static_cast<int>(box.sizes().y() / kCell) + 1;
  std::vector<double> height(static_cast<std::size_t>(nx) * ny, kNone);
  const auto at = [&](int i, int j) -> double& { return height[i + static_cast<std::size_t>(nx) * j]; };
  // Cell (i, j) has its centre at min + (i + ½, j + ½) cells.
  const auto place = [&](const Vec3d& v) {
    return Vec3d((v.x() - box.min().x()) / kCell - 0.5, (v.y() - box.min().y()) / kCell - 0.5, v.z());
  };
  for (const Face& f : vehicle.faces) {
    const Vec3d a = place(vehicle.vertices[f[0]]), b = place(vehicle.vertices[f[1]]),
                c = place(vehicle.vertices[f[2]]);
    if (std::max({a.z(), b.z(), c.z()}) < floor) continue;
    const double area = (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
    if (std::abs(area) < 1e-12) continue;
    const int i0 = std::max(0, static_cast<int>(std::ceil(std::min({a.x(), b.x(), c.x()})))),
              i1 = std::min(nx - 1, static_cast<int>(std::floor(std::max({a.x(), b.x(), c.x()})))),
              j0 = std::max(0, static_cast<int>(std::ceil(std::min({a.y(), b.y(), c.y()})))),
              j1 = std::min(ny - 1, static_cast<int>(std::floor(std::max({a.y(), b.y(), c.y()}))));
    for (int j = j0; j <= j1; ++j)
      for (int i = i0; i <= i1; ++i) {
        const double wb = ((i - a.x()) * (c.y() - a.y()) - (j - a.y()) * (c.x() - a.x())) / area,
                     wc = ((b.x() - a.x()) * (j - a.y()) - (b.y() - a.y()) * (i - a.x())) / area;
        if (wb < -1e-9 || wc < -1e-9 || wb + wc > 1 + 1e-9) continue;
        at(i, j) = std::max(at(i, j), a.z() + wb * (b.z() - a.z()) + wc * (c.z() - a.z()));
      }
  }
  Vec2d sum = Vec2d::Zero();
  double cells = 0, top = kNone;
  for (int j = 0; j < ny; ++j)
    for (int i = 0; i < nx; ++i) {
      top = std::max(top, at(i, j));
      if (at(i, j) < floor) continue;
      sum += Vec2d(i, j);
      ++cells;
    }
  if (cells == 0) return {box.center().x(), box.center().y(), box.max().z()};  // thinner than a cell
  sum /= cells;
  const int i = static_cast<int>(std::lround(sum.x())), j = static_cast<int>(std::lround(sum.y()));
  const double z = at(i, j) >= floor ? at(i, j) : top;  // a hollow at the centroid: rest on the highest part
  return {box.min().x() + (sum.x() + 0.5) * kCell, box.min().y() + (sum.y() + 0.5) * kCell, z};
}

}  // namespace mirage
