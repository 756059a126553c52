// A detector of the host program's own, in the place of a plugin: what `--detector python` stands for in a
// Python program (plugins/python). The command line has none.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "detection/detector.h"

namespace mirage {

/// DetectorOptions::detector of the one that was given, or of the first of two.
inline constexpr const char* kGivenDetector = "python";
/// And of the second, where two are compared.
inline constexpr const char* kSecondGivenDetector = "python:2";
/// A run folder's file with a TorchScript copy of the given detector, where it could be copied.
inline constexpr const char* kGivenDetectorCopy = "detector.pt";

/// `make` gives an instance; it serves one thread at a time, and so do all of them together. `content`
/// changes when the network does: a run goes on only with the same.
struct GivenDetector {
  std::function<std::unique_ptr<Detector>()> make;
  std::string content;
};

/// For as long as it lives, load_detector knows the given detector, or two. One at a time.
class DetectorGift {
 public:
  /// Failure if another one is in force.
  explicit DetectorGift(std::vector<GivenDetector> detectors);
  ~DetectorGift();
  DetectorGift(const DetectorGift&) = delete;
  DetectorGift& operator=(const DetectorGift&) = delete;
};

/// Whether the options name a given detector.
bool is_given(const DetectorOptions& options);
/// Whether they name a given detector or a program (detection/process_detector.h): a detector of the user's
/// own, without a plugin or a weights file.
bool is_outside(const DetectorOptions& options);
/// Of such a detector: GivenDetector::content (empty without one), or program_content.
std::string outside_content(const DetectorOptions& options);
/// The one in force that they name; null without one.
const GivenDetector* given_detector(const DetectorOptions& options);

}  // namespace mirage
