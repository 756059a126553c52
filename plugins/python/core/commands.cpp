// The commands of `mirage`, and a detector that is a Python object.
#include <fmt/format.h>

#include <cstdio>
#include <cstdlib>
#include <map>
#include <mutex>
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
class PythonDetector : public ExternalDetector {
 public:
  PythonDetector(std::shared_ptr<py::object> adapter, std::string name)
      : ExternalDetector(std::move(name), "detector"), adapter_(std::move(adapter)) {
    const py::gil_scoped_acquire lock;
    const auto word = py::module_::import("json").attr("dumps")(adapter_->attr("word")()).cast<std::string>();
    description_ = read_external_description(nlohmann::json::parse(word), name_);
  }

  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    const py::gil_scoped_acquire lock;
    levels_.clear();
    py::list arrays;
    nlohmann::json job = describe_input(input, [&](const SensorData& sensor, ExternalSensor& its) {
      its.at = levels_.size();
      arrays.append(array_of(sensor, its));
      return nlohmann::json{{"at", its.at}};
    });
    if (input.frame) job["frame"] = input.frame->id;  // in Python names are as they are
    if (job.contains("moment")) job["moment"]["sequence"] = input.frame->moment->sequence;
    const ImageF* image = input.image;
    try {
      const auto output = adapter_->attr("forward")(job.dump(), arrays, keep_graph)
                              .cast<std::tuple<Array<float>, Array<float>, std::optional<Array<std::int32_t>>,
                                               std::optional<Array<std::int32_t>>>>();
      const auto& [boxes, logits, classes, identities] = output;
      RawBoxes raw{boxes.data(), logits.data(), as_size(logits.shape(0)), as_size(boxes.shape(1))};
      if (classes) raw.classes = {classes->data(), raw.count};
      if (identities) raw.identities = {identities->data(), raw.count};
      return rows_.proposals(raw, description_.can, score_threshold, image ? image->width : 0,
                             image ? image->height : 0, error_name_);
    } catch (const py::error_already_set& error) {
      throw_if_blind(input, error.what());
      throw;  // the caller's own error, with its trace
    }
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    const py::gil_scoped_acquire lock;
    const auto gradients = adapter_->attr("backward")(own(rows_.of_rows(d_logits), {ssize(rows_.count())}))
                               .cast<std::map<std::string, Array<float>>>();
    return gradient([&](const ExternalSensor& sensor) {
      std::vector<float> values(sensor.values());
      const auto found = gradients.find(sensor.name);
      if (found == gradients.end()) return values;
      if (as_size(found->second.size()) != values.size())
        throw InputError(error_name_, "gradient to " + sensor.name,
                         fmt::format("has {} values for {}", found->second.size(), values.size()),
                         "give one for each that was given");
      const std::span<const float> there(found->second.data(), values.size());
      if (!all_finite(there))
        throw InputError(error_name_, "gradient to " + sensor.name, "is not finite",
                         "look for roots and norms of 0 in the network");
      std::copy(there.begin(), there.end(), values.begin());
      if (sensor.sent && !levels_[sensor.at].empty()) through_srgb_slope(levels_[sensor.at], values);
      return values;
    });
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

  /// Over memory that lives for the call of forward.
  py::array array_of(const SensorData& sensor, const ExternalSensor& its) {
    const Shape shape(its.shape.begin(), its.shape.end());
    const auto borrowed = std::shared_ptr<const void>(&sensor, [](const void*) {});
    std::vector<std::uint8_t>& levels = levels_.emplace_back();
    if (its.kind == SensorData::Kind::camera && description_.bytes) {
      levels = srgb_bytes(*sensor.image);
      return view(levels.data(), shape, borrowed, false);
    }
    return view(first_value(sensor), shape, borrowed, false);
  }

  std::shared_ptr<py::object> adapter_;
  std::vector<std::vector<std::uint8_t>> levels_;  ///< of each array: of a camera's, for 8-bit pictures
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

/// A detector of the caller's: the object of mirage/_detector.py, and InProcessDetector::content.
using CallerDetector = std::pair<py::object, std::string>;

/// The JSON text of result.json, and the command's printed text. `detectors`: the ones that "python" and
/// "python:2" name. `progress`: called with (what, done, total, time left, note), or None: nothing is shown
/// where `quiet`, and only warnings are logged.
std::pair<std::string, std::string> run(const std::string& command, const NamedSettings& settings,
                                        const std::vector<CallerDetector>& detectors,
                                        const std::string& where, const py::object& progress, bool quiet) {
  std::vector<InProcessDetector> in_process;
  for (const auto& [detector, content] : detectors) {
    const char* name = in_process.empty() ? kInProcessDetector : kSecondInProcessDetector;
    in_process.push_back(
        {[adapter = held(detector), name] { return std::make_unique<PythonDetector>(adapter, name); },
         content});
  }
  std::shared_ptr<py::object> listener;
  if (!progress.is_none()) listener = held(progress);
  const py::gil_scoped_release free;
  // One at a time: C's standard output and the listener are the process's. A listener may run another one.
  static std::recursive_mutex running;
  const std::scoped_lock turn(running);
  const InterruptWatch watch;
  Tables tables;
  keep_logging_quiet(quiet);
  std::optional<ProgressListenerScope> shown;
  if (listener || quiet)
    shown.emplace([&](const std::string& what, std::size_t done, std::size_t total, const std::string& left,
                      const std::string& note) {
      if (!listener) return;
      const py::gil_scoped_acquire lock;
      (*listener)(what, done, total, left, note);
    });
  std::optional<ScopedDetectors> scope;
  if (!in_process.empty()) scope.emplace(std::move(in_process));
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
