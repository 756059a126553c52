#include "detection/given_detector.h"

#include <optional>

#include "base/error.h"
#include "detection/process_detector.h"

namespace mirage {
namespace {
std::optional<GivenDetector> in_force;
}  // namespace

DetectorGift::DetectorGift(GivenDetector detector) {
  if (in_force)
    throw Failure("detector", "another call with a detector of the program's own is still running",
                  "wait for it, or use another process");
  in_force = std::move(detector);
}

DetectorGift::~DetectorGift() {
  in_force.reset();
}

bool is_given(const DetectorOptions& options) {
  return options.detector == kGivenDetector;
}

bool is_outside(const DetectorOptions& options) {
  return is_given(options) || is_program(options.detector);
}

std::string outside_content(const DetectorOptions& options) {
  if (is_program(options.detector)) return program_content(options.detector);
  return in_force ? in_force->content : "";
}

const GivenDetector* given_detector() {
  return in_force ? &*in_force : nullptr;
}

}  // namespace mirage
