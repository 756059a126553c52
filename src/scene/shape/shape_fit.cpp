// Ceres' headers are heavy: no other file includes them.
#include "scene/shape/shape_fit.h"

#include <ceres/ceres.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace mirage {
namespace {

// Rounds: the loss' scale (m), how deep inside a return may lie and still count (m: deeper ones are the
// cabin's), and the most iterations. Wide first, so that returns find the surface from a box that is off by
// its errors.
struct Round {
  double scale, deepest;
  int iterations;
};
constexpr Round kFitRounds[] = {{0.15, 0.28, 8}, {0.06, 0.15, 8}, {0.04, 0.10, 15}};
constexpr double kRayStep = 0.10;  // m between the places at which a ray is tried

/// w · d, or w · min(0, d) for a place that is known to be empty.
class DistanceCost : public ceres::CostFunction {
 public:
  DistanceCost(const ShapeModel& model, const Vec3d& p, double weight, bool empty)
      : model_(model), p_(p), weight_(weight), empty_(empty) {
    set_num_residuals(1);
    mutable_parameter_block_sizes()->push_back(7 + model.dimension);
  }
  bool Evaluate(double const* const* q, double* residual, double** jacobians) const override {
    double* slope = jacobians ? jacobians[0] : nullptr;
    const double d = model_.distance(q[0], p_, slope);
    const double weight = empty_ && d > 0 ? 0 : weight_;
    residual[0] = weight * d;
    if (slope)
      for (int i = 0; i < 7 + model_.dimension; ++i) slope[i] *= weight;
    return true;
  }

 private:
  const ShapeModel& model_;
  Vec3d p_;
  double weight_;
  bool empty_;
};

/// A q + c.
class AffineCost : public ceres::CostFunction {
 public:
  AffineCost(Eigen::MatrixXd a, Eigen::VectorXd c) : a_(std::move(a)), c_(std::move(c)) {
    set_num_residuals(static_cast<int>(a_.rows()));
    mutable_parameter_block_sizes()->push_back(static_cast<int>(a_.cols()));
  }
  bool Evaluate(double const* const* q, double* residual, double** jacobians) const override {
    using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    Eigen::Map<Eigen::VectorXd>(residual, a_.rows()) =
        a_ * Eigen::Map<const Eigen::VectorXd>(q[0], a_.cols()) + c_;
    if (jacobians && jacobians[0]) Eigen::Map<Rows>(jacobians[0], a_.rows(), a_.cols()) = a_;
    return true;
  }

 private:
  Eigen::MatrixXd a_;
  Eigen::VectorXd c_;
};

/// The prior of the code given the size: mean code(s) and covariance, from the joint Gaussian.
struct Likely {
  explicit Likely(const ShapeModel& model) : model_(model) {
    const int k = model.dimension;
    const auto& joint = model.prior_covariance;
    slope = joint.topLeftCorner<3, 3>().ldlt().solve(joint.topRightCorner(3, k)).transpose();
    covariance = joint.bottomRightCorner(k, k) - slope * joint.topRightCorner(3, k);
  }
  Eigen::VectorXd code(const Vec3d& log_size) const {
    return model_.prior_mean.tail(model_.dimension) + slope * (log_size - model_.prior_mean.head<3>());
  }
  Eigen::MatrixXd slope, covariance;

