// The commands of `mirage`, and a detector that is a Python object.
#include <fmt/format.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <optional>
#include <tuple>

#include "arrays.h"
#include "attack/run.h"
#include "base/error.h"
#include "base/image.h"
#include "base/logging.h"
#include "base/sizes.h"
#include "bind.h"
#include "cli/field_options.h"
#include "detection/car_in_picture.h"
#include "detection/process_detector.h"

namespace mirage::python {
namespace {

/// A Python object that only threads holding the interpreter's lock may let go of.
std::shared_ptr<py::object> held(py::object object) {
  return {new py::object(std::move(object)), [](py::object* kept) {
            const py::gil_scoped_acquire lock;
            delete kept;
          }};
}

/// The object of mirage/_detector.py, which has the network and its graph.
class PythonDetector : public Detector {
 public:
  PythonDetector(std::shared_ptr<py::object> adapter, std::string name)
      : adapter_(std::move(adapter)), name_(std::move(name)) {
    const py::gil_scoped_acquire lock;
    const auto word = py::module_::import("json").attr("dumps")(adapter_->attr("word")()).cast<std::string>();
    word_ = read_outside_word(nlohmann::json::parse(word), name_);
  }

  std::string name() const override { return name_; }
  std::array<double, 4> region() const override { return word_.region; }
  Capabilities capabilities() const override { return word_.can; }

  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    const py::gil_scoped_acquire lock;
    sensors_ = sensors(input, word_.can, "detector");
    const ImageF* image = sensors_.front().image;
    const bool seen = image && !image->empty();
    levels_ = levels_of(sensors_);
    const std::vector<SensorData> clean = clean_sensors_of(input, word_.can, "detector");
    const Levels clean_levels = levels_of(clean);
    try {
      const auto output = adapter_->attr("forward")(told(input, clean, clean_levels), keep_graph)
                              .cast<std::tuple<Array<float>, Array<float>, std::optional<Array<std::int32_t>>,
                                               std::optional<Array<std::int32_t>>>>();
      const auto& [boxes, logits, classes, identities] = output;
      RawBoxes raw{boxes.data(), logits.data(), as_size(logits.shape(0)), as_size(boxes.shape(1))};
      if (classes) raw.classes = {classes->data(), raw.count};
      if (identities) raw.identities = {identities->data(), raw.count};
      return rows_.proposals(raw, word_.can, score_threshold, seen ? image->width : 0,
                             seen ? image->height : 0, "detector");
    } catch (const py::error_already_set& error) {
      if (seen || !word_.can.reads_image) throw;  // the caller's own error, with its trace
      throw InputError("detector", "image", std::string("cannot do without a picture (") + error.what() + ")",
                       "give it one");
    }
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    const py::gil_scoped_acquire lock;
    const auto given = adapter_->attr("backward")(own(rows_.of_rows(d_logits), {ssize(rows_.count())}))
                           .cast<std::map<std::string, Array<float>>>();
    SensorGradient gradient;
    for (std::size_t i = 0; i < sensors_.size(); ++i) {
      const SensorData& sensor = sensors_[i];
      const bool camera = sensor.kind == SensorData::Kind::camera;
      const int width = camera && sensor.image ? sensor.image->width : 0,
                height = camera && sensor.image ? sensor.image->height : 0;
      std::vector<float> values(camera ? ImageF(width, height, 3).data.size()
                                       : 4 * sensor.points.size() + sensor.values.size());
      if (const auto found = given.find(sensor.name); found != given.end()) {
        if (as_size(found->second.size()) != values.size())
          throw InputError("detector", "gradient to " + sensor.name,
                           fmt::format("has {} values for {}", found->second.size(), values.size()),
                           "give one for each that was given");
        const std::span<const float> there(found->second.data(), values.size());
        if (!all_finite(there))
          throw InputError("detector", "gradient to " + sensor.name, "is not finite",
                           "look for roots and norms of 0 in the network");
        std::copy(there.begin(), there.end(), values.begin());
        if (camera && word_.bytes) through_srgb_slope(levels_[i], values);
      }
      if (i == 0) {
        gradient.image = ImageF(width, height, 3);
        gradient.image.data = std::move(values);
      } else if (i == 1) {
        gradient.points.resize(sensor.points.size());
        if (!gradient.points.empty()) std::copy(values.begin(), values.end(), gradient.points.front().data());
      } else {
        gradient.others[sensor.name] = std::move(values);
      }
    }
    return gradient;
  }

