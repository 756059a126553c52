// A detector in a process of its own, in any language: `--detector "exec:python3 my_detector.py"`. Frames go
// through shared memory, messages as JSON lines over its standard input and output;
// plugins/process/mirage_process.h describes the protocol.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "detection/detector.h"

namespace mirage {

// External detectors, in another program or in Python: their descriptions, and their answers as rows of boxes
// with logits.

/// A detector's description: its answer to hello (plugins/process/mirage_process.h).
struct ExternalDescription {
  Capabilities can;
  std::array<double, 4> region = {0, 70, -40, 40};
  bool bytes = false;  ///< its pictures are 8-bit sRGB
};
/// Missing keys get the protocol's defaults. InputError naming `who` and the invalid key.
ExternalDescription read_external_description(const nlohmann::json& description, const std::string& who);

/// Whether all values are finite: answers are checked, and gradients, too.
bool all_finite(std::span<const float> values);

/// Boxes as row-major arrays. Columns in the picture: left, top, right, bottom (pixels). Otherwise in the ego
/// frame, m and rad: x, y, length, width, yaw; or x, y, z of the centre, length, width, height, yaw; or these
/// and the velocity's x and y (m/s).
struct RawBoxes {
  const float* boxes = nullptr;
  const float* logits = nullptr;
  std::size_t count = 0, columns = 0;
  std::span<const std::int32_t> classes = {};  ///< each row's, in Capabilities::types; empty: all the first
  std::span<const std::int32_t> identities = {};  ///< Detection::identity of each row; empty: none
};

/// Maps proposals to the rows of a detector's answers, and their gradients back.
class BoxRows {
 public:
  /// Whether a box may have that many columns: 4 in the picture, otherwise 5, 7 or 9.
  static bool knows(std::size_t columns, bool in_picture);
  /// "give boxes [M,5] …": for messages.
  static const char* guide();

  /// The rows with a score over the threshold, in order. Boxes in the picture are clipped to width × height.
  /// InputError naming `who` for an invalid box (check_proposals) or class.
  std::vector<Detection> proposals(const RawBoxes& raw, const Capabilities& can, double score_threshold,
                                   int width, int height, const std::string& who);
  /// The same for answers that are already checked; these are the rows.
  std::vector<Detection> proposals(std::vector<Detection> answers, double score_threshold);
  /// d_logits, one a proposal, by row; zero for other rows. Failure for more values than proposals.
  std::vector<float> of_rows(std::span<const double> d_logits) const;
  /// Rows of the boxes that proposals() last took.
  std::size_t count() const { return count_; }

 private:
  std::size_t count_ = 0;
  std::vector<std::size_t> places_;
};

/// The first value of the sensor's array.
const float* first_value(const SensorData& sensor);

/// A sensor as described to an external detector.
struct ExternalSensor {
  /// `reads`: the detector's capabilities.
  ExternalSensor(const SensorData& sensor, const Capabilities& reads);
  std::string name;
  SensorData::Kind kind;
  std::vector<std::size_t> shape;  ///< of its array
  bool sent;                       ///< whether the detector gets its array
  std::size_t at = 0;              ///< the array's place, in its carrier's units
  /// Number of values in its array.
  std::size_t values() const;
  /// The key of its kind in jobs and answers: "cameras", "lidars", "sensors".
  const char* group() const;
  /// The key of its array: "image", "points", "data".
  const char* array() const;
};

/// An external detector, with any transport of its messages and arrays.
class ExternalDetector : public Detector {
 public:
  /// `who`: the name in errors.
  ExternalDetector(std::string name, std::string who) : name_(std::move(name)), error_name_(std::move(who)) {}
  std::string name() const override { return name_; }
  Capabilities capabilities() const override { return description_.can; }
  std::array<double, 4> region() const override { return description_.region; }

 protected:
  /// The description of a view, as in the job detect. give(sensor, its description) hands an array over and
  /// returns its location.
  nlohmann::json describe_input(
      const SensorView& view, const std::function<nlohmann::json(const SensorData&, ExternalSensor&)>& give);
  /// The gradient of the last view; of(sensor) gives that of each of sensors_.
  SensorGradient gradient(const std::function<std::vector<float>(const ExternalSensor&)>& of) const;
  /// InputError with the reason `why` if the detector reads a picture and the view has none.
  void throw_if_blind(const SensorView& view, const char* why) const;

  std::string name_, error_name_;
  ExternalDescription description_;
  std::vector<ExternalSensor> sensors_;  ///< of the last view
  BoxRows rows_;
};

/// Whether the word names a program, which is code: "exec:" and a command, its words as in a shell.
bool is_program(const std::string& detector);

/// Hash of the command's words and of the files that they name, alone or behind a "=" (--weights=FILE).
/// Contents of folders, Python modules (-m NAME) and programs on PATH, and files that they load, are not
/// included: they count by name, and a warning names the first two. InputError for an invalid command.
std::string program_hash(const std::string& detector);

/// Time limits for the program, s.
struct ProcessLimits {
  double start = 600;   ///< until it serves: it loads its network, and may build it
  double answer = 300;  ///< for one frame
};

/// Starts the program and waits until it serves. If it is lost at a frame, it is started again and asked
/// again; Failure after three tries. InputError naming the command if it cannot be started, ends before it
/// serves or speaks another protocol; later Failure for an error that it reports and for arrays of another
/// shape. It ends with the detector.
std::unique_ptr<Detector> start_program(const DetectorOptions& options, const ProcessLimits& limits = {});

// A detector inside the host program, in place of a plugin: `--detector python` in a Python program
// (plugins/python). The command line has none.

/// DetectorOptions::detector of the in-process detector, or of the first of two.
inline constexpr const char* kInProcessDetector = "python";
/// The same for the second, if two are compared.
inline constexpr const char* kSecondInProcessDetector = "python:2";
/// A run folder's file with a TorchScript copy of the in-process detector, if it could be copied.
inline constexpr const char* kInProcessDetectorCopy = "detector.pt";

/// `make` gives an instance; all instances together serve one thread at a time. `content` changes with the
/// network: a run resumes only with the same content.
struct InProcessDetector {
  std::function<std::unique_ptr<Detector>()> make;
  std::string content;
};

/// While it lives, load_detector knows its one or two detectors. One scope at a time.
class ScopedDetectors {
 public:
  /// Failure if another one is in force.
  explicit ScopedDetectors(std::vector<InProcessDetector> detectors);
  ~ScopedDetectors();
  ScopedDetectors(const ScopedDetectors&) = delete;
  ScopedDetectors& operator=(const ScopedDetectors&) = delete;
};

/// Whether the options name an in-process detector.
bool is_in_process(const DetectorOptions& options);
/// Whether the options name an in-process detector or a program: an external detector, without a plugin or a
/// weights file.
bool is_outside(const DetectorOptions& options);
/// An external detector's InProcessDetector::content (empty without one), or program_hash.
std::string outside_content(const DetectorOptions& options);
/// The in-process detector that the options name; null without one.
const InProcessDetector* in_process_detector(const DetectorOptions& options);

}  // namespace mirage
