// The commands of `mirage`, and a detector that is a Python object.
#include <cmath>
#include <cstdio>
#include <optional>

#include "arrays.h"
#include "attack/run.h"
#include "base/error.h"
#include "base/interrupt_watch.h"
#include "bind.h"
#include "cli/named_settings.h"
#include "detection/given_detector.h"
#include "detection/points_in_view.h"

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
  explicit PythonDetector(std::shared_ptr<py::object> adapter) : adapter_(std::move(adapter)) {
    const py::gil_scoped_acquire lock;
    region_ = adapter_->attr("region").cast<std::array<double, 4>>();
    picture_ = adapter_->attr("finds_picture").cast<bool>();
  }

  std::string name() const override { return kGivenDetector; }
  std::array<double, 4> region() const override { return region_; }
  Capabilities capabilities() const override {
    return picture_ ? Capabilities{true, false, false, true} : Capabilities();
  }

  std::vector<Proposal> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    const py::gil_scoped_acquire lock;
    const bool seen = input.image && !input.image->empty();
    static const ImageF none(0, 0, 3);
    const ImageF& image = seen ? *input.image : none;
    // Views of memory that lives for this call: the adapter copies.
    const auto borrowed = std::shared_ptr<const void>(&input, [](const void*) {});
    const auto matrix = pixel_from_velo(*input.calibration);
    try {
      const auto output =
          adapter_
              ->attr("forward")(seen
                                    ? view(image.data.data(), {image.height, image.width, 3}, borrowed, false)
                                    : py::array_t<float>(Shape{0, 0, 3}),
                                view(reinterpret_cast<const float*>(input.points.data()),
                                     {ssize(input.points.size()), 4}, borrowed, false),
                                own(std::vector<float>(matrix.begin(), matrix.end()), {3, 4}), keep_graph)
              .cast<std::pair<py::array_t<float, py::array::c_style | py::array::forcecast>,
                              py::array_t<float, py::array::c_style | py::array::forcecast>>>();
      return proposals(output.first, output.second, score_threshold, image);
    } catch (const py::error_already_set& error) {
      if (seen) throw;  // the caller's own error, with its trace
      throw InputError("detector", "image", std::string("cannot do without a picture (") + error.what() + ")",
                       "give it one");
    }
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    const py::gil_scoped_acquire lock;
    std::vector<float> all(count_);
    for (std::size_t i = 0; i < d_logits.size(); ++i) all[places_[i]] = static_cast<float>(d_logits[i]);
    const auto [d_image, d_points] =
        adapter_->attr("backward")(own(std::move(all), {ssize(count_)}))
            .cast<std::pair<py::array_t<float, py::array::c_style | py::array::forcecast>,
                            py::array_t<float, py::array::c_style | py::array::forcecast>>>();
    SensorGradient gradient{ImageF(static_cast<int>(d_image.shape(1)), static_cast<int>(d_image.shape(0)), 3),
                            {}};
    std::copy_n(d_image.data(), gradient.image.data.size(), gradient.image.data.begin());
    gradient.points.resize(static_cast<std::size_t>(d_points.shape(0)));
    if (!gradient.points.empty())
      std::copy_n(d_points.data(), 4 * gradient.points.size(), gradient.points.front().data());
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
  std::vector<Proposal> proposals(const py::array_t<float>& boxes, const py::array_t<float>& logits,
                                  double score_threshold, const ImageF& image) {
    count_ = static_cast<std::size_t>(logits.shape(0));
    places_.clear();
    std::vector<Proposal> kept;
    const float* box = boxes.data();
    for (std::size_t i = 0; i < count_; ++i, box += boxes.shape(1)) {
      Proposal proposal;
      proposal.logit = logits.data()[i];
      if (!(proposal.score() > score_threshold)) continue;
      if (picture_)
        proposal.picture = {box[0], box[1], box[2], box[3]};
      else
        proposal.box = {box[0], box[1], box[2], box[3], box[4]};
      kept.push_back(proposal);
      places_.push_back(i);
    }
    check_proposals(kept, picture_ ? Plane::picture : Plane::bev);
    for (Proposal& proposal : kept) proposal.picture = within(proposal.picture, image.width, image.height);
    return kept;
  }

  std::shared_ptr<py::object> adapter_;
  std::array<double, 4> region_{};
  bool picture_ = false;
  std::size_t count_ = 0;            ///< of the last forward, all of them
  std::vector<std::size_t> places_;  ///< of its proposals over the threshold
};

/// Commands print a table of what Python gets as a dictionary: C's standard output goes nowhere meanwhile (a
/// variable in glibc). Python's own does not pass through it.
class NoTables {
 public:
  NoTables() : before_(stdout), nowhere_(std::fopen("/dev/null", "w")) {
    if (nowhere_) stdout = nowhere_;
  }
  ~NoTables() {
    stdout = before_;
    if (nowhere_) std::fclose(nowhere_);
  }
  NoTables(const NoTables&) = delete;
  NoTables& operator=(const NoTables&) = delete;

 private:
  std::FILE *before_, *nowhere_;
};

std::string run(const std::string& command, const NamedSettings& settings, const py::object& detector,
                const std::string& content, const std::string& where) {
  std::shared_ptr<py::object> adapter;
  if (!detector.is_none()) adapter = held(detector);
  const py::gil_scoped_release free;
  const InterruptWatch watch;
  const NoTables silence;
  std::optional<DetectorGift> gift;
  if (adapter)
    gift.emplace(GivenDetector{[adapter] { return std::make_unique<PythonDetector>(adapter); }, content});
  return cli::run_command(command, settings, where).dump();
}

}  // namespace

void bind_commands(py::module_& module) {
  module.def("run", &run, py::arg("command"), py::arg("settings"), py::arg("detector"), py::arg("content"),
             py::arg("where"), "Runs a command; what its result.json holds, as JSON.");
  module.def("remember_code_made_here", &remember_code_made_here, py::arg("file"),
             "So that the command line reads a run that holds this file without --trust-run.");
}

}  // namespace mirage::python
