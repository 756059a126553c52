#include "geometry/laplacian.h"

#include <algorithm>

namespace mirage {

Laplacian::Laplacian(const Mesh& mesh) : neighbours_(mesh.vertices.size()) {
  for (const Face& f : mesh.faces)
    for (int k = 0; k < 3; ++k) {
      neighbours_[f[k]].push_back(f[(k + 1) % 3]);
      neighbours_[f[(k + 1) % 3]].push_back(f[k]);
    }
  for (auto& list : neighbours_) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
  }
}

double Laplacian::energy(const std::vector<Vec3d>& vertices, double weight,
                         std::vector<Vec3d>& gradient) const {
  double energy = 0;
  for (std::size_t i = 0; i < neighbours_.size(); ++i) {
    const auto& around = neighbours_[i];
    if (around.empty()) continue;
    Vec3d mean = Vec3d::Zero();
    for (int j : around) mean += vertices[j];
    mean /= static_cast<double>(around.size());
    const Vec3d delta = vertices[i] - mean;
    energy += delta.squaredNorm();
    gradient[i] += 2 * weight * delta;
    for (int j : around) gradient[j] -= 2 * weight / static_cast<double>(around.size()) * delta;
  }
  return energy;
}

}  // namespace mirage
