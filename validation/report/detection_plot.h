// The precision–recall plot of `mirage detect`.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "detection/detect.h"

namespace mirage {

/// Writes the curves to OUT/precision_recall.json and draws OUT/precision_recall.{png,svg} with
/// validation/report/detection_plot.py (matplotlib). Returns the pictures' names; none, after one warning,
/// when Python or matplotlib is missing. `parts`: all, then the strata.
std::vector<std::string> plot_precision_recall(std::span<const ScoredStratum> parts, const std::string& title,
                                               const std::filesystem::path& out);

}  // namespace mirage
