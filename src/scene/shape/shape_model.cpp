#include "scene/shape/shape_model.h"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/sizes.h"
#include "sensors/ray_caster.h"

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
  const std::size_t stride = 1 + as_size(dimension);
  double d = 0;
  Vec3d g = Vec3d::Zero();  // ∂d/∂x
  if (derivatives) std::fill(derivatives + 7, derivatives + 7 + dimension, 0.0);
  for (std::size_t n = 0; n < 8; ++n) {
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
  const std::size_t stride = 1 + as_size(dimension);
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

constexpr std::string_view kMagic = "MIRAGE-SHAPE 1\n";
constexpr double kFull = 32767;
constexpr double kMaxNodes = 1e7;
constexpr double kMaxNumber = 1000;  ///< m or shares: limit of the header's numbers

constexpr const char* kMakeAgain = "make the file again with: mirage fit --build-model FILE";

static_assert(std::endian::native == std::endian::little);

nlohmann::json numbers(const auto& v) {
  nlohmann::json out = nlohmann::json::array();
  for (Eigen::Index i = 0; i < v.size(); ++i) out.push_back(v.data()[i]);
  return out;
}

/// The distances that the model learns from: the mesh stretched to the reference box, both sides' mean.
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

}  // namespace

ShapeParameters project(const ShapeModel& model, const Mesh& mesh) {
  const std::vector<float> d = normalised_distances(mesh, model);
  const std::size_t stride = 1 + as_size(model.dimension);
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

ShapeModel build_shape_model(std::span<const ShapeSample> samples, const ShapeModelSettings& settings,
                             const std::function<void()>& sampled) {
  const std::size_t n = samples.size();
  const int dimension = settings.dimension;
  if (dimension < 1 || n < as_size(dimension) + kFew)
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
  parallel_for(n, [&](std::size_t i) {
    if (interrupted()) return;
    const auto column = static_cast<Eigen::Index>(i);
    const std::vector<float> d = normalised_distances(samples[i].mesh, model);
    data.col(column) = Eigen::Map<const Eigen::VectorXf>(d.data(), nodes);
    q.col(column).head<3>() = bounds(samples[i].mesh).sizes().cwiseQuotient(model.reference).array().log();
    if (sampled) sampled();
  });
  throw_if_interrupted("no model was written");
  for (const ShapeSample& s : samples) ++model.sources[s.source];
  const Eigen::VectorXf mean = data.rowwise().mean();
  data.colwise() -= mean;

  // Few vehicles, many nodes: the components come from the vehicles' inner products.
  const Eigen::MatrixXd gram = (data.transpose() * data).cast<double>() / static_cast<double>(n - 1);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(gram);
  const double total = std::max(eigen.eigenvalues().sum(), 1e-30);
  const std::size_t stride = 1 + as_size(dimension);
  model.values.assign(as_size(nodes) * stride, 0);
  for (Eigen::Index i = 0; i < nodes; ++i) model.values[as_size(i) * stride] = mean[i];
  double sum = 0;
  for (int k = 0; k < dimension; ++k) {
    const auto column = static_cast<Eigen::Index>(n) - 1 - k;
    const double variance = std::max(eigen.eigenvalues()[column], 0.0);
    Eigen::VectorXd vector = eigen.eigenvectors().col(column);
    Eigen::Index largest = 0;
    vector.cwiseAbs().maxCoeff(&largest);
    if (vector[largest] < 0) vector = -vector;  // a sign independent of the solver
    // z = vector √(n − 1) has variance 1; the component is data · z / (n − 1).
    const Eigen::VectorXd z = vector * std::sqrt(static_cast<double>(n - 1));
    const Eigen::VectorXf component = data * (z / static_cast<double>(n - 1)).cast<float>();
    q.row(3 + k) = z.transpose();
    for (Eigen::Index i = 0; i < nodes; ++i)
      model.values[as_size(i) * stride + 1 + as_size(k)] = component[i];
    sum += variance;
    model.explained.push_back(sum / total);
  }
  model.prior_mean = q.rowwise().mean();
  const Eigen::MatrixXd centred = q.colwise() - model.prior_mean;
  model.prior_covariance = centred * centred.transpose() / static_cast<double>(n - 1);
  model.prior_covariance.diagonal().array() += kRidge;
  return model;
}

void write_shape_model(const std::filesystem::path& file, const ShapeModel& model) {
  const std::size_t stride = 1 + as_size(model.dimension), nodes = model.layout.size();
  std::vector<double> scales(stride, 1e-12);
  for (std::size_t i = 0; i < model.values.size(); ++i)
    scales[i % stride] = std::max<double>(scales[i % stride], std::abs(model.values[i]));
  const nlohmann::json header = {{"reference", numbers(model.reference)},
                                 {"origin", numbers(model.layout.origin)},
                                 {"spacing", numbers(model.layout.spacing)},
                                 {"count", model.layout.count},
                                 {"cut", model.cut},
                                 {"dimension", model.dimension},
                                 {"vehicles", model.vehicles},
                                 {"explained", model.explained},
                                 {"scales", scales},
                                 {"prior_mean", numbers(model.prior_mean)},
                                 {"prior_covariance", numbers(model.prior_covariance)},
                                 {"sources", model.sources}};
  std::string bytes(kMagic);
  bytes += json_text(header) + "\n";
  std::vector<std::int16_t> packed(nodes * stride);
  for (std::size_t i = 0; i < packed.size(); ++i)
    packed[i] = static_cast<std::int16_t>(std::lround(model.values[i] * kFull / scales[i % stride]));
  bytes.append(reinterpret_cast<const char*>(packed.data()), packed.size() * sizeof(packed[0]));
  write_file(file, bytes);
}

ShapeModel read_shape_model(const std::filesystem::path& file) {
  const std::string name = file.string();
  const auto refuse = [&] {
    throw InputError(name, "first line", "not a shape model of this version",
                     "make one with: mirage fit --build-model FILE");
  };
  constexpr std::size_t kMaxHeaderLength = 1 << 21, kMaxValues = 100'000;  // of dimension 200: 41 000 numbers
  const std::string head = read_head(file, kMaxHeaderLength);
  if (!head.starts_with(kMagic)) refuse();
  const std::size_t end = head.find('\n', kMagic.size());
  if (end == std::string::npos) refuse();
  const std::string_view second = std::string_view(head).substr(0, end).substr(kMagic.size());
  check_json_depth(second, name);
  check_json_values(second, name, kMaxValues);
  const nlohmann::json json = nlohmann::json::parse(second, nullptr, false);
  if (!json.is_object()) throw InputError(name, "second line", "not a JSON object", kMakeAgain);
  const JsonFields header(file, json, kMakeAgain);
  const auto list = [&](const char* key, std::size_t length) {
    return header.numbers(key, length, -kMaxNumber, kMaxNumber);
  };
  const auto positive = [&](const char* key) {
    return Vec3d(header.numbers(key, 3, 1e-3, kMaxNumber).data());
  };
  ShapeModel model;
  model.reference = positive("reference");
  model.layout.origin = Vec3d(list("origin", 3).data());
  model.layout.spacing = positive("spacing");
  const auto count = header.numbers("count", 3, 2, 1000);
  double nodes = 1;
  for (std::size_t a = 0; a < 3; ++a) {
    if (count[a] != std::floor(count[a])) header.fail("count", "not whole numbers");
    model.layout.count[a] = static_cast<int>(count[a]);
    nodes *= count[a];
  }
  if (nodes > kMaxNodes) header.fail("count", "out of range");
  model.cut = header.number("cut", 1e-3, 10);
  model.dimension = static_cast<int>(header.integer("dimension", 1, 200));
  model.vehicles = static_cast<int>(header.integer("vehicles", 1, 10'000'000));
  const auto k = as_size(model.dimension);
  model.explained = list("explained", k);
  const auto scales = list("scales", k + 1);
  const auto mean = list("prior_mean", 3 + k), covariance = list("prior_covariance", (3 + k) * (3 + k));
  const auto size = static_cast<Eigen::Index>(3 + k);
  model.prior_mean = Eigen::Map<const Eigen::VectorXd>(mean.data(), size);
  model.prior_covariance = Eigen::Map<const Eigen::MatrixXd>(covariance.data(), size, size);
  if (model.prior_covariance.llt().info() != Eigen::Success)
    header.fail("prior_covariance", "not positive definite");
  if (json.contains("sources") && json.at("sources").is_object())
    for (const auto& [source, number] : json.at("sources").items())
      if (number.is_number_integer()) model.sources[source] = number.get<int>();
  const std::size_t numbers_needed = model.layout.size() * (k + 1);
  const auto check = [&](std::uintmax_t bytes) {
    const std::uintmax_t available = bytes > end ? bytes - end - 1 : 0,
                         needed = numbers_needed * sizeof(std::int16_t);
    if (available != needed)
      header.fail("numbers",
                  fmt::format("the file holds {} bytes of them, {} are needed", available, needed));
  };
  check(OpenFile(file).size());  // before any of the numbers is in memory
  const std::string all = read_file(file);
  check(all.size());
  model.values.resize(numbers_needed);
  for (std::size_t i = 0; i < numbers_needed; ++i) {
    std::int16_t packed = 0;
    std::memcpy(&packed, all.data() + end + 1 + i * sizeof packed, sizeof packed);
    model.values[i] = static_cast<float>(packed * scales[i % (k + 1)] / kFull);
  }
  return model;
}

}  // namespace mirage
