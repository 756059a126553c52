#include <pybind11/stl/filesystem.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "arrays.h"
#include "base/error.h"
#include "base/memory.h"
#include "base/sizes.h"
#include "bind.h"
#include "cli/field_options.h"
#include "detection/car_in_picture.h"
#include "frames/data_check.h"
#include "frames/frame_store.h"
#include "handles.h"
#include "scene/data/data_rig.h"
#include "scene/data/layouts.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "scene/recorded_light.h"
#include "scene/shape/shape_fit.h"

namespace mirage::python {
namespace {

/// Cache by name of the depth models and roof finders: costly to load, and the same for every frame.
template <class Made>
std::shared_ptr<const Made> cached(const std::string& key,
                                   const std::function<std::shared_ptr<const Made>()>& make) {
  static std::mutex mutex;
  static std::map<std::string, std::shared_ptr<const Made>> cache;
  const std::lock_guard lock(mutex);
  auto& entry = cache[key];
  if (!entry) entry = make();
  return entry;
}

using cli::InsertionOptions;

std::vector<HostHandle> hosts_of(const std::shared_ptr<FrameHandle>& frame, double min_view,
                                 const InsertionOptions& settings) {
  const py::gil_scoped_release free;
  const auto prepared = frame->prepared(settings);
  const auto& labels = prepared->frame.labels;
  std::vector<Carrier> carriers(labels.size());
  for (std::size_t i = 0; i < labels.size(); ++i)
    if (is_sought(labels[i]) && has_box(labels[i]))
      carriers[i] = frame->carrier(settings, static_cast<int>(i));
  constexpr std::array<double, 4> kRegion = {0, 70, -40, 40};  // of a detector that names none
  std::vector<HostHandle> hosts;
  for (const HostView& seen :
       host_views(*prepared, carriers, settings.placement, kRegion, settings.simulation))
    if (seen.share >= min_view) hosts.push_back({frame, seen.label, labels[as_size(seen.label)], seen.share});
  return hosts;
}

std::string words(const Label& label) {
  const BevBox& box = label.box.bev;
  return fmt::format("{} at ({:.1f}, {:.1f}) m", label.type, box.x, box.y);
}

using NamedBox = std::pair<std::string, std::array<double, 7>>;

/// A frame of the caller's arrays. InputError naming an invalid argument.
Frame frame_of_arrays(const py::object& image, const py::object& points,
                      const std::array<double, 4>& intrinsics, const py::object& camera_from_velo,
                      const std::vector<NamedBox>& labels, const std::string& id) {
  Frame frame;
  frame.id = id;
  const auto picture = array_of<float>(image, "image", {-1, -1, 3});
  frame.image = ImageF(static_cast<int>(picture.shape(1)), static_cast<int>(picture.shape(0)), 3);
  std::copy_n(picture.data(), frame.image.data.size(), frame.image.data.begin());
  const auto [least, most] = std::minmax_element(frame.image.data.begin(), frame.image.data.end());
  if (frame.image.empty() || !(*least >= 0 && *most <= 1))
    throw InputError("image", "", "is empty or not within [0, 1]", "give scene-linear RGB, H×W×3");
  const auto sweep = array_of<float>(points, "points", {-1, 4});
  frame.sweep.resize(as_size(sweep.shape(0)));
  copy_bytes(frame.sweep.data(), sweep.data(), frame.sweep.size() * sizeof(LidarPoint));
  for (const LidarPoint& point : frame.sweep) {
    if (!point.position().allFinite())
      throw InputError("points", "", "are not finite", "drop those that are not");
    if (!(point.reflectance >= 0 && point.reflectance <= 1))
      throw InputError("points", "reflectance", fmt::format("{:g} is not within [0, 1]", point.reflectance),
                       "divide by the largest that the unit can report, often 255");
  }
  const auto matrix = array_of<double>(camera_from_velo, "camera_from_velo", {3, 4});
  frame.calibration.camera_from_velo.matrix().topRows<3>() =
      Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(matrix.data());
  const Eigen::Matrix3d turn = frame.calibration.camera_from_velo.matrix().topLeftCorner<3, 3>();
  if (!((turn * turn.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 && turn.determinant() > 0))
    throw InputError("camera_from_velo", "", "is not a rotation and a translation",
                     "give the extrinsics alone; the intrinsics are fx, fy, cx, cy");
  if (!(intrinsics[0] > 0 && intrinsics[1] > 0 && std::isfinite(intrinsics[0] * intrinsics[1]) &&
        std::isfinite(intrinsics[2] + intrinsics[3])))
    throw InputError("intrinsics", "", "are not a camera's", "give fx and fy above 0, and cx, cy, in px");
  PinholeCamera& camera = frame.calibration.camera;
  camera.fx = intrinsics[0], camera.fy = intrinsics[1], camera.cx = intrinsics[2], camera.cy = intrinsics[3];
  camera.width = frame.image.width, camera.height = frame.image.height;
  for (const auto& [type, b] : labels) {
    const Box3 box{{b[0], b[1], b[3], b[4], b[6]}, b[2] - b[5] / 2, b[5]};
    if (const std::string problem = label_problem(box); !problem.empty())
      throw InputError("labels", fmt::format("{} at ({:g}, {:g})", type, b[0], b[1]), problem,
                       "give x, y, z of the centre, length, width, height (m), yaw (rad)");
    // A label that the camera does not see has no box in the picture, and keeps its index.
    frame.labels.push_back(projected_label(kitti_type(type), box, frame.calibration)
                               .value_or(Label{.type = kitti_type(type), .truncated = 1, .box = box}));
  }
  frame.lighting = with_road_exposure(frame);
  return frame;
}

void bind_labels(py::module_& module) {
  py::class_<Label>(module, "Label", "A labelled object of a frame; its box in `velo`, metres and radians.")
      .def_readonly("type", &Label::type, "\"Car\", \"Van\", \"Pedestrian\", …, \"DontCare\"")
      .def_readonly("truncated", &Label::truncated, "share outside the picture, 0 … 1")
      .def_readonly("occluded", &Label::occluded, "0 visible, 1 partly, 2 largely occluded, 3 unknown")
      .def_readonly("track", &Label::track, "the vehicle's number in the data set; -1: unknown")
      .def_property_readonly(
          "box_2d", [](const Label& l) { return py::make_tuple(l.left, l.top, l.right, l.bottom); },
          "left, top, right, bottom in pixels; the centre of the top left pixel is (0, 0)")
      .def_property_readonly(
          "box_bev",
          [](const Label& l) {
            const BevBox& b = l.box.bev;
            return py::make_tuple(b.x, b.y, b.length, b.width, b.yaw);
          },
          "x, y of the centre, length, width (m), yaw (rad, counter-clockwise from +x)")
      .def_property_readonly(
          "bottom", [](const Label& l) { return l.box.bottom; }, "z of the box's bottom, m")
      .def_property_readonly(
          "height", [](const Label& l) { return l.box.height; }, "m")
      .def("__repr__", [](const Label& l) { return "<mirage.Label " + words(l) + ">"; });
  py::class_<HostHandle>(module, "Host", "A vehicle of a frame that can carry a mesh on its roof.")
      .def_readonly("frame", &HostHandle::frame, "its frame")
      .def_readonly("index", &HostHandle::index, "of its label in frame.labels")
      .def_readonly("label", &HostHandle::label, "its label")
      .def_readonly("share_in_view", &HostHandle::share_in_view,
                    "share of the reference mesh on its roof that the picture shows, 0 … 1")
      .def("__repr__",
           [](const HostHandle& h) { return fmt::format("<mirage.Host {}: {}>", h.index, words(h.label)); });
}

}  // namespace

FrameHandle::FrameHandle(const std::filesystem::path& data, const std::string& id, const std::string& rig)
    : data_(data),
      rig_(rig),
      lidar_(lidar_of(data, rig)),
      recorded_(recorded_lidar_effects(data, rig)),
      frame_(read_frame(data, id)) {}

FrameHandle::FrameHandle(Frame frame, const std::string& rig)
    : rig_(rig.empty() ? "kitti64" : rig),
      rig_is_assumed_(rig.empty()),
      lidar_(read_lidar_model(rig_file(rig_))),
      recorded_("unit"),
      frame_(std::move(frame)) {}

std::shared_ptr<const PreparedFrame> FrameHandle::prepared(const InsertionOptions& settings) {
  const std::lock_guard lock(mutex_);
  auto& slot = prepared_[{settings.depth, settings.sun, settings.classes}];
  if (!slot) {
    if (!data_.empty()) check_data(data_, rig_, UnitUse::casts_rays);
    const SunChoice choice = parse_sun(settings.sun);
    const auto completion = cached<DepthCompletion>(settings.depth, [&] {
      return std::shared_ptr<const DepthCompletion>(load_depth_completion({settings.depth}));
    });
    Frame frame = frame_;
    frame.lighting = with_sun(frame, choice);
    mark_sought(classes_of(settings.classes), frame.labels);
    auto made = std::make_shared<PreparedFrame>(prepare(std::move(frame), lidar_, completion.get()));
    if (data_.empty()) check_sweep(made->index);
    slot = std::move(made);
  }
  return slot;
}

void FrameHandle::check_sweep(const SweepIndex& index) const {
  constexpr double kEnoughOnRays = 0.95;     // as check_data
  constexpr std::size_t kMinReturns = 2000;  // fewer say nothing of the unit
  if (frame_.sweep.size() < kMinReturns || index.assigned_share() >= kEnoughOnRays) return;
  const std::string problem = fmt::format(
      "{:.1f} % of them lie on a ray of the LiDAR of the rig {}{}: another unit recorded them, or in "
      "other axes",
      100 * index.assigned_share(), rig_, rig_is_assumed_ ? ", which is assumed" : "");
  const std::string fix = "name the unit that did (rig=; mirage rig finds one), with x forward, y left, z up";
  if (rig_is_assumed_) throw InputError("points", "", problem, fix);
  spdlog::warn("points{}: {}; {}", frame_.id.empty() ? "" : fmt::format(" of frame {}", frame_.id), problem,
               fix);
}

Carrier FrameHandle::carrier(const InsertionOptions& settings, int label) {
  const auto sought = prepared(settings);
  const Label& host = vehicle_of(sought->frame, label, "host");
  const std::lock_guard lock(mutex_);
  const std::string& finder = settings.rooftop;
  const std::tuple key(finder, settings.classes, label);
  const auto slot = carriers_.find(key);
  if (slot != carriers_.end()) return slot->second;
  const auto finds = cached<RoofFinder>(
      finder + " " + rig_ + " " + (data_.empty() ? "" : std::filesystem::absolute(data_).string()),
      [&] { return std::shared_ptr<const RoofFinder>(make_roof_finder(finder, lidar_)); });
  return carriers_[key] = finds->find(frame_, host);
}

void bind_frames(py::module_& module) {
  bind_labels(module);
  py::class_<InsertionOptions, std::shared_ptr<InsertionOptions>>(module, "Settings",
                                                                  "Parsed settings of an insertion.")
      .def(py::init([](const NamedSettings& named, const std::string& where) {
             auto options = std::make_shared<InsertionOptions>();
             CLI::App table;
             options->add(table, {"data", "rig", "cameras", "sensors"});  // nothing here reads these
             cli::parse_settings(table, named, where);
             options->apply();
             options->quality.app = nullptr;  // the table ends here
             parse_sun(options->sun);
             classes_of(options->classes);
             return options;
           }),
           py::arg("named"), py::arg("where"));
  py::class_<FrameHandle, std::shared_ptr<FrameHandle>>(
      module, "Frame", "A recorded or generated frame: picture, sweep, calibration and labels.")
      .def_static(  // no constructor: of several, pybind11 tries none with a whole number for a float
          "_read",
          [](const std::string& folder, const std::string& id, const std::string& rig) {
            const py::gil_scoped_release free;
            return std::make_shared<FrameHandle>(folder, id, rig);
          },
          py::arg("folder"), py::arg("id"), py::arg("rig") = "")
      .def(py::init([](const py::object& image, const py::object& points,
                       const std::array<double, 4>& intrinsics, const py::object& camera_from_velo,
                       const std::vector<NamedBox>& labels, const std::string& id,
                       const std::filesystem::path& rig) {
             return std::make_shared<FrameHandle>(
                 frame_of_arrays(image, points, intrinsics, camera_from_velo, labels, id), rig.string());
           }),
           py::kw_only(), py::arg("image"), py::arg("points"), py::arg("intrinsics"),
           py::arg("camera_from_velo"), py::arg("labels") = std::vector<NamedBox>(), py::arg("id") = "",
           py::arg("rig") = "",  // an empty path would be Python's "."
           "A frame of arrays: image H×W×3, scene-linear in [0, 1]; points N×4, the whole sweep, "
           "reflectances in [0, 1]; intrinsics fx, fy, cx, cy; camera_from_velo 3×4; labels [(\"Car\", "
           "(x, y, z, length, width, height, yaw)), …], in view or not; rig: the unit that recorded it, a "
           "word of --rig or a file (else kitti64 is assumed, and a sweep of another unit refused). The "
           "light is as strong as the road says, as in recorded frames.")
      .def_property_readonly(
          "id", [](const FrameHandle& f) { return f.frame().id; }, "e.g. \"000008\"")
      .def_property_readonly(
          "image",
          [](const std::shared_ptr<FrameHandle>& f) {
            const ImageF& image = f->frame().image;
            return view(image.data.data(), {image.height, image.width, 3}, f, false);
          },
          "The photograph: H×W×3 float32, scene-linear RGB in [0, 1], row 0 on top. A view, read-only.")
      .def_property_readonly(
          "points",
          [](const std::shared_ptr<FrameHandle>& f) {
            const Sweep& sweep = f->frame().sweep;
            return view(reinterpret_cast<const float*>(sweep.data()), {ssize(sweep.size()), 4}, f, false);
          },
          "The sweep: N×4 float32; x forward, y left, z up (m, `velo`), reflectance. A view, read-only.")
      .def_property_readonly(
          "points_in_view",
          [](const FrameHandle& f) {
            const std::vector<LidarPoint> points = points_in_view(f.frame().sweep, f.frame().calibration);
            const auto* from = reinterpret_cast<const float*>(points.data());
            return own(std::vector<float>(from, from + 4 * points.size()), {ssize(points.size()), 4});
          },
          "Those of `points` that project into the picture: what a detector is given.")
      .def_property_readonly(
          "depth",
          [](const std::shared_ptr<FrameHandle>& f) {
            std::shared_ptr<const PreparedFrame> prepared;
            {
              const py::gil_scoped_release free;
              prepared = f->prepared(InsertionOptions());
            }
            return view(prepared->depth.data.data(), {prepared->depth.height, prepared->depth.width},
                        prepared, false);
          },
          "The photograph's completed depth: H×W float32, planar, m. A view, read-only.")
      .def_property_readonly(
          "pixel_from_velo",
          [](const FrameHandle& f) {
            const auto matrix = pixel_from_velo(f.frame().calibration);
            return own(std::vector<float>(matrix.begin(), matrix.end()), {3, 4});
          },
          "3×4 float32: (u w, v w, w) = M (x, y, z, 1); pixel (0, 0) is the centre of the top left one.")
      .def_property_readonly(
          "camera_from_velo",
          [](const FrameHandle& f) {
            const Eigen::Matrix<double, 3, 4, Eigen::RowMajor> matrix =
                f.frame().calibration.camera_from_velo.matrix().topRows<3>();
            return own(std::vector<double>(matrix.data(), matrix.data() + matrix.size()), {3, 4});
          },
          "3×4 float64: from `velo` to the camera (x right, y down, z forward), m.")
      .def_property_readonly(
          "intrinsics",
          [](const FrameHandle& f) {
            const PinholeCamera& c = f.frame().calibration.camera;
            return py::make_tuple(c.fx, c.fy, c.cx, c.cy);
          },
          "fx, fy, cx, cy of the picture, pixels.")
      .def_property_readonly(
          "labels", [](const FrameHandle& f) { return f.frame().labels; }, "Its labels, in the file's order.")
      .def("_hosts", &hosts_of, py::arg("min_view"), py::arg("settings"))
      .def("__repr__", [](const FrameHandle& f) {
        return fmt::format("<mirage.Frame {}: {}×{} pixels, {} points, {} labels>", f.frame().id,
                           f.frame().image.width, f.frame().image.height, f.frame().sweep.size(),
                           f.frame().labels.size());
      });
  module.def(
      "list_frames", [](const std::filesystem::path& data) { return list_frames(data); }, py::arg("data"),
      "Ids of a data set's frames, in its order. InputError if it has none.");
}

}  // namespace mirage::python
