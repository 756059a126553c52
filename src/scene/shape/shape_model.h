// A linear manifold of vehicle shapes: signed distance grids of many vehicles, their mean and principal
// components (Leotta and Mundy, PAMI 2011; Engelmann et al., WACV 2017; src/README.md, Vehicle shape).
//
// Every vehicle is stretched to one reference box before its distances are sampled, and its size (the logs of
// length, width and height over the reference's) is kept beside the code. So the components describe shape
// only, a fit may take the size from a label, and sizes between the samples are exact. Vehicles are mirrored
// over y = 0: only y ≥ 0 is stored.
//
//   d(p; q) = m(x) + Σ_k z_k c_k(x),   x = exp(−s) ∘ (R(yaw)ᵀ (p − t)),   q = (t, yaw, s, z)
//
// with m and c_k trilinear on the grid. d is measured in the reference box (m there): its zero surface is
// exact and its slope off by the stretch, at most about 30 %. z_k have variance 1 over the vehicles learnt.
// Distances are cut at ±`cut` before the analysis: those deep inside or far outside tell nothing of shape.
//
// File (scenes/shapes/*.shape): the line "MIRAGE-SHAPE 1", one line of JSON, and little-endian int16 numbers.
// JSON: {"reference": [length, width, height], "origin", "spacing", "count": the grid's (x, y ≥ 0, z),
// "cut", "dimension": K, "vehicles": how many were learnt from, "explained": share of the variance that the
// first 1 … K components explain, "scales": [K + 1], "prior_mean": [3 + K], "prior_covariance": [(3 + K)²] of
// (s, z), "sources": how many vehicles of each source}. Numbers: for each node, x fastest, its mean and K
// components, each times 32767 / scale.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "geometry/mesh.h"
#include "geometry/solid.h"

namespace mirage {

/// q of the header, in the frame of a box: origin at the centre of its bottom, x along its heading, z up.
struct ShapeParameters {
  Vec3d offset = Vec3d::Zero();                     ///< t, m
  double yaw = 0;                                   ///< rad
  Vec3d log_size = Vec3d::Zero();                   ///< s
  Eigen::VectorXd code = Eigen::VectorXd::Zero(0);  ///< z

  /// (t, yaw, s, z) in one vector.
  Eigen::VectorXd packed() const;
  /// The inverse of packed().
  static ShapeParameters unpacked(const Eigen::VectorXd& q);
};

/// Signed distances of a family of cars: their mean and principal components on one grid.
struct ShapeModel {
  Vec3d reference = Vec3d::Ones();  ///< length, width, height of the reference box (m)
  GridLayout layout;                ///< y from 0; z = 0 is the ground under the wheels
  double cut = 0;                   ///< m
  int dimension = 0;                ///< K
  std::vector<float> values;        ///< nodes × (1 + K): mean and components, m
  std::vector<double> explained;    ///< K rising shares in [0, 1]
  Eigen::VectorXd prior_mean;       ///< 3 + K: (s, z)
  Eigen::MatrixXd prior_covariance;
  int vehicles = 0;
  std::map<std::string, int> sources;

  /// d(p; q) for a packed q of 7 + K numbers and, unless null, its 7 + K derivatives.
  double distance(const double* q, const Vec3d& p, double* derivatives = nullptr) const;
  /// Length, width, height of the shape's box (m).
  Vec3d size(const ShapeParameters& q) const { return reference.array() * q.log_size.array().exp(); }
  /// The shape's surface in the frame of q: marching cubes of both halves, watertight, wound outward.
  Mesh mesh(const ShapeParameters& q) const;
};

/// A vehicle to learn from, in its frame (x forward, y left, z up). `source` is counted in the file.
struct ShapeSample {
  Mesh mesh;
  std::string source;
};

/// How a shape model is built.
struct ShapeModelSettings {
  int dimension = 16;
  double spacing = 0.08;  ///< m, in the reference box
  double cut = 0.3;       ///< m
  Vec3d reference = Vec3d(4.3, 1.75, 1.52);
};

/// Learns the model; calls sampled() after each vehicle, on several threads. InputError if there are fewer
/// vehicles than dimensions + 2. Interrupted after Ctrl-C.
ShapeModel build_shape_model(std::span<const ShapeSample> samples, const ShapeModelSettings& settings = {},
                             const std::function<void()>& sampled = {});
/// Parameters of any vehicle, also one outside the training set, by least squares on the grid.
ShapeParameters project(const ShapeModel& model, const Mesh& mesh);

/// Writes a file for read_shape_model, atomically.
void write_shape_model(const std::filesystem::path& file, const ShapeModel& model);
/// InputError naming file and field if it is not a shape model or is damaged.
ShapeModel read_shape_model(const std::filesystem::path& file);

}  // namespace mirage
