#include "scene/shape/shape_fit.h"

#include <ceres/ceres.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <set>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/intervals.h"
#include "base/parallel.h"
#include "base/sizes.h"

namespace mirage {
namespace {

constexpr double kGrow = 0.20;  // m: labels are hand-drawn; returns this far outside the box still count
constexpr double kAboveGround = 0.12;  // m: lower returns are on the road
constexpr double kCubeSize = 0.10;     // m: one return in each cube of this size stays
constexpr std::size_t kMaxRays = 500;  // empty segments kept, evenly over the rays
constexpr double kBefore = 0.12;       // m before a return in which its ray is no evidence
constexpr double kBeside = 0.4;        // m to either side: a higher return marks a ray through glass
constexpr double kGroundRing = 1.5;    // m around the box in which ground is looked for
constexpr int kMinGround = 15;         // returns that a ground plane needs
constexpr double kGroundBand = 0.4;    // m over and under the box's bottom in which ground is looked for
constexpr double kGroundScale = 0.05;  // m, of the robust weights
constexpr double kMaxSlope = 0.12;     // against the box's own level
constexpr int kEvidenceRounds = 8;

/// Plane by iteratively reweighted least squares with Cauchy weights, started from the box's bottom; slopes
/// are regularised (0.05) so that ground on one side only doesn't tilt it.
std::optional<GroundPlane> fit_ground(const std::vector<Vec3d>& points) {
  if (static_cast<int>(points.size()) < kMinGround) return std::nullopt;
  // Start from the lower quartile: objects on the ground are above it.
  std::vector<double> heights;
  for (const Vec3d& p : points) heights.push_back(p.z());
  GroundPlane plane{lower_quantile(std::move(heights), 0.25), Vec2d::Zero()};
  double support = 0;
  for (int round = 0; round < kEvidenceRounds; ++round) {
    Eigen::Matrix3d normal = Eigen::Vector3d(1e-9, 1, 1).asDiagonal();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    normal *= static_cast<double>(points.size()) * 0.05 * 0.05;
    support = 0;
    for (const Vec3d& p : points) {
      const double r = (p.z() - plane.at(p.x(), p.y())) / kGroundScale, w = 1 / (1 + r * r);
      const Vec3d row(1, p.x(), p.y());
      normal += w * row * row.transpose();
      right += w * p.z() * row;
      support += r * r < 4;
    }
    const Eigen::Vector3d solution = normal.ldlt().solve(right);
    plane = {solution[0], solution.tail<2>()};
  }
  if (support < kMinGround || plane.slope.norm() > kMaxSlope || !std::isfinite(plane.height) ||
      std::abs(plane.height) > kGroundBand)
    return std::nullopt;
  return plane;
}

constexpr double kPointSigma = 0.06, kEmptySigma = 0.10;  // m
constexpr double kDeepest = 0.25;                         // m; a ray deeper inside went through glass
constexpr double kGroundSigma = 0.03;                     // m
// Of the label: m along and across, of the bottom; rad; share of length, width, height.
constexpr double kLabelPosition = 0.10, kLabelHeight = 0.10, kLabelYaw = 0.03, kLabelSize = 0.03;
constexpr double kPrior = 2.0;       // λ; above 1 because the returns' errors are correlated
constexpr double kRoofDepth = 0.20;  // m; the rooftop reaches this far below the top

// Ceres' headers are heavy: no other file includes them.

// Rounds: the loss' scale (m), the largest depth inside at which a return counts (m: deeper ones are in the
// cabin), and the limit on iterations. Wide first, so that returns find the surface despite the label's
// errors.
struct Round {
  double scale, deepest;
  int iterations;
};
constexpr Round kFitRounds[] = {{0.15, 0.28, 8}, {0.06, 0.15, 8}, {0.04, 0.10, 15}};
constexpr double kRayStep = 0.10;  // m between the samples along a ray

/// w · d, or w · min(0, d) for a point known to be empty.
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
struct ConditionalPrior {
  explicit ConditionalPrior(const ShapeModel& model) : model_(model) {
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
                         const VehicleEvidence& evidence) {
  const int m = model.dimension;
  Eigen::MatrixXd a = Eigen::MatrixXd::Zero(m + 8, 7 + m);
  Eigen::VectorXd c = Eigen::VectorXd::Zero(m + 8);
  const ConditionalPrior likely(model);
  const Eigen::MatrixXd l = likely.covariance.llt().matrixL();
  const Eigen::MatrixXd whitening =
      std::sqrt(kPrior) * l.triangularView<Eigen::Lower>().solve(Eigen::MatrixXd::Identity(m, m));
  a.block(0, 4, m, 3) = -whitening * likely.slope;
  a.block(0, 7, m, m) = whitening;
  c.head(m) = -whitening * likely.code(Vec3d::Zero());
  constexpr double sigma[7] = {kLabelPosition, kLabelPosition, kLabelHeight, kLabelYaw,
                               kLabelSize,     kLabelSize,     kLabelSize};
  for (int i = 0; i < 7; ++i) {
    a(m + i, i) = 1 / sigma[i];
    if (i >= 4) c[m + i] = -label_log_size[i - 4] / sigma[i];
  }
  if (const auto& ground = evidence.ground) {
    a(m + 7, 0) = -ground->slope.x() / kGroundSigma;
    a(m + 7, 1) = -ground->slope.y() / kGroundSigma;
    a(m + 7, 2) = 1 / kGroundSigma;
    c[m + 7] = -ground->height / kGroundSigma;
  }
  return new AffineCost(std::move(a), std::move(c));
}

/// Finds a segment's deepest point in the shape; false if it stays `near` (m) outside or went through glass.
bool deepest_place(const ShapeModel& model, const Eigen::VectorXd& q, const Segment& segment, double near,
                   Vec3d& place) {
  const Vec3d way = segment.to - segment.from;
  const int steps = std::max(1, static_cast<int>(std::ceil(way.norm() / kRayStep)));
  double least = near;
  bool found = false;
  for (int i = 0; i <= steps; ++i) {
    const Vec3d p = segment.from + static_cast<double>(i) / steps * way;
    const double d = model.distance(q.data(), p);
    if (d < -kDeepest) return false;
    if (d >= least) continue;
    least = d;
    place = p;
    found = true;
  }
  return found;
}

int solve_round(const ShapeModel& model, const VehicleEvidence& evidence, const Vec3d& label_log_size,
                const Round& round, Eigen::VectorXd& q) {
  ceres::Problem::Options options;
  options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::CauchyLoss on_surface(round.scale / kPointSigma), in_empty(round.scale / kEmptySigma);
  ceres::Problem problem(options);
  for (const Vec3d& p : evidence.surface)
    if (model.distance(q.data(), p) > -round.deepest)
      problem.AddResidualBlock(new DistanceCost(model, p, 1 / kPointSigma, false), &on_surface, q.data());
  // Rays that pass close by may touch the shape as it moves.
  for (const Segment& segment : evidence.empty) {
    Vec3d p;
    if (deepest_place(model, q, segment, round.scale, p))
      problem.AddResidualBlock(new DistanceCost(model, p, 1 / kEmptySigma, true), &in_empty, q.data());
  }
  problem.AddResidualBlock(affine_terms(model, label_log_size, evidence), nullptr, q.data());
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

bool same(const Sweep& a, const Sweep& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const LidarPoint& p, const LidarPoint& q) {
    return p.x == q.x && p.y == q.y && p.z == q.z;
  });
}

/// The file of the manifold; empty for "box".
std::filesystem::path model_file(const std::string& rooftop) {
  if (rooftop == "box") return {};
  if (rooftop == "shape") return shipped_file("scenes/shapes/cars.shape");
  if (std::filesystem::path(rooftop).extension() == ".shape") {
    std::error_code unknown;
    if (!std::filesystem::is_regular_file(rooftop, unknown))
      throw InputError(rooftop, "", "no such shape model", "check --rooftop");
    return rooftop;
  }
  throw unknown_word("rooftop", rooftop, {"shape", "box"}, "a shape model (*.shape)");
}

}  // namespace

VehicleEvidence gather_evidence(const SweepIndex& sweep, const Box3& box) {
  const Transform velo_from_frame = velo_from_box(box), frame_from_velo = velo_from_frame.inverse();
  const Vec3d half(0.5 * box.bev.length, 0.5 * box.bev.width, 0.5 * box.height);
  const double reach = half.norm() + kGrow + kGroundRing;
  const auto rays = sweep.rays_through(velo_from_frame * Vec3d(0, 0, half.z()), reach);

  VehicleEvidence evidence;
  std::vector<Vec3d> returns, around;
  std::vector<Vec2d> returns_seen;
  struct Candidate {
    Segment segment;
    Vec2d seen;  // its ray's crossing of the upright plane through the box's centre, across the view
  };
  std::vector<Candidate> candidates;
  const Vec3d grow = Vec3d::Constant(kGrow);
  const Vec3d low = Vec3d(-half.x(), -half.y(), 0) - grow,
              high = Vec3d(half.x(), half.y(), box.height) + grow;
  if (rays.empty()) return evidence;
  Vec3d eye = Vec3d::Zero();
  for (const SweepRay& ray : rays) eye += frame_from_velo * ray.ray.origin / static_cast<double>(rays.size());
  const Vec2d ahead = -eye.head<2>().normalized(), left(-ahead.y(), ahead.x());
  const auto seen = [&](const Vec3d& origin, const Vec3d& direction) {
    const double along = ahead.dot(direction.head<2>());
    const Vec3d p = origin - ahead.dot(origin.head<2>()) / (along > 1e-6 ? along : 1e-6) * direction;
    return Vec2d(left.dot(p.head<2>()), p.z());
  };
  for (const SweepRay& ray : rays) {
    if (ray.point < 0) continue;
    const Vec3d origin = frame_from_velo * ray.ray.origin,
                direction = frame_from_velo.linear() * ray.ray.direction;
    const Vec3d p = origin + ray.range * direction;
    const bool within = std::abs(p.x()) < high.x() && std::abs(p.y()) < high.y();
    if (within && p.z() < high.z()) {
      returns.push_back(p);
      returns_seen.push_back(seen(origin, direction));
    }
    const bool ring = std::abs(p.x()) < high.x() + kGroundRing && std::abs(p.y()) < high.y() + kGroundRing;
    if (ring && std::abs(p.z()) < kGroundBand && !(within && p.z() > kAboveGround)) around.push_back(p);
    auto [from, to] = ray_within(origin, direction, low, high);
    to = std::min(to, ray.range - kBefore);
    if (from < to)
      candidates.push_back({{origin + from * direction, origin + to * direction}, seen(origin, direction)});
  }
  evidence.ground = fit_ground(around);
  const GroundPlane ground = evidence.ground.value_or(GroundPlane{});

  // The highest return on the vehicle in each upright strip of the view.
  constexpr double kStrip = 0.1;  // m
  const auto strip_of = [&](double across) { return static_cast<int>(std::floor(across / kStrip)); };
  std::map<int, double> highest;
  std::set<std::array<int, 3>> taken;
  for (std::size_t i = 0; i < returns.size(); ++i) {
    const Vec3d& p = returns[i];
    if (p.z() - ground.at(p.x(), p.y()) < kAboveGround) continue;
    ++evidence.points;
    double& top = highest.try_emplace(strip_of(returns_seen[i].x()), -1e9).first->second;
    top = std::max(top, returns_seen[i].y());
    std::array<int, 3> cell;
    for (int a = 0; a < 3; ++a) cell[as_size(a)] = static_cast<int>(std::floor(p[a] / kCubeSize));
    if (taken.insert(cell).second) evidence.surface.push_back(p);
  }
  std::erase_if(candidates, [&](const Candidate& c) {
    const auto end = highest.upper_bound(strip_of(c.seen.x() + kBeside));
    for (auto it = highest.lower_bound(strip_of(c.seen.x() - kBeside)); it != end; ++it)
      if (it->second > c.seen.y()) return true;
    return false;
  });
  const auto count = candidates.size(), keep = std::min(count, kMaxRays);
  for (std::size_t i = 0; i < keep; ++i) evidence.empty.push_back(candidates[i * count / keep].segment);
  return evidence;
}

ShapeFit fit_shape(const ShapeModel& model, const VehicleEvidence& evidence, const Box3& label,
                   int min_points) {
  ShapeFit fit;
  fit.points = evidence.points;
  if (evidence.points < min_points) {
    fit.reason = fmt::format("{} returns on it, fewer than {}", evidence.points, min_points);
    return fit;
  }
  const Vec3d label_size(label.bev.length, label.bev.width, label.height);
  const Vec3d label_log_size = label_size.cwiseQuotient(model.reference).array().log();
  Eigen::VectorXd q = Eigen::VectorXd::Zero(7 + model.dimension);
  // Start from the label and the likeliest shape of its size.
  q.segment<3>(4) = label_log_size;
  q.tail(model.dimension) = ConditionalPrior(model).code(label_log_size);
  for (const Round& round : kFitRounds)
    fit.iterations += solve_round(model, evidence, label_log_size, round, q);
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
  fit.velo_from_roof = fit.velo_from_vehicle * Eigen::Translation3d(roof_point(fit.mesh));
  for (Vec3d& v : fit.mesh.vertices) v = fit.velo_from_vehicle * v;
  fit.fitted = true;
  return fit;
}

Vec3d roof_point(const Mesh& vehicle) {
  constexpr double kCell = 0.025, kNone = -std::numeric_limits<double>::infinity();
  if (vehicle.faces.empty())
    throw InputError("vehicle mesh", "faces", "there are none", "give a mesh with faces");
  const Eigen::AlignedBox3d box = bounds(vehicle);
  const double floor = box.max().z() - kRoofDepth;
  const int nx = static_cast<int>(box.sizes().x() / kCell) + 1,
            ny = static_cast<int>(box.sizes().y() / kCell) + 1;
  std::vector<double> height(as_size(nx) * as_size(ny), kNone);
  const auto at = [&](int i, int j) -> double& { return height[as_size(i) + as_size(nx) * as_size(j)]; };
  // Cell (i, j) has its centre at min + (i + ½, j + ½) cells.
  const auto place = [&](const Vec3d& v) {
    return Vec3d((v.x() - box.min().x()) / kCell - 0.5, (v.y() - box.min().y()) / kCell - 0.5, v.z());
  };
  for (const Face& f : vehicle.faces) {
    const Vec3d a = place(vehicle.vertices[as_size(f[0])]), b = place(vehicle.vertices[as_size(f[1])]),
                c = place(vehicle.vertices[as_size(f[2])]);
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

ShapeRoofFinder::ShapeRoofFinder(ShapeModel model, LidarModel lidar, int min_points)
    : model_(std::move(model)), lidar_(std::move(lidar)), min_points_(min_points) {}

ShapeFit ShapeRoofFinder::fit(const SweepIndex& index, const Label& label) const {
  if ((label.type != "Car" && label.type != "Van") || !has_box(label)) {
    ShapeFit none;
    none.reason = "the manifold holds cars and vans, this is a " + label.type;
    return none;
  }
  return fit_shape(model_, gather_evidence(index, label.box), label.box, min_points_);
}

std::shared_ptr<const SweepIndex> ShapeRoofFinder::index_of(const Sweep& sweep) const {
  const std::scoped_lock lock(mutex_);
  auto cached = std::find_if(indexed_.begin(), indexed_.end(),
                             [&](const Indexed& indexed) { return same(indexed.sweep, sweep); });
  if (cached == indexed_.end()) {
    if (indexed_.size() >= as_size(std::max(1, thread_count()))) indexed_.erase(indexed_.begin());
    indexed_.push_back({sweep, std::make_shared<const SweepIndex>(sweep, lidar_)});
    cached = std::prev(indexed_.end());
  }
  std::rotate(cached, cached + 1, indexed_.end());
  return indexed_.back().index;
}

Carrier ShapeRoofFinder::find(const Frame& frame, const Label& label) const {
  ShapeFit shape = fit(*index_of(frame.sweep), label);
  if (shape.fitted)
    return {label, shape.velo_from_roof, false, {}, std::make_shared<const Mesh>(std::move(shape.mesh))};
  Carrier carrier = BoxRoofFinder().find(frame, label);
  carrier.reason = shape.reason;
  return carrier;
}

std::unique_ptr<RoofFinder> make_roof_finder(const std::string& rooftop, const LidarModel& lidar) {
  const std::filesystem::path file = model_file(rooftop);
  if (file.empty()) return std::make_unique<BoxRoofFinder>();
  return std::make_unique<ShapeRoofFinder>(read_shape_model(file), lidar);
}

std::string rooftop_model_hash(const std::string& rooftop) {
  const std::filesystem::path file = model_file(rooftop);
  return file.empty() ? "" : file_hash(file);
}

}  // namespace mirage
