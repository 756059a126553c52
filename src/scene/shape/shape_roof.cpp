#include "scene/shape/shape_roof.h"

#include <algorithm>
#include <filesystem>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/parallel.h"
#include "base/words.h"

namespace mirage {
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
