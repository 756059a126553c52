#include "validation/paper/checks.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace mirage::paper {

std::string title(const std::string& rig) {
  return rig == "kitti64" ? "KITTI rig" : rig == "xenith" ? "Xenith rig" : "real KITTI frames";
}

std::string points(const Interval& difference) {
  std::string text =
      std::isfinite(difference.low)
          ? fmt::format("{:+.1f} points ({:+.1f} to {:+.1f})", 100 * difference.value, 100 * difference.low,
                        100 * difference.high)
          : fmt::format("{:+.1f} points (too few to draw an interval from)", 100 * difference.value);
  for (std::size_t at; (at = text.find('-')) != std::string::npos;) text.replace(at, 1, "−");
  return text;
}

std::string percent(const Interval& share) {
  return fmt::format("{:.1f} % ({:.1f}–{:.1f})", 100 * share.value, 100 * share.low, 100 * share.high);
}

std::string asr(const Outcomes& outcomes, const Which& which) {
  return percent(success(outcomes, which));
}

int fewest(const std::vector<const Outcomes*>& all) {
  int least = std::numeric_limits<int>::max();
  for (const Outcomes* one : all) least = std::min(least, one->vehicles);
  return least;
}

std::string evaluation(const std::string& rig, const std::string& run) {
  return "evaluations/" + rig + "-" + run;
}

Check check(const std::string& where, const std::vector<const Outcomes*>& used,
            std::vector<Comparison> comparisons, std::string sentence, std::string why) {
  Check made;
  made.rig = where;
  made.vehicles = fewest(used);
  std::vector<Verdict> verdicts;
  for (const Comparison& one : comparisons) verdicts.push_back(one.verdict);
  int frames = std::numeric_limits<int>::max(), clusters = frames;
  for (const Outcomes* one : used) {
    frames = std::min(frames, one->frames());
    clusters = std::min(clusters, one->clusters());
  }
  const bool few = made.vehicles < kFewest || clusters < kFewestClusters;
  made.verdict = few ? Verdict::open : all_of(verdicts);
  made.sentence = std::move(sentence);
  if (few)
    made.sentence += fmt::format("; too few to tell: {} vehicle{} in {} frame{}", made.vehicles,
                                 made.vehicles == 1 ? "" : "s", frames, frames == 1 ? "" : "s");
  made.why = std::move(why);
  made.comparisons = std::move(comparisons);
  return made;
}

Check about_images(Check made, const std::vector<const Outcomes*>& attacked) {
  for (const Outcomes* one : attacked)
    if (const std::string note = one->note(); !note.empty()) {
      made.verdict = Verdict::open;
      made.sentence = note;
      made.why.clear();
      made.comparisons.clear();
      break;
    }
  return made;
}

Comparison more(const std::string& what, const Outcomes& a, const Outcomes& b, const Which& which) {
  const Interval difference = success_difference(a, b, which);
  return {what, difference, is_more(difference)};
}

}  // namespace mirage::paper
