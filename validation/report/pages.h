// The precision–recall plot of `mirage detect`.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "attack/evaluate_run.h"
#include "detection/detect.h"

namespace mirage {

/// Writes the curves to OUT/precision_recall.json and draws OUT/precision_recall.{png,svg} with
/// validation/report/detection_plot.py (matplotlib). Returns the pictures' names; none, after one warning,
/// when Python or matplotlib is missing. `parts`: all, then the strata.
std::vector<std::string> plot_precision_recall(std::span<const ScoredStratum> parts, const std::string& title,
                                               const std::filesystem::path& out);

// The pictures of `mirage evaluate`: vehicles that the adversary hides, false detections that it causes, and
// its effect on the detector's image features.

/// For up to `count` hidden hosts OUT/hidden_HOST.png (the image of the camera that its label is in, clean
/// and attacked, with the detections), for up to `count` hosts with false positives
/// OUT/false_positives_HOST.png (bird's-eye view; the image for a detector that is judged there), and for all
/// of them, if the detector has image features, OUT/features_HOST.png (their magnitude in the image and in
/// the bird's-eye view: clean, attacked, difference). Hosts of different frames first; hidden ones by rising
/// overlap of the remaining detection, then falling clean score; the others by falling distance of the false
/// positive. The drawn data are in OUT/data. Draws with validation/report/evaluation_pictures.py
/// (matplotlib); returns the pictures' names; none, after one warning, when Python or matplotlib is missing
/// or there is nothing to show.
std::vector<std::string> draw_evaluation_pictures(const RunEvaluation& evaluation, int count,
                                                  const std::filesystem::path& out);

/// The hosts that are drawn, as indices into `hosts`.
struct PicturedHosts {
  std::vector<std::size_t> hidden, false_positives;
};
PicturedHosts pictured_hosts(const std::vector<HostOutcome>& hosts, int count);

}  // namespace mirage
