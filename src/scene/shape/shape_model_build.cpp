#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <mutex>
#include <string>

#include "base/error.h"
#include "base/interrupt.h"
#include "base/parallel.h"
#include "scene/shape/shape_model.h"
#include "sensors/mesh_distance.h"

namespace mirage {
namespace {

constexpr double kMargin = 0.24;  // m of grid around the reference box
constexpr double kBelow = 0.16;   // m of grid under the wheels
constexpr double kRidge = 1e-4;   // added to the prior's variances
constexpr std::size_t kFew = 2;   // vehicles needed beyond the dimension

GridLayout layout_for(const ShapeModelSettings& s) {
  const Vec3d& box = s.reference;
  GridLayout layout;
  layout.spacing = Vec3d::Constant(s.spacing);
  const int half_length = static_cast<int>(std::ceil((0.5 * box.x() + kMargin) / s.spacing));
  const int below = static_cast<int>(std::ceil(kBelow / s.spacing));
  layout.origin = {-half_length * s.spacing, 0, -below * s.spacing};
  layout.count = {2 * half_length + 1, static_cast<int>(std::ceil((0.5 * box.y() + kMargin) / s.spacing)) + 1,
                  below + static_cast<int>(std::ceil((box.z() + kMargin) / s.spacing)) + 1};
  return layout;
}

}  // namespace

std::vector<float> normalised_distances(const Mesh& mesh, const ShapeModel& model) {
  const Eigen::AlignedBox3d box = bounds(mesh);
  const Vec3d middle(box.center().x(), box.center().y(), box.min().z());
  Mesh stretched = mesh;
  for (Vec3d& v : stretched.vertices)
    v = (v - middle).cwiseProduct(model.reference).cwiseQuotient(box.sizes());
  const MeshDistance distance(stretched);
  const auto [nx, ny, nz] = model.layout.count;
  std::vector<float> out(model.layout.size());
  for (int k = 0; k < nz; ++k)
    for (int j = 0; j < ny; ++j)
      for (int i = 0; i < nx; ++i) {
        const Vec3d p = model.layout.node(i, j, k);
        double d = 0;
        for (double side : {1, -1})
          d +=
              0.5 * std::clamp(distance.signed_distance({p.x(), side * p.y(), p.z()}), -model.cut, model.cut);
        out[model.layout.index(i, j, k)] = static_cast<float>(d);
      }
  return out;
}

ShapeModel build_shape_model(std::span<const ShapeSample> samples, const ShapeModelSettings& settings,
                             const std::function<void(std::size_t)>& tell) {
  const std::size_t n = samples.size();
  const int dimension = settings.dimension;
  if (dimension < 1 || n < static_cast<std::size_t>(dimension) + kFew)
    throw InputError("shape model", "vehicles",
                     std::to_string(n) + " are too few for " + std::to_string(dimension) + " dimensions",
                     "give at least two more than dimensions, and one dimension or more");
  ShapeModel model;
  model.reference = settings.reference;
  model.layout = layout_for(settings);
  model.cut = settings.cut;
  model.dimension = dimension;
  model.vehicles = static_cast<int>(n);
  const auto nodes = static_cast<Eigen::Index>(model.layout.size());
  Eigen::MatrixXf data(nodes, static_cast<Eigen::Index>(n));
  Eigen::MatrixXd q(3 + dimension, static_cast<Eigen::Index>(n));  // (s, z) of each
  std::mutex mutex;
  std::size_t done = 0;
  parallel_for(n, [&](std::size_t i) {
    if (interrupted()) return;
    const auto column = static_cast<Eigen::Index>(i);
    const std::vector<float> d = normalised_distances(samples[i].mesh, model);
    data.col(column) = Eigen::Map<const Eigen::VectorXf>(d.data(), nodes);
    q.col(column).head<3>() = bounds(samples[i].mesh).sizes().cwiseQuotient(model.reference).array().log();
    const std::scoped_lock lock(mutex);
    ++done;
    if (tell) tell(done);
  });
  throw_if_interrupted("no model was written");
  for (const ShapeSample& s : samples) ++model.sources[s.source];
  const Eigen::VectorXf mean = data.rowwise().mean();
  data.colwise() -= mean;

  // Few vehicles, many nodes: the components come from the vehicles' inner products.
  const Eigen::MatrixXd gram = (data.transpose() * data).cast<double>() / static_cast<double>(n - 1);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(gram);
  const double total = std::max(eigen.eigenvalues().sum(), 1e-30);
  const std::size_t stride = 1 + static_cast<std::size_t>(dimension);
  model.values.assign(static_cast<std::size_t>(nodes) * stride, 0);
  for (Eigen::Index i = 0; i < nodes; ++i) model.values[static_cast<std::size_t>(i) * stride] = mean[i];
  double sum = 0;
  for (int k = 0; k < dimension; ++k) {
    const auto column = static_cast<Eigen::Index>(n) - 1 - k;
    const double variance = std::max(eigen.eigenvalues()[column], 0.0);
    Eigen::VectorXd vector = eigen.eigenvectors().col(column);
    Eigen::Index largest = 0;
    vector.cwiseAbs().maxCoeff(&largest);
    if (vector[largest] < 0) vector = -vector;  // a sign that doesn't hang on the solver
    // z = vector √(n − 1) has variance 1; the component is data · z / (n − 1).
    const Eigen::VectorXd z = vector * std::sqrt(static_cast<double>(n - 1));
    const Eigen::VectorXf component = data * (z / static_cast<double>(n - 1)).cast<float>();
    q.row(3 + k) = z.transpose();
    for (Eigen::Index i = 0; i < nodes; ++i)
      model.values[static_cast<std::size_t>(i) * stride + 1 + k] = component[i];
    sum += variance;
    model.explained.push_back(sum / total);
  }
  model.prior_mean = q.rowwise().mean();
  const Eigen::MatrixXd centred = q.colwise() - model.prior_mean;
  model.prior_covariance = centred * centred.transpose() / static_cast<double>(n - 1);
  model.prior_covariance.diagonal().array() += kRidge;
  return model;
}

}  // namespace mirage
