// Detectors by their words, and which of what a detector is made of is code.
#pragma once

#include <string>

namespace mirage {

/// One of the fusion plugin's: lidar, camera, painted, fusion, late. Its weights are data
/// (plugins/data_archive.h).
bool is_own_detector(const std::string& word);

/// A detector that ships with the program; other names are paths of plugins: code.
inline bool is_shipped_detector(const std::string& word) {
  return is_own_detector(word) || word == "torchscript";
}

/// Whether the weights of such a detector may run code when they are loaded: TorchScript is a program, and
/// nobody knows what somebody else's plugin does with its.
inline bool weights_are_code(const std::string& detector) {
  return !is_own_detector(detector);
}

}  // namespace mirage
