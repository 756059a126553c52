#include <optional>

#include "arrays.h"
#include "base/sizes.h"
#include "bind.h"
#include "handles.h"
#include "sensors/ray_caster.h"
#include "simulation/check_inputs.h"
#include "simulation/sensor_pass.h"
#include "validation/thread_clock.h"

namespace mirage::python {
namespace {

using Result = std::shared_ptr<ResultHandle>;

/// Coverage below which the double path drops a face: so small that the jump there does not show in central
/// differences.
constexpr double kCutOffInDouble = 1e-13;

SimulationSettings settings_of(const cli::InsertionOptions& options, const LidarModel& unit,
                               const std::string& recorded, bool in_double) {
  SimulationSettings settings = options.for_unit(unit, recorded, 0);
  if (in_double) {
    settings.reference = true;
    settings.raster.dist_eps = kCutOffInDouble;
  }
  return settings;
}

Result insert(const std::shared_ptr<FrameHandle>& frame, int host, const TexturedMesh& mesh,
              const cli::InsertionOptions& options, bool in_double) {
  const py::gil_scoped_release free;
  check_object(mesh, "mesh");
  check_albedo(mesh.atlas.texels);  // the arrays may have been written to
  auto result = std::make_shared<ResultHandle>();
  result->frame = frame;
  result->prepared = frame->prepared(options);
  result->resolution = mesh.atlas.resolution;
  result->in_double = in_double;
  const Placement placement =
      placement_of(options.placement, frame->carrier(options, host), result->prepared->frame.labels);
  result->simulated =
      simulate(*result->prepared, placement, mesh,
               settings_of(options, result->prepared->lidar, frame->recorded_effects(), in_double));
  return result;
}

py::array image(const Result& result) {
  const ImageF& picture = result->simulated.image;
  const Shape shape = {picture.height, picture.width, 3};
  if (!result->in_double) return view(picture.data.data(), shape, result, true);
  std::vector<double> values(picture.data.begin(), picture.data.end());
  const auto& [rect, rgba] = std::tie(result->simulated.rect, result->simulated.rgba);
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u)
      for (int c = 0; c < 3; ++c)
        values[3 * (as_size(v) * as_size(picture.width) + as_size(u)) + as_size(c)] =
            std::clamp(rgba.at(u - rect.u0, v - rect.v0, c), 0.0, 1.0);
  return own(std::move(values), shape);
}

py::array points(const Result& result) {
  const Sweep& sweep = result->simulated.sweep;
  const Shape shape = {ssize(sweep.size()), 4};
  const auto* from = reinterpret_cast<const float*>(sweep.data());
  if (!result->in_double) return view(from, shape, result, true);
  std::vector<double> values(from, from + 4 * sweep.size());
  const auto exact = object_returns(result->simulated);
  auto to = values.end() - static_cast<std::ptrdiff_t>(4 * exact.size());
  for (const auto& point : exact) to = std::copy(point.begin(), point.end(), to);
  return own(std::move(values), shape);
}

/// A full-size picture of one number a pixel; value(u, v, number) sets those of the window.
template <class Value>
py::array_t<float> picture_of(const Simulated& simulated, std::vector<float> values, const Value& value) {
  const auto& rect = simulated.rect;
  const int width = simulated.image.width;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u) value(u, v, values[as_size(v) * as_size(width) + as_size(u)]);
  return own(std::move(values), {simulated.image.height, width});
}

py::array_t<float> mask(const ResultHandle& result) {
  const Simulated& s = result.simulated;
  return picture_of(s, std::vector<float>(s.image.data.size() / 3), [&](int u, int v, float& value) {
    value = static_cast<float>(s.rgba.at(u - s.rect.u0, v - s.rect.v0, 3));
  });
}

/// The photograph's depth, with the object's surface at the centres of the pixels that show it.
py::array_t<float> depth(const ResultHandle& result) {
  const Simulated& s = result.simulated;
  const Calibration& calibration = result.prepared->frame.calibration;
  const Transform velo_from_camera = calibration.camera_from_velo.inverse();
  const Vec3d eye = velo_from_camera.translation();
  const RayCaster caster(std::span(&placed_adversary(s).mesh, 1), eye);
  return picture_of(s, result.prepared->depth.data, [&](int u, int v, float& value) {
    if (!(s.rgba.at(u - s.rect.u0, v - s.rect.v0, 3) > 0.5)) return;
    const Vec3d at = velo_from_camera.linear() * calibration.camera.unproject(u, v, 1);
    const Hit hit = caster.intersect({Vec3f::Zero(), at.cast<float>()});  // t counts in planar depth
    if (hit.hit()) value = hit.t;
  });
}

/// An upstream gradient of which only `part` is read: in place, or, if its type or layout differs, in an
/// array of its shape whose other numbers are never written.
template <class S>
class UpstreamArray {
 public:
  UpstreamArray(const py::object& values, const std::string& name, const Shape& shape, const PixelRect& part)
      : array_(any_array(values, name)) {
    check_shape(array_, name, shape);
    if (py::array_t<S, py::array::c_style>::check_(array_)) return;
    const auto rows = as_size(shape[0]), columns = as_size(shape[1]);
    const int channels = shape.size() > 2 ? static_cast<int>(shape[2]) : 1;
    filled_.reset(new S[rows * columns * as_size(channels)]);
    read_in_place(array_, name, shape, [&](const auto& from) {
      take(from, part, channels, [&](int u, int v) {
        return filled_.get() + (as_size(v) * columns + as_size(u)) * as_size(channels);
      });
    });
  }
  const S* data() const { return filled_ ? filled_.get() : static_cast<const S*>(array_.data()); }