  TrainingLoss train_step(std::span<const TrainingSample>, double) override {
    throw InputError("detector", "python", "is trained in Python", "train it there");
  }
  void save(const std::filesystem::path& file, bool) override {
    throw InputError(file.string(), "python", "a detector given in Python has no weights file",
                     "save it there");
  }

 private:
  template <class T>
  using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;

  using Levels =
      std::vector<std::vector<std::uint8_t>>;  ///< of each camera, for a detector of 8-bit pictures

  Levels levels_of(const std::vector<SensorData>& sensors) const {
    Levels levels(sensors.size());
    if (word_.bytes && word_.can.reads_image)
      for (std::size_t i = 0; i < sensors.size(); ++i)
        if (sensors[i].image) levels[i] = srgb_bytes(*sensors[i].image);
    return levels;
  }

  /// Cameras and LiDARs as mirage_serve.py's Frame reads them: arrays over memory that lives for the call.
  py::dict told(const std::vector<SensorData>& sensors, const Levels& levels) const {
    const auto borrowed = std::shared_ptr<const void>(&sensors, [](const void*) {});
    py::dict cameras, lidars, others, all;
    for (std::size_t i = 0; i < sensors.size(); ++i) {
      const SensorData& sensor = sensors[i];
      py::dict one;
      one["time"] = sensor.time;
      if (sensor.kind == SensorData::Kind::camera) {
        if (word_.can.reads_image && sensor.image && !sensor.image->empty()) {
          const Shape shape = {sensor.image->height, sensor.image->width, 3};
          if (word_.bytes)
            one["image"] = view(levels[i].data(), shape, borrowed, false);
          else
            one["image"] = view(sensor.image->data.data(), shape, borrowed, false);
        }
        Calibration calibration;
        calibration.camera = sensor.camera, calibration.camera_from_velo = sensor.sensor_from_ego;
        const PinholeCamera& c = sensor.camera;
        one["pixel_from_velo"] = pixel_from_velo(calibration);
        one["intrinsics"] = std::array<double, 4>{c.fx, c.fy, c.cx, c.cy};
        cameras[py::str(sensor.name)] = one;
      } else if (sensor.kind == SensorData::Kind::other) {
        one["data"] = view(sensor.values.data(), {sensor.shape.begin(), sensor.shape.end()}, borrowed, false);
        others[py::str(sensor.name)] = one;
      } else {
        if (word_.can.reads_points)
          one["points"] = view(reinterpret_cast<const float*>(sensor.points.data()),
                               {ssize(sensor.points.size()), 4}, borrowed, false);
        lidars[py::str(sensor.name)] = one;
      }
    }
    all["cameras"] = cameras;
    all["lidars"] = lidars;
    all["sensors"] = others;
    return all;
  }

