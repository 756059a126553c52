#include "validation/report/detection_plot.h"

#include "base/child_process.h"
#include "base/files.h"
#include "base/logging.h"

namespace mirage {
namespace {

/// One point a hit: between hits the recall stays.
nlohmann::json curve_json(const PrecisionRecall& result) {
  nlohmann::json recall = nlohmann::json::array(), precision = nlohmann::json::array();
  double last = 0;
  for (const auto& [r, p] : result.curve) {
    if (r <= last) continue;
    recall.push_back(last = r);
    precision.push_back(p);
  }
  return {{"ap", result.average_precision},
          {"vehicles", result.boxes},
          {"recall", recall},
          {"precision", precision}};
}

}  // namespace

std::vector<std::string> plot_precision_recall(std::span<const ScoredStratum> parts, const std::string& title,
                                               const std::filesystem::path& out) {
  nlohmann::json curves = nlohmann::json::array();
  for (const ScoredStratum& part : parts)
    curves.push_back(
        {{"name", part.stratum.name}, {"iou50", curve_json(part.at50)}, {"iou70", curve_json(part.at70)}});
  write_json(out / "precision_recall.json", {{"title", title}, {"curves", curves}});
  const std::string python = plotting_python().string();
  if (python.empty() || run_program({python, shipped_file("validation/report/detection_plot.py").string(),
                                     out.string()}) != 0) {
    spdlog::warn("no precision-recall plot: install python3-matplotlib (the curves are in {})",
                 (out / "precision_recall.json").string());
    return {};
  }
  return {"precision_recall.png", "precision_recall.svg"};
}

}  // namespace mirage
