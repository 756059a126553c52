// The points of the speed–accuracy study, which of them lie on a front, and the rule that recommends
// settings.
#pragma once

#include <functional>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "simulation/insertion.h"

namespace mirage {

/// One setting, measured on a host or over all of them.
struct TradeoffPoint {
  std::string group, axis, label;
  nlohmann::json settings = {};                    ///< what the group varies, in words for files
  std::optional<SimulationSettings> drawing = {};  ///< of a camera point: how it drew
  double ms = 0;                                   ///< cost on a host; over several: ratio · baseline_ms
  double baseline_ms = 0;                          ///< of the group's baseline, timed beside it
  double ratio = 1;                                ///< own / baseline, the median over repeats
  std::map<std::string, double> errors = {};
  std::vector<std::string> front = {};  ///< errors on whose front the point lies

  /// Image error of a camera point, in 8-bit levels.
  double image_error() const { return errors.at("image_levels"); }
  /// Cosine of its gradient with finite differences.
  double gradient_cosine() const { return errors.at("gradient_cosine"); }
};

/// Times own() beside baseline() for the point, in alternation: CPU time of this thread, medians over
/// repeats. It stops at two repeats if own() takes longer than `long_ms`, because long times vary little.
void time_beside(TradeoffPoint& point, int repeats, const std::function<void()>& baseline,
                 const std::function<void()>& own, double long_ms = std::numeric_limits<double>::infinity());

/// One setting on several hosts, at least one: means of the errors and of the baseline's time, the geometric
/// mean of the ratios.
TradeoffPoint mean_over(const std::vector<TradeoffPoint>& hosts);

/// A point of (ms, error) is on the front of its group if no other is as good in both and better in one.
/// Points without that error do not count.
void mark_front(std::vector<TradeoffPoint>& points, const std::string& group, const std::string& error);

nlohmann::json to_json(const TradeoffPoint& point);

/// The settings for --quality NAME by the measured points.
struct Recommendation {
  std::string name, rule;
  const TradeoffPoint* point = nullptr;    ///< null where no point satisfies the rule
  const TradeoffPoint* shipped = nullptr;  ///< --quality NAME as shipped today; null if that is not asked for
};

/// The rule, over the camera's points that an attack could use (axis "grid"; `standard` is today's default):
///   draft    image error at most kDraftImageErrorRatio times the default's, the gradient's cosine at most
///            kDraftGradientError below the default's, ms within kEqualTimeRatio of the least of these: the
///            best such cosine with finite differences;
///   default  today's settings, whatever was measured;
///   exact    at most kExactTimeRatio times the default's ms, image error at most kExactImage times the least
///            of these: the best such cosine.
inline constexpr double kDraftImageErrorRatio = 1.5, kDraftGradientError = 0.05, kEqualTimeRatio = 1.15,
                        kExactTimeRatio = 4, kExactImage = 1.25;
std::vector<Recommendation> recommend(const std::vector<TradeoffPoint>& points,
                                      const TradeoffPoint& standard);

}  // namespace mirage
