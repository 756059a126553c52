#include "scene/shape/shape_model.h"

#include <cmath>

#include "geometry/marching_cubes.h"

namespace mirage {

Eigen::VectorXd ShapeParameters::packed() const {
  Eigen::VectorXd q(7 + code.size());
  q << offset, yaw, log_size, code;
  return q;
}

ShapeParameters ShapeParameters::unpacked(const Eigen::VectorXd& q) {
  return {q.head<3>(), q[3], q.segment<3>(4), q.tail(q.size() - 7)};
}

double ShapeModel::distance(const double* q, const Vec3d& p, double* derivatives) const {
  const double c = std::cos(q[3]), s = std::sin(q[3]);
  const Vec3d moved = p - Vec3d(q[0], q[1], q[2]);
  const Vec3d r(c * moved.x() + s * moved.y(), c * moved.y() - s * moved.x(), moved.z());
  const Vec3d shrink(std::exp(-q[4]), std::exp(-q[5]), std::exp(-q[6]));
  const Vec3d x = shrink.cwiseProduct(r);
  const double* code = q + 7;
  const GridCell cell = cell_at(layout, {x.x(), std::abs(x.y()), x.z()});
  const std::size_t stride = 1 + static_cast<std::size_t>(dimension);
  double d = 0;
  Vec3d g = Vec3d::Zero();  // ∂d/∂x
  if (derivatives) std::fill(derivatives + 7, derivatives + 7 + dimension, 0.0);
  for (int n = 0; n < 8; ++n) {
    const float* node = values.data() + cell.nodes[n] * stride;
    double value = node[0];
    for (int k = 0; k < dimension; ++k) value += code[k] * node[1 + k];
    d += cell.weights[n] * value;
    if (!derivatives) continue;
    g += value * cell.gradients[n];
    for (int k = 0; k < dimension; ++k) derivatives[7 + k] += cell.weights[n] * node[1 + k];
  }
  if (derivatives) {
    if (x.y() < 0) g.y() = -g.y();
    const Vec3d h = g.cwiseProduct(shrink);  // ∂d/∂r
    const Vec3d d_offset(s * h.y() - c * h.x(), -s * h.x() - c * h.y(), -h.z());
    for (int a = 0; a < 3; ++a) derivatives[a] = d_offset[a];
    derivatives[3] = h.x() * r.y() - h.y() * r.x();
    for (int a = 0; a < 3; ++a) derivatives[4 + a] = -g[a] * x[a];
  }
  return d;
}

Mesh ShapeModel::mesh(const ShapeParameters& q) const {
  const auto [nx, ny, nz] = layout.count;
  const std::size_t stride = 1 + static_cast<std::size_t>(dimension);
  DistanceGrid grid;
  grid.layout = layout;
  grid.layout.origin.y() = -layout.spacing.y() * (ny - 1);
  grid.layout.count[1] = 2 * ny - 1;
  grid.values.resize(grid.layout.size());
  for (int k = 0; k < nz; ++k)
    for (int j = 0; j < ny; ++j)
      for (int i = 0; i < nx; ++i) {
        const float* node = values.data() + layout.index(i, j, k) * stride;
        double d = node[0];
        for (int c = 0; c < dimension; ++c) d += q.code[c] * node[1 + c];
        grid.values[grid.layout.index(i, ny - 1 + j, k)] = static_cast<float>(d);
        grid.values[grid.layout.index(i, ny - 1 - j, k)] = static_cast<float>(d);
      }
  Mesh mesh = marching_cubes(grid);
  const Vec3d stretch = q.log_size.array().exp();
  const Transform place = Eigen::Translation3d(q.offset) * Eigen::AngleAxisd(q.yaw, Vec3d::UnitZ());
  for (Vec3d& v : mesh.vertices) v = place * Vec3d(stretch.cwiseProduct(v));
  return mesh;
}

ShapeParameters project(const ShapeModel& model, const Mesh& mesh) {
  const std::vector<float> d = normalised_distances(mesh, model);
  const std::size_t stride = 1 + static_cast<std::size_t>(model.dimension);
  ShapeParameters q;
  q.log_size = bounds(mesh).sizes().cwiseQuotient(model.reference).array().log();
  q.code = Eigen::VectorXd::Zero(model.dimension);
  Eigen::VectorXd norms = Eigen::VectorXd::Zero(model.dimension);
  for (std::size_t n = 0; n < d.size(); ++n) {
    const float* node = model.values.data() + n * stride;
    for (int k = 0; k < model.dimension; ++k) {
      q.code[k] += (d[n] - node[0]) * node[1 + k];
      norms[k] += node[1 + k] * node[1 + k];
    }
  }
  for (int k = 0; k < model.dimension; ++k) q.code[k] = norms[k] > 0 ? q.code[k] / norms[k] : 0;
  return q;
}

}  // namespace mirage
