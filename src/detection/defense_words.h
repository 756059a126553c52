// The words of DetectorOptions::defense: what a detector is defended by, joined by '+'.
//
//     none                       nothing
//     WORD                       weights that were trained to resist, DETECTOR-RIG-WORD.weights; one at most
//     jpeg:QUALITY               the picture is compressed before the detector sees it (jpeg_detector.h)
//     consistency                held against what each sensor says alone (consistent_detector.h)
//     ceiling:HEIGHT             nothing that stands higher over the road is looked at (ceiling_detector.h)
//     ceiling                    the same with weights that were trained under it
//     shadows                    held against bodies and rays of the sweep (shadow_detector.h)
//     adversarial+shadows        both: what stands around the detector does so in the order given, the first
//                                next to it
#pragma once

#include <string>
#include <vector>

namespace mirage {

inline constexpr const char* kConsistency = "consistency";
inline constexpr const char* kShadows = "shadows";
/// The word of weights that were trained under kTrainedCeiling, which goes with them. Most roofs lie above
/// it.
inline constexpr const char* kCeiling = "ceiling";
inline constexpr const char* kTrainedCeiling = "ceiling:1.4";

/// Words and forms of the defences that need no training, for messages.
std::vector<std::string> untrained_defenses();

/// JPEG's quality in "jpeg:QUALITY"; 0 for another word. FieldError for a quality that is none.
int jpeg_quality(const std::string& word);

/// Metres over the road in "ceiling:HEIGHT"; 0 for another word. FieldError for a height that is none.
double ceiling_height(const std::string& word);

/// A defence taken apart.
struct Defense {
  std::string weights;              ///< the word of shipped weights; empty: the plain ones
  std::vector<std::string> around;  ///< what stands around the detector, the inner first

  bool has(const std::string& word) const;
};

/// Of DetectorOptions::defense (empty is none). FieldError for an empty word, two that are weights, one given
/// twice, "none" beside others, or letters that no word has.
Defense read_defense(const std::string& text);
/// The same, for its errors alone.
void check_defense(const std::string& text);

}  // namespace mirage
