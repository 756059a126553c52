// Detectors from shared libraries.
#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "detection/detector.h"

namespace mirage {

/// Opens the plugin of either version of the interface and makes an instance. `name`: empty for the plugin's
/// own; `weights`: empty for fresh ones. Errors as load_detector's.
std::unique_ptr<Detector> open_detector(const std::filesystem::path& file, const std::string& name,
                                        const std::string& options_json,
                                        const std::filesystem::path& weights);

}  // namespace mirage