 private:
  py::array array_;
  std::unique_ptr<S[]> filled_;
};

template <class S>
py::tuple vjp_in(const Result& result, const py::object& d_image, const py::object& d_points) {
  const Simulated& s = result->simulated;
  std::optional<UpstreamArray<S>> of_image, of_points;
  Upstream upstream;
  if (!d_image.is_none()) {
    of_image.emplace(d_image, "d_image", Shape{s.image.height, s.image.width, 3}, s.rect);
    upstream.image = of_image->data();
    upstream.width = s.image.width;
    upstream.height = s.image.height;
  }
  if (!d_points.is_none()) {
    const auto points = static_cast<int>(s.sweep.size());
    of_points.emplace(d_points, "d_points", Shape{points, 4},
                      PixelRect{0, points - s.adversary_points, 4, points});
    upstream.points = {of_points->data(), s.sweep.size()};
  }
  const auto gradient = std::make_shared<AdversaryGradient>();
  {
    const py::gil_scoped_release free;
    *gradient = simulate_vjp(s, upstream);
  }
  const int c = result->resolution;
  const py::ssize_t faces = ssize(gradient->texels.size()) / (c * c);
  return py::make_tuple(
      view(gradient->vertices.front().data(), {ssize(gradient->vertices.size()), 3}, gradient, true),
      view(gradient->texels.front().data(), {faces, c, c, 3}, gradient, true));
}

py::tuple insertion_vjp(const Result& result, const py::object& d_image, const py::object& d_points) {
  return result->in_double ? vjp_in<double>(result, d_image, d_points)
                           : vjp_in<float>(result, d_image, d_points);
}

/// CPU time (ms) of each of `count` insertions with VJP through C++ alone: the baseline of the module's
/// overhead.
std::vector<double> time_insertions(const std::shared_ptr<FrameHandle>& frame, int host,
                                    const TexturedMesh& mesh, const cli::InsertionOptions& options,
                                    int count) {
  const py::gil_scoped_release free;
  const auto prepared = frame->prepared(options);
  const Placement placement =
      placement_of(options.placement, frame->carrier(options, host), prepared->frame.labels);
  const ImageF& picture = prepared->frame.image;
  const ImageF d_image(picture.width, picture.height, 3, 1.f);
  std::vector<std::array<float, 4>> d_points;
  std::vector<double> milliseconds;
  for (int i = 0; i < count; ++i) {
    std::optional<Simulated> simulated;
    const double forward =
        cpu_ms([&] { simulated = simulate(*prepared, placement, mesh, options.simulation); });
    d_points.resize(simulated->sweep.size(), {1, 1, 1, 1});
    AdversaryGradient gradient;
    milliseconds.push_back(forward + cpu_ms([&] { gradient = simulate_vjp(*simulated, d_image, d_points); }));
  }
  return milliseconds;
}

}  // namespace

void bind_insertion(py::module_& module) {
  py::class_<ResultHandle, Result>(module, "Insertion",
                                   "A frame with a mesh on a vehicle's roof, as both sensors see it.")
      .def_property_readonly("image", &image,
                             "H×W×3 float32 (float64 if drawn in double): the picture with the object, "
                             "scene-linear RGB in [0, 1].")
      .def_property_readonly("points", &points,
                             "M×4 float32 (float64 if drawn in double): the sweep with the object, x, y, z "
                             "(m, `velo`), reflectance;\n"
                             "the returns on the object come last.")
      .def_property_readonly("mask", &mask, "H×W float32: the object's silhouette, 0 … 1.")
      .def_property_readonly(
          "depth", &depth,
          "H×W float32, planar, m: the object's surface where the mask is over one half, else\n"
          "the photograph's completed depth.")
      .def("vjp", &insertion_vjp, py::arg("d_image") = py::none(), py::arg("d_points") = py::none(),
           "Vector-Jacobian product: d loss / d image (H×W×3) and d loss / d points (M×4), either of them "
           "None,\n"
           "to (d loss / d vertices (V×3, per m), d loss / d texels (F×C×C×3)), float64.")
      .def_property_readonly(
          "adversary_pixels", [](const ResultHandle& r) { return r.simulated.adversary_pixels; },
          "pixels that show the object (mask over one half)")
      .def_property_readonly(
          "adversary_points", [](const ResultHandle& r) { return r.simulated.adversary_points; },
          "returns on the object")
      .def_property_readonly(
          "removed_points", [](const ResultHandle& r) { return r.simulated.removed_points; },
          "measured returns that the object hides")
      .def_property_readonly(
          "occluded_points", [](const ResultHandle& r) { return r.simulated.occluded_points; },
          "would-be returns on the object that the scene hides")
      .def_property_readonly(
          "share_in_view", [](const ResultHandle& r) { return r.simulated.visible_share; },
          "share of the object's silhouette that the picture shows")
      .def("__repr__", [](const ResultHandle& r) {
        return fmt::format("<mirage.Insertion: {} pixels, {} returns on the object>",
                           r.simulated.adversary_pixels, r.simulated.adversary_points);
      });
  module.def("insert", &insert, py::arg("frame"), py::arg("host"), py::arg("mesh"), py::arg("settings"),
             py::arg("in_double"));
  module.def("time_insertions", &time_insertions, py::arg("frame"), py::arg("host"), py::arg("mesh"),
             py::arg("settings"), py::arg("count"));
}

}  // namespace mirage::python
