#include "validation/tradeoff/points.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "base/intervals.h"
#include "validation/thread_clock.h"

namespace mirage {

void time_beside(TradeoffPoint& point, int repeats, const std::function<void()>& baseline,
                 const std::function<void()>& own, double long_ms) {
  std::vector<double> baseline_ms, own_ms, ratios;
  for (int repeat = 0; repeat < repeats; ++repeat) {
    baseline_ms.push_back(cpu_ms(baseline));
    own_ms.push_back(cpu_ms(own));
    ratios.push_back(own_ms.back() / baseline_ms.back());
    if (own_ms.back() > long_ms && repeat > 0) break;
  }
  point.ms = median_interval(own_ms).value, point.baseline_ms = median_interval(baseline_ms).value;
  point.ratio = median_interval(ratios).value;
}

TradeoffPoint mean_over(const std::vector<TradeoffPoint>& hosts) {
  TradeoffPoint mean = hosts.front();
  const auto n = static_cast<double>(hosts.size());
  double log_ratio = 0;
  mean.baseline_ms = 0;
  for (auto& [name, value] : mean.errors) value = 0;
  for (const TradeoffPoint& host : hosts) {
    for (const auto& [name, value] : host.errors) mean.errors[name] += value;
    log_ratio += std::log(std::max(host.ratio, 1e-9));
    mean.baseline_ms += host.baseline_ms;
  }
  for (auto& [name, value] : mean.errors) value /= n;
  mean.ratio = std::exp(log_ratio / n);
  mean.baseline_ms /= n;
  mean.ms = mean.ratio * mean.baseline_ms;
  return mean;
}

void mark_front(std::vector<TradeoffPoint>& points, const std::string& group, const std::string& error) {
  std::vector<TradeoffPoint*> members;
  for (TradeoffPoint& point : points)
    if (point.group == group && point.errors.count(error)) members.push_back(&point);
  for (TradeoffPoint* point : members) {
    const double own = point->errors.at(error);
    const bool beaten = std::any_of(members.begin(), members.end(), [&](const TradeoffPoint* other) {
      const double theirs = other->errors.at(error);
      return other->ms <= point->ms && theirs <= own && (other->ms < point->ms || theirs < own);
    });
    if (!beaten) point->front.push_back(error);
  }
}

nlohmann::json to_json(const TradeoffPoint& point) {
  return {{"group", point.group},       {"axis", point.axis},     {"label", point.label},
          {"settings", point.settings}, {"ms", point.ms},         {"baseline_ms", point.baseline_ms},
          {"ratio", point.ratio},       {"errors", point.errors}, {"front", point.front}};
}

std::vector<Recommendation> recommend(const std::vector<TradeoffPoint>& points,
                                      const TradeoffPoint& standard) {
  std::vector<const TradeoffPoint*> usable, affordable;
  for (const TradeoffPoint& point : points) {
    if (point.group != "camera" || point.axis != "grid") continue;
    usable.push_back(&point);
    if (point.ms <= kExactTimeRatio * standard.ms) affordable.push_back(&point);
  }
  const auto image = [](const TradeoffPoint* p) { return p->image_error(); };
  const auto cosine = [](const TradeoffPoint* p) { return p->gradient_cosine(); };

  std::vector<const TradeoffPoint*> rough;
  double shortest = std::numeric_limits<double>::infinity();
  for (const TradeoffPoint* point : usable)
    if (image(point) <= kDraftImageErrorRatio * image(&standard) &&
        cosine(point) >= cosine(&standard) - kDraftGradientError) {
      rough.push_back(point);
      shortest = std::min(shortest, point->ms);
    }
  const TradeoffPoint* draft = nullptr;
  for (const TradeoffPoint* point : rough)
    if (point->ms <= kEqualTimeRatio * shortest && (!draft || cosine(point) > cosine(draft))) draft = point;

  double least = std::numeric_limits<double>::infinity();
  for (const TradeoffPoint* point : affordable) least = std::min(least, image(point));
  const TradeoffPoint* exact = nullptr;
  for (const TradeoffPoint* point : affordable)
    if (image(point) <= kExactImage * least && (!exact || cosine(point) > cosine(exact))) exact = point;

  return {{"draft",
           fmt::format("best gradient cosine within {} times the least time, with an image error of at most "
                       "{} times the default's and a cosine at most {} below the default's",
                       kEqualTimeRatio, kDraftImageErrorRatio, kDraftGradientError),
           draft},
          {"default", "the program's standing settings", &standard},
          {"exact",
           fmt::format("best gradient cosine within {} times the default's time and {} times the least image "
                       "error to be had in it",
                       kExactTimeRatio, kExactImage),
           exact}};
}

}  // namespace mirage
