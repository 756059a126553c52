// What a speed–accuracy study measured.
#pragma once

#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "validation/reference/reference_renderer.h"
#include "validation/tradeoff/points.h"
#include "validation/tradeoff/sensor_studies.h"
#include "validation/tradeoff/studies.h"

namespace mirage {

/// What the camera's references are worth; means over hosts.
struct CameraReference {
  double self_cosine = 0;   ///< CameraStudy::self_cosine
  Agreement sharp;          ///< CameraStudy::sharp_agreement
  std::vector<int> pixels;  ///< of each host's object
};

struct TradeoffResult {
  TradeoffSettings settings;          ///< `source`: what was measured on
  std::vector<HostId> hosts;          ///< by distance
  std::size_t frames = 0;             ///< that they stand in
  std::vector<TradeoffPoint> points;  ///< of all groups, their fronts marked
  CameraReference reference;
  std::string depth_reference;  ///< of depth completion, in words; empty where it was not scored
  std::vector<TimedAttack> attacks;
  /// Names of the pictures in `out`: none without matplotlib, no list before they are drawn.
  std::optional<std::vector<std::string>> plots;
  std::filesystem::path page;  ///< empty if there is none

  /// By the camera's points, what is shipped beside each; none without the grid. They point into `points`.
  std::vector<Recommendation> recommended() const;
};

/// {settings, ratio, ms, errors, on_front: of the point, if there is one; name, rule, shipped: the same of
/// it}
nlohmann::json to_json(const Recommendation& advice);
/// {frames, vehicles, hosts, pixels, seed, repeats, data, depth, rooftop, reference, baseline, points,
/// recommended, attack, plots?, page?}
nlohmann::json to_json(const TradeoffResult& result);

// The speed–accuracy study: every setting that trades the one for the other, measured on the same hosts in
// the same run, with the fronts and the settings that follow from them (`mirage tradeoff`).

/// Runs it, writes OUT/tradeoff.json (to_json of the result without its plots and page), and with matplotlib
/// OUT/tradeoff.{png,svg} and tradeoff.html. InputError for numbers out of range, and if no vehicle can be
/// used. `start`: of settings.cycles.
TradeoffResult tradeoff(const TradeoffSettings& settings, const StartReference& start = {});

}  // namespace mirage