 private:
  const ShapeModel& model_;
};

/// Prior of the code, label and ground: rows of ‖L⁻¹ (z − code(s))‖² with the covariance L Lᵀ, then the rest.
AffineCost* affine_terms(const ShapeModel& model, const Vec3d& label_log_size,
                         const VehicleEvidence& evidence, const ShapeFitSettings& settings) {
  const int m = model.dimension;
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(m + 8, 7 + m);
  Eigen::VectorXd c = Eigen::VectorXd::Zero(m + 8);
  const Likely likely(model);
  const Eigen::MatrixXd l = likely.covariance.llt().matrixL();
  const Eigen::MatrixXd whitening =
      std::sqrt(settings.prior) * l.triangularView<Eigen::Lower>().solve(Eigen::MatrixXd::Identity(m, m));
  a.block(0, 4, m, 3) = -whitening * likely.slope;
  a.block(0, 7, m, m) = whitening;
  c.head(m) = -whitening * likely.code(Vec3d::Zero());
  const double sigma[7] = {settings.label_position, settings.label_position, settings.label_height,
                           settings.label_yaw,      settings.label_size,     settings.label_size,
                           settings.label_size};
  for (int i = 0; i < 7; ++i) {
    a(m + i, i) = 1 / sigma[i];
    if (i >= 4) c[m + i] = -label_log_size[i - 4] / sigma[i];
  }
  if (const auto& ground = evidence.ground) {
    a(m + 7, 0) = -ground->slope.x() / settings.ground_sigma;
    a(m + 7, 1) = -ground->slope.y() / settings.ground_sigma;
    a(m + 7, 2) = 1 / settings.ground_sigma;
    c[m + 7] = -ground->height / settings.ground_sigma;
  }
  return new AffineCost(std::move(a), std::move(c));
}

/// Where a segment comes deepest into the shape; false if it stays outside or went through glass.
bool deepest_place(const ShapeModel& model, const Eigen::VectorXd& q, const Segment& segment, double bound,
                   double near, Vec3d& place) {
  const Vec3d way = segment.to - segment.from;
  const int steps = std::max(1, static_cast<int>(std::ceil(way.norm() / kRayStep)));
  double least = near;
  bool found = false;
  for (int i = 0; i <= steps; ++i) {
    const Vec3d p = segment.from + static_cast<double>(i) / steps * way;
    const double d = model.distance(q.data(), p);
    if (d < -bound) return false;
    if (d >= least) continue;
    least = d;
    place = p;
    found = true;
  }
  return found;
}

int solve_round(const ShapeModel& model, const VehicleEvidence& evidence, const Vec3d& label_log_size,
                const ShapeFitSettings& settings, const Round& round, Eigen::VectorXd& q) {
  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::CauchyLoss on_surface(round.scale / settings.point_sigma),
      in_empty(round.scale / settings.empty_sigma);
  ceres::Problem problem(options);
  for (const Vec3d& p : evidence.surface)
    if (model.distance(q.data(), p) > -round.deepest)
      problem.AddResidualBlock(new DistanceCost(model, p, 1 / settings.point_sigma, false), &on_surface,
                               q.data());
  // Rays that pass close by may come to touch the shape while it moves.
  for (const Segment& segment : evidence.empty) {
    Vec3d p;
    if (deepest_place(model, q, segment, settings.deepest, round.scale, p))
      problem.AddResidualBlock(new DistanceCost(model, p, 1 / settings.empty_sigma, true), &in_empty,
                               q.data());
  }
  problem.AddResidualBlock(affine_terms(model, label_log_size, evidence, settings), nullptr, q.data());
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  solver.max_num_iterations = round.iterations;
  solver.function_tolerance = 1e-4;
  solver.num_threads = 1;
  solver.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  return static_cast<int>(summary.iterations.size());
}

}  // namespace

ShapeFit fit_shape(const ShapeModel& model, const VehicleEvidence& evidence, const Box3& label,
                   const ShapeFitSettings& settings) {
  ShapeFit fit;
  fit.points = evidence.points;
  if (evidence.points < settings.min_points) {
    fit.reason = fmt::format("{} returns on it, fewer than {}", evidence.points, settings.min_points);
    return fit;
  }
  const Vec3d label_size(label.bev.length, label.bev.width, label.height);
  const Vec3d label_log_size = label_size.cwiseQuotient(model.reference).array().log();
  Eigen::VectorXd q = Eigen::VectorXd::Zero(7 + model.dimension);
  // Start from the label and the likeliest shape of its size.
  q.segment<3>(4) = label_log_size;
  q.tail(model.dimension) = Likely(model).code(label_log_size);
  for (const Round& round : kFitRounds)
    fit.iterations += solve_round(model, evidence, label_log_size, settings, round, q);
  if (!q.allFinite()) {
    fit.reason = "the fit did not converge";
    return fit;
  }
  fit.shape = ShapeParameters::unpacked(q);
  fit.size = model.size(fit.shape);
  for (const Vec3d& p : evidence.surface) fit.returns_velo.push_back(velo_from_box(label) * p);
  ShapeParameters centred = fit.shape;
  centred.offset.setZero();
  centred.yaw = 0;
  fit.mesh = model.mesh(centred);
  if (fit.mesh.faces.empty()) {
    fit.reason = "the fitted shape is empty";
    return fit;
  }
  fit.velo_from_vehicle = velo_from_box(label) * Eigen::Translation3d(fit.shape.offset) *
                          Eigen::AngleAxisd(fit.shape.yaw, Vec3d::UnitZ());
  fit.velo_from_roof =
      fit.velo_from_vehicle * Eigen::Translation3d(roof_point(fit.mesh, settings.roof_depth));
  for (Vec3d& v : fit.mesh.vertices) v = fit.velo_from_vehicle * v;
  fit.fitted = true;
  return fit;
}

}  // namespace mirage
