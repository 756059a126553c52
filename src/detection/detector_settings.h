// What a detector's convolutions are computed in (--precision).
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

/// `precision`, or "float" where the processor has no instructions for bfloat16: elsewhere they are emulated,
/// slower than float. Says so, once. Errors as check_precision's.
std::string usable_precision(const std::string& precision, bool has_bfloat16 = multiplies_bfloat16());

// The words of DetectorOptions::defense: what a detector is defended by, joined by '+'.
//
//     none                       nothing
//     WORD                       weights that were trained to resist, DETECTOR-RIG-WORD.weights; one at most
//     jpeg:QUALITY               the picture is compressed before the detector sees it (defenses.h)
//     consistency                held against what each sensor says alone (consistent_detector.h)
//     ceiling:HEIGHT             nothing that stands higher over the road is looked at (defenses.h)
//     ceiling                    the same with weights that were trained under it
//     shadows                    held against bodies and rays of the sweep (defenses.h)
//     adversarial+shadows        both: what stands around the detector does so in the order given, the first
//                                next to it

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

/// JPEG's quality in "jpeg:QUALITY"; 0 for another word. FieldError for a quality that is none.
int jpeg_quality(const std::string& word);

/// Metres over the road in "ceiling:HEIGHT"; 0 for another word. FieldError for a height that is none.
double ceiling_height(const std::string& word);

/// A defence taken apart.
struct Defense {
  std::string weights;              ///< the word of shipped weights; empty: the plain ones
  std::vector<std::string> around;  ///< the detector's wrappers, innermost first

  /// Whether the named wrapper is around the detector.
  bool has(const std::string& word) const;
};

/// Of DetectorOptions::defense (empty is none). FieldError for an empty word, two that are weights, one given
/// twice, "none" beside others, or letters that no word has.
Defense read_defense(const std::string& text);

// Detectors by their words, and which of what a detector is made of is code.

/// The kind of detector plugins (base/plugins.h).
inline constexpr const char* kDetectorPlugins = "detector";

/// A detector that ships with the program; other names are paths of plugins: code.
inline bool is_shipped_detector(const std::string& word) {
  return shipped_plugin(kDetectorPlugins, word) != nullptr;
}

/// Whether the weights of such a detector may run code when they are loaded: TorchScript is a program, ONNX
/// files are read by a library that Mirage does not guard, and nobody knows what somebody else's plugin does.
inline bool weights_are_code(const std::string& detector) {
  const ShippedPlugin* plugin = shipped_plugin(kDetectorPlugins, detector);
  return plugin == nullptr || plugin->weights_are_code;
}

/// Whether it is a detector that ships and learned nothing: it needs no weights file.
inline bool needs_no_weights(const std::string& detector) {
  const ShippedPlugin* plugin = shipped_plugin(kDetectorPlugins, detector);
  return plugin != nullptr && !plugin->needs_weights;
}

}  // namespace mirage