  /// The view as Frame reads it. `clean`: clean_sensors_of it.
  py::dict told(const SensorView& input, const std::vector<SensorData>& clean,
                const Levels& clean_levels) const {
    py::dict all = told(sensors_, levels_);
    if (!clean.empty()) {
      py::dict before = told(clean, clean_levels);
      before["key"] = fmt::format("{:016x}", input.clean->key);
      const py::dict cameras = before["cameras"];
      for (const auto& [name, camera] : cameras) {
        const bool first = name.cast<std::string>() == clean.front().name;
        const PixelRect changed = first ? input.clean->changed : PixelRect();
        camera["changed"] = std::array<int, 4>{changed.u0, changed.v0, changed.u1, changed.v1};
      }
      all["clean"] = before;
    }
    all["frame"] = input.frame ? input.frame->id : "";
    all["continues"] = input.continues;
    if (input.frame && input.frame->moment) {
      const Moment& moment = *input.frame->moment;
      std::array<double, 12> rows{};
      Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(rows.data()) =
          moment.world_from_ego.matrix().topRows<3>();
      py::dict told;
      told["sequence"] = moment.sequence, told["index"] = moment.index, told["time"] = moment.time;
      told["world_from_ego"] = rows;
      all["moment"] = told;
    }
    return all;
  }

  std::shared_ptr<py::object> adapter_;
  std::string name_;
  OutsideWord word_;
  std::vector<SensorData> sensors_;  ///< of the last forward
  Levels levels_;
  BoxRows rows_;
};

/// Commands print a short table: C's standard output goes into memory meanwhile (a variable in glibc).
/// Python's own does not pass through it.
class Tables {
 public:
  Tables() : before_(stdout), file_(::open_memstream(&text_, &size_)) {
    if (file_) stdout = file_;
  }
  ~Tables() {
    stdout = before_;
    if (file_) std::fclose(file_);
    std::free(text_);
  }
  Tables(const Tables&) = delete;
  Tables& operator=(const Tables&) = delete;

  std::string text() {
    if (file_) std::fflush(file_);
    return {text_ ? text_ : "", size_};
  }

 private:
  char* text_ = nullptr;
  std::size_t size_ = 0;
  std::FILE *before_, *file_;
};

/// A detector of the caller's: the object of mirage/_detector.py, and GivenDetector::content.
using Given = std::pair<py::object, std::string>;

/// What result.json holds, as JSON, and what the command prints. `detectors`: those that "python" and
/// "python:2" stand for. `progress`: called with (what, done, total, time left, note), or None: nothing is
/// shown where `quiet`, and warnings alone are logged.
std::pair<std::string, std::string> run(const std::string& command, const NamedSettings& settings,
                                        const std::vector<Given>& detectors, const std::string& where,
                                        const py::object& progress, bool quiet) {
  std::vector<GivenDetector> given;
  for (const auto& [detector, content] : detectors) {
    const char* name = given.empty() ? kGivenDetector : kSecondGivenDetector;
    given.push_back(
        {[adapter = held(detector), name] { return std::make_unique<PythonDetector>(adapter, name); },
         content});
  }
  std::shared_ptr<py::object> listener;
  if (!progress.is_none()) listener = held(progress);
  const py::gil_scoped_release free;
  const InterruptWatch watch;
  Tables tables;
  keep_logging_quiet(quiet);
  std::optional<ProgressTo> shown;
  if (listener || quiet)
    shown.emplace([&](const std::string& what, std::size_t done, std::size_t total, const std::string& left,
                      const std::string& note) {
      if (!listener) return;
      const py::gil_scoped_acquire lock;
      (*listener)(what, done, total, left, note);
    });
  std::optional<DetectorGift> gift;
  if (!given.empty()) gift.emplace(std::move(given));
  std::string result = cli::run_command(command, settings, where).dump();
  return {std::move(result), tables.text()};
}

}  // namespace

void bind_commands(py::module_& module) {
  module.def("run", &run, py::arg("command"), py::arg("settings"), py::arg("detectors"), py::arg("where"),
             py::arg("progress"), py::arg("quiet"),
             "Runs a command; what its result.json holds, as JSON, and the table that it prints.");
  module.attr("list_separator") = std::string(1, cli::kListSeparator);
  module.def("remember_code_made_here", &remember_code_made_here, py::arg("file"),
             "So that the command line reads a run that holds this file without --trust-run.");
}

}  // namespace mirage::python
