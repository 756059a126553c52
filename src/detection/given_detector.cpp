#include "detection/given_detector.h"

#include <optional>

#include "base/error.h"

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

const GivenDetector* given_detector() {
  return in_force ? &*in_force : nullptr;
}

}  // namespace mirage
