// Detectors by their words, and which of what a detector is made of is code.
#pragma once

#include <string>

#include "base/plugins.h"

namespace mirage {

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
