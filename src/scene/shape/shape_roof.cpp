#include "scene/shape/shape_roof.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/parallel.h"
#include "base/words.h"
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

namespace {

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

ShapeRoofFinder::ShapeRoofFinder(ShapeModel model, LidarModel lidar, const ShapeFitSettings& settings)
    : model_(std::move(model)), lidar_(std::move(lidar)), settings_(settings) {}

ShapeFit ShapeRoofFinder::fit(const SweepIndex& index, const Label& label) const {
  if ((label.type != "Car" && label.type != "Van") || !has_box(label)) {
    ShapeFit none;
    none.reason = "the manifold holds cars and vans, this is a " + label.type;
    return none;
  }
  return fit_shape(model_, gather_evidence(index, label.box, settings_.evidence), label.box, settings_);
}

std::shared_ptr<const SweepIndex> ShapeRoofFinder::index_of(const Sweep& sweep) const {
  const std::scoped_lock lock(mutex_);
  auto known = std::find_if(indexed_.begin(), indexed_.end(),
                            [&](const Indexed& indexed) { return same(indexed.sweep, sweep); });
  if (known == indexed_.end()) {
    if (indexed_.size() >= static_cast<std::size_t>(std::max(1, thread_count())))
      indexed_.erase(indexed_.begin());
    indexed_.push_back({sweep, std::make_shared<const SweepIndex>(sweep, lidar_)});
    known = std::prev(indexed_.end());
  }
  std::rotate(known, known + 1, indexed_.end());
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
