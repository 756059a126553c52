// The precision of a detector's convolutions (--precision).
#pragma once

#include <string>
#include <vector>

#include "base/plugins.h"

namespace mirage {

/// Convolutions in single precision.
inline constexpr const char* kFloat = "float";
/// Convolutions in bfloat16; in float where multiplies_bfloat16() says no.
inline constexpr const char* kBfloat16 = "bfloat16";
/// The whole network in double: a reference for the others, many times slower.
inline constexpr const char* kDouble = "double";

/// Whether this processor multiplies bfloat16 (AVX-512 BF16, which AMX comes on top of).
bool multiplies_bfloat16();

/// FieldError for a word that is no precision.
void check_precision(const std::string& word);

/// `precision`, or "float" if the processor has no instructions for bfloat16: emulated ones are slower than
/// float. Then warns, once. Errors as check_precision's.
std::string usable_precision(const std::string& precision, bool has_bfloat16 = multiplies_bfloat16());

// The words of DetectorOptions::defense, joined by '+':
//
//     none                       nothing
//     WORD                       weights that were trained to resist, DETECTOR-RIG-WORD.weights; one at most
//     jpeg:QUALITY               the picture is compressed before the detector sees it (defenses.h)
//     consistency                cross-checked with single-sensor detectors (consistent_detector.h)
//     ceiling:HEIGHT             everything higher over the road is ignored (defenses.h)
//     ceiling                    the same with weights that were trained under it
//     shadows                    cross-checked with bodies and rays of the sweep (defenses.h)
//     adversarial+shadows        both: wrappers are nested in the order of the words, the first one
//                                innermost

inline constexpr const char* kConsistency = "consistency";
/// The word of the defence that looks for bodies and rays.
inline constexpr const char* kShadows = "shadows";
/// The word of weights that were trained under kTrainedCeiling, which goes with them. Most roofs lie above
/// it.
inline constexpr const char* kCeiling = "ceiling";
/// The ceiling that those weights were trained under (m over the road).
inline constexpr const char* kTrainedCeiling = "ceiling:1.4";

/// Words and forms of the defences that need no training, for messages.
std::vector<std::string> untrained_defenses();

/// JPEG's quality in "jpeg:QUALITY"; 0 for another word. FieldError for an invalid quality.
int jpeg_quality(const std::string& word);

/// Metres over the road in "ceiling:HEIGHT"; 0 for another word. FieldError for an invalid height.
double ceiling_height(const std::string& word);

/// A defence taken apart.
struct Defense {
  std::string weights;              ///< the word of shipped weights; empty: the plain ones
  std::vector<std::string> around;  ///< the detector's wrappers, innermost first

  /// Whether the named wrapper is around the detector.
  bool has(const std::string& word) const;
};

/// Parses DetectorOptions::defense (empty is none). FieldError for an empty word, two words of weights, a
/// repeated word, "none" beside others, or letters that no word has.
Defense read_defense(const std::string& text);

// Detectors by their words, and which of their files are code.

/// The kind of detector plugins (base/plugins.h).
inline constexpr const char* kDetectorPlugins = "detector";

/// A detector that ships with the program; other names are paths of plugins: code.
inline bool is_shipped_detector(const std::string& word) {
  return shipped_plugin(kDetectorPlugins, word) != nullptr;
}

/// Whether the detector's weights may run code when they are loaded: TorchScript is a program, ONNX files are
/// read by a library that Mirage does not guard, and another author's plugin may do anything.
inline bool weights_are_code(const std::string& detector) {
  const ShippedPlugin* plugin = shipped_plugin(kDetectorPlugins, detector);
  return plugin == nullptr || plugin->weights_are_code;
}

/// Whether it is a shipped detector without learned weights: it needs no weights file.
inline bool needs_no_weights(const std::string& detector) {
  const ShippedPlugin* plugin = shipped_plugin(kDetectorPlugins, detector);
  return plugin != nullptr && !plugin->needs_weights;
}

}  // namespace mirage
