// A detector in a process of its own, in any language: `--detector "exec:python3 my_detector.py"`. Frames go
// by shared memory, words as JSON lines over its standard input and output; the protocol stands in
// plugins/process/mirage_process.h.
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

// Detectors outside the program, in another one or in Python: what they say of themselves, and their answers,
// rows of boxes with their logits.

/// What one says of itself: the answer to hello (plugins/process/mirage_process.h).
struct ExternalDescription {
  Capabilities can;
  std::array<double, 4> region = {0, 70, -40, 40};
  bool bytes = false;  ///< its pictures are 8-bit sRGB
};
/// What the object leaves out is as the protocol says. InputError naming `who` and the key that is wrong.
ExternalDescription read_external_description(const nlohmann::json& description, const std::string& who);

/// Whether its numbers are: what it answers is looked at, gradients too.
bool all_finite(std::span<const float> values);

/// As arrays, row-major. Columns in the picture: left, top, right, bottom (pixels). Else in the ego frame, m
/// and rad: x, y, length, width, yaw; or x, y, z of the centre, length, width, height, yaw; or these and the
/// velocity's x and y (m/s).
struct RawBoxes {
  const float* boxes = nullptr;
  const float* logits = nullptr;
  std::size_t count = 0, columns = 0;
  std::span<const std::int32_t> classes = {};  ///< of each row, in Capabilities::types; empty: all the first
  std::span<const std::int32_t> identities = {};  ///< Detection::identity of each row; empty: none
};

/// Which of a detector's answers, a row each, became proposals, so that their gradients find the way back.
class BoxRows {
 public:
  /// Whether a box may have so many numbers: 4 in the picture, else 5, 7 or 9.
  static bool knows(std::size_t columns, bool in_picture);
  /// "give boxes [M,5] …": for messages.
  static const char* guide();

  /// Those with a score over the threshold, in their order. Boxes in the picture end at its border
  /// (width × height). InputError naming `who` for what is no box (check_proposals), or of no class.
  std::vector<Detection> proposals(const RawBoxes& raw, const Capabilities& can, double score_threshold,
                                   int width, int height, const std::string& who);
  /// The same of answers that have been checked; they are the rows.
  std::vector<Detection> proposals(std::vector<Detection> answers, double score_threshold);
  /// One value a row from one a proposal; zero for the rest. Failure for more values than proposals.
  std::vector<float> of_rows(std::span<const double> d_logits) const;
  /// Rows of the boxes that proposals() last took.
  std::size_t count() const { return count_; }

 private:
  std::size_t count_ = 0;
  std::vector<std::size_t> places_;
};

/// The array of what a sensor saw.
const float* first_value(const SensorData& sensor);

/// A sensor as such a detector is told of it.
struct ExternalSensor {
  /// `reads`: of the detector.
  ExternalSensor(const SensorData& sensor, const Capabilities& reads);
  std::string name;
  SensorData::Kind kind;
  std::vector<std::size_t> shape;  ///< of its array
  bool sent;                       ///< whether the detector gets its array
  std::size_t at = 0;              ///< where that lies, as whoever carries it counts
  /// In its array.
  std::size_t values() const;
  /// What jobs and answers call its kind: "cameras", "lidars", "sensors".
  const char* group() const;
  /// And its array: "image", "points", "data".
  const char* array() const;
};

/// A detector outside the program, whatever carries its words and arrays.
class ExternalDetector : public Detector {
 public:
  /// `who`: what errors name.
  ExternalDetector(std::string name, std::string who) : name_(std::move(name)), error_name_(std::move(who)) {}
  std::string name() const override { return name_; }
  Capabilities capabilities() const override { return description_.can; }
  std::array<double, 4> region() const override { return description_.region; }

 protected:
  /// What it is told of a view, as the job detect has it. give(sensor, what is told of it) hands an array
  /// over and says where it lies.
  nlohmann::json describe_input(
      const SensorView& view, const std::function<nlohmann::json(const SensorData&, ExternalSensor&)>& give);
  /// By of(sensor), the gradient to each of sensors_.
  SensorGradient gradient(const std::function<std::vector<float>(const ExternalSensor&)>& of) const;
  /// InputError for one that failed, `why`, where it was given no picture and reads one.
  void throw_if_blind(const SensorView& view, const char* why) const;

  std::string name_, error_name_;
  ExternalDescription description_;
  std::vector<ExternalSensor> sensors_;  ///< of the last view
  BoxRows rows_;
};

/// Whether the word names a program, which is code: "exec:" and a command, its words as in a shell.
bool is_program(const std::string& detector);

/// Hash of the command's words and of the files that they name, alone or behind a "=" (--weights=FILE). What
/// folders, Python's modules (-m NAME) and programs on PATH hold is not in it, nor what any of them loads:
/// they count by their names, and a warning says so of the first two. InputError for a command that is none.
std::string program_content(const std::string& detector);

/// How long the program may take, s.
struct ProcessLimits {
  double start = 600;   ///< until it serves: it loads its network, and may build it
  double answer = 300;  ///< for one frame
};

/// Starts the program and waits until it serves. One that is lost at a frame is started again and asked once
/// more, three times in all: then Failure. InputError naming the command if it cannot be started, ends before
/// it serves or speaks another protocol; later Failure for an error that it tells and for arrays of another
/// shape. It ends with the detector.
std::unique_ptr<Detector> start_program(const DetectorOptions& options, const ProcessLimits& limits = {});

// A detector of the host program's own, in the place of a plugin: what `--detector python` stands for in a
// Python program (plugins/python). The command line has none.

/// DetectorOptions::detector of the one that was given, or of the first of two.
inline constexpr const char* kInProcessDetector = "python";
/// And of the second, where two are compared.
inline constexpr const char* kSecondInProcessDetector = "python:2";
/// A run folder's file with a TorchScript copy of the given detector, where it could be copied.
inline constexpr const char* kInProcessDetectorCopy = "detector.pt";

/// `make` gives an instance; it serves one thread at a time, and so do all of them together. `content`
/// changes when the network does: a run goes on only with the same.
struct InProcessDetector {
  std::function<std::unique_ptr<Detector>()> make;
  std::string content;
};

/// For as long as it lives, load_detector knows the given detector, or two. One at a time.
class ScopedDetectors {
 public:
  /// Failure if another one is in force.
  explicit ScopedDetectors(std::vector<InProcessDetector> detectors);
  ~ScopedDetectors();
  ScopedDetectors(const ScopedDetectors&) = delete;
  ScopedDetectors& operator=(const ScopedDetectors&) = delete;
};

/// Whether the options name a given detector.
bool is_in_process(const DetectorOptions& options);
/// Whether they name a given detector or a program: a detector of the user's
/// own, without a plugin or a weights file.
bool is_outside(const DetectorOptions& options);
/// Of such a detector: InProcessDetector::content (empty without one), or program_content.
std::string outside_content(const DetectorOptions& options);
/// The one in force that they name; null without one.
const InProcessDetector* in_process_detector(const DetectorOptions& options);

}  // namespace mirage
