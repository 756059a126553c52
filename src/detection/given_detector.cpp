#include "detection/given_detector.h"

#include "base/error.h"
#include "detection/process_detector.h"

namespace mirage {
namespace {
std::vector<GivenDetector> in_force;
}  // namespace

DetectorGift::DetectorGift(std::vector<GivenDetector> detectors) {
  if (!in_force.empty())
    throw Failure("detector", "another call with a detector of the program's own is still running",
                  "wait for it, or use another process");
  in_force = std::move(detectors);
}

DetectorGift::~DetectorGift() {
  in_force.clear();
}

bool is_given(const DetectorOptions& options) {
  return options.detector == kGivenDetector || options.detector == kSecondGivenDetector;
}

bool is_outside(const DetectorOptions& options) {
  return is_given(options) || is_program(options.detector);
}

std::string outside_content(const DetectorOptions& options) {
  if (is_program(options.detector)) return program_content(options.detector);
  const GivenDetector* given = given_detector(options);
  return given ? given->content : "";
}

const GivenDetector* given_detector(const DetectorOptions& options) {
  const std::size_t which = options.detector == kSecondGivenDetector ? 1 : 0;
  return is_given(options) && which < in_force.size() ? &in_force[which] : nullptr;
}

}  // namespace mirage
