// The words of DetectorOptions::defense that are no weights.
#pragma once

#include <string>

namespace mirage {

/// Held against what each sensor says alone (detection/consistent_detector.h).
inline constexpr const char* kConsistency = "consistency";
/// Held against bodies and rays of the sweep (detection/shadow_detector.h).
inline constexpr const char* kShadows = "shadows";

/// JPEG's quality in "jpeg:QUALITY"; 0 for another defence. FieldError for a quality that is none.
int jpeg_quality(const std::string& defense);

}  // namespace mirage
