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
  int frames = std::numeric_limits<int>::max(), clusters = frames;
  for (const Outcomes* one : used) {
    frames = std::min(frames, one->frames());
    clusters = std::min(clusters, one->clusters());
  }
  made.few = made.vehicles < kFewest || clusters < kFewestClusters;
  made.sentence = std::move(sentence);
  if (made.few)
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

Comparison more(const std::string& what, const Outcomes& a, const Outcomes& b, const Which& which,
                Claim claim) {
  return comparison(what, success_difference(a, b, which), claim);
}

namespace {

Verdict verdict_of(const Check& one) {
  std::vector<Verdict> verdicts;
  for (const Comparison& c : one.comparisons) verdicts.push_back(c.verdict);
  if (one.few || verdicts.empty()) return Verdict::open;
  if (one.agree &&
      std::any_of(verdicts.begin(), verdicts.end(), [&](Verdict other) { return other != verdicts.front(); }))
    return Verdict::open;
  return all_of(verdicts);
}

std::string with_thousands(long number) {
  std::string text = std::to_string(number);
  for (int at = static_cast<int>(text.size()) - 3; at > 0; at -= 3)
    text = fmt::format("{} {}", text.substr(0, static_cast<std::size_t>(at)),
                       text.substr(static_cast<std::size_t>(at)));
  return text;
}

void settle_check(Check& one) {
  one.verdict = verdict_of(one);
  if (one.comparisons.empty()) return;
  if (one.comparisons.size() > 1) {
    std::string list;
    for (const Comparison& c : one.comparisons)
      list += fmt::format("{}{}: {}", list.empty() ? "" : ", ", c.what, to_string(c.verdict));
    one.sentence += "; " + list;
  }
  for (const Comparison& c : one.comparisons)
    if (!one.few && c.verdict == Verdict::open && judge(c.claim, c.difference) != Verdict::open)
      one.sentence +=
          fmt::format("; {} would be told alone (p = {:.3f}), not among the {} questions of this run", c.what,
                      c.p, c.family);
  if (one.verdict != Verdict::open) return;
  std::optional<long> most;
  bool never = false, unsettled = false;
  for (const Comparison& c : one.comparisons) {
    if (c.verdict != Verdict::open && !one.few) continue;
    unsettled = true;
    const auto needed = vehicles_needed(c, one.vehicles);
    never = never || !needed;
    if (needed) most = std::max(most.value_or(0), *needed);
  }
  if (!unsettled) return;  // the comparisons are told, and contradict each other
  if (never) {
    one.sentence +=
        "; no number of vehicles can be given that would tell: the difference is too close to its bound, "
        "or its spread is not known";
    return;
  }
  one.vehicles_needed = one.few ? std::max<long>(*most, kFewest) : *most;
  one.sentence += fmt::format("; it would take about {} vehicles", with_thousands(*one.vehicles_needed));
}

}  // namespace

void settle(std::vector<Finding>& findings) {
  std::vector<Comparison*> family;
  for (Finding& finding : findings)
    for (Check& one : finding.checks)
      if (!one.few)
        for (Comparison& c : one.comparisons) family.push_back(&c);
  correct(family);
  for (Finding& finding : findings)
    for (Check& one : finding.checks) settle_check(one);
}

}  // namespace mirage::paper
