#include "geometry/texel_grid.h"

namespace mirage {

std::vector<AtlasTriangle> atlas_triangles(int resolution) {
  const int n = resolution;
  const auto at = [&](int x, int y) { return Vec2d(static_cast<double>(x) / n, static_cast<double>(y) / n); };
  std::vector<AtlasTriangle> triangles;
  triangles.reserve(static_cast<std::size_t>(n) * n);
  for (int y = 0; y < n; ++y)
    for (int x = 0; x + y < n; ++x) {
      triangles.push_back({{at(x, y), at(x + 1, y), at(x, y + 1)}, y * n + x});
      if (x + y < n - 1)
        triangles.push_back({{at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)}, (n - 1 - y) * n + (n - 1 - x)});
    }
  return triangles;
}

}  // namespace mirage
