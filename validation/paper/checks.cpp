#include "validation/paper/checks.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

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
  for (const Outcomes* outcomes : all) least = std::min(least, outcomes->vehicles);
  return least;
}

std::string evaluation(const std::string& rig, const std::string& run) {
  return "evaluations/" + rig + "-" + run;
}

Check check(const std::string& where, const std::vector<const Outcomes*>& used,
            std::vector<Comparison> comparisons, std::string sentence, std::string why) {
  Check check;
  check.rig = where;
  check.vehicles = fewest(used);
  int frames = std::numeric_limits<int>::max(), clusters = frames;
  for (const Outcomes* outcomes : used) {
    frames = std::min(frames, outcomes->frames());
    clusters = std::min(clusters, outcomes->clusters().count);
  }
  check.few = check.vehicles < kFewest || clusters < kFewestClusters;
  check.sentence = std::move(sentence);
  if (check.few)
    check.sentence += fmt::format("; too few to tell: {} vehicle{} in {} frame{}", check.vehicles,
                                  check.vehicles == 1 ? "" : "s", frames, frames == 1 ? "" : "s");
  check.why = std::move(why);
  check.comparisons = std::move(comparisons);
  return check;
}

Check about_images(Check check, const std::vector<const Outcomes*>& attacked) {
  for (const Outcomes* outcomes : attacked)
    if (const std::string note = outcomes->note(); !note.empty()) {
      check.verdict = Verdict::open;
      check.sentence = note;
      check.why.clear();
      check.comparisons.clear();
      break;
    }
  return check;
}

Comparison more(const std::string& what, const Outcomes& a, const Outcomes& b, const Which& which,
                Claim claim) {
  return comparison(what, success_difference(a, b, which), claim);
}

namespace {

Verdict verdict_of(const Check& check) {
  std::vector<Verdict> verdicts;
  for (const Comparison& c : check.comparisons) verdicts.push_back(c.verdict);
  if (check.few || verdicts.empty()) return Verdict::open;
  if (check.agree &&
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

/// Open, and that is an answer.
bool same(const Comparison& c) {
  return c.verdict == Verdict::open && told(c.difference) == Told::same;
}

std::string in_words(const Comparison& c) {
  return same(c) ? to_string(Told::same) : to_string(c.verdict);
}

void settle_check(Check& check) {
  check.verdict = verdict_of(check);
  if (check.comparisons.empty()) return;
  if (check.comparisons.size() > 1) {
    std::string list;
    for (const Comparison& c : check.comparisons)
      list += fmt::format("{}{}: {}", list.empty() ? "" : ", ", c.what, in_words(c));
    check.sentence += "; " + list;
  } else if (same(check.comparisons.front())) {
    check.sentence += "; " + to_string(Told::same);
  }
  for (const Comparison& c : check.comparisons)
    if (!check.few && c.verdict == Verdict::open && judge(c.claim, c.difference) != Verdict::open)
      check.sentence +=
          fmt::format("; {} would be told alone (p = {:.3f}), not among the {} questions of this run", c.what,
                      c.p, c.family);
  if (check.verdict != Verdict::open) return;
  std::optional<long> most;
  bool never = false, unsettled = false;
  for (const Comparison& c : check.comparisons) {
    if ((c.verdict != Verdict::open || same(c)) && !check.few) continue;
    unsettled = true;
    const auto needed = vehicles_needed(c, check.vehicles);
    never = never || !needed;
    if (needed) most = std::max(most.value_or(0), *needed);
  }
  if (!unsettled) return;  // the comparisons are told, and contradict each other, or are the same
  if (never) {
    check.sentence +=
        "; no number of vehicles can be given that would tell: the difference is too close to its bound, "
        "or its spread is not known";
    return;
  }
  check.vehicles_needed = check.few ? std::max<long>(*most, kFewest) : *most;
  check.sentence += fmt::format("; it would take about {} vehicles", with_thousands(*check.vehicles_needed));
}

}  // namespace

void settle(std::vector<Finding>& findings) {
  std::vector<Comparison*> family;
  for (Finding& finding : findings)
    for (Check& check : finding.checks)
      if (!check.few)
        for (Comparison& c : check.comparisons) family.push_back(&c);
  correct(family);
  for (Finding& finding : findings)
    for (Check& check : finding.checks) settle_check(check);
}

namespace {

/// Both meanings of hidden, and their words.
const std::array<std::pair<HidingRule, const char*>, 2> kMeanings = {
    {{kHidingRules[0], "vanished"}, {kHidingRules[2], "missed at IoU 0.7"}}};

/// The mesh's share and its control's.
std::string beside(const Cell& cell, const HidingRule& rule) {
  return fmt::format("{} learned, {} random of its size", percent(*hiding(*cell.learned, rule)),
                     percent(*hiding(*cell.sized, rule)));
}

}  // namespace

Cell cell_of(const Evidence& evidence, const std::string& evaluation) {
  return {evidence.learned(evaluation), evidence.sized(evaluation)};
}

Check by_both(const std::string& where, const std::vector<const Outcomes*>& used,
              const std::function<Interval(const HidingRule&)>& difference,
              const std::function<std::string(const HidingRule&)>& share) {
  std::vector<Comparison> comparisons;
  std::string sentence;
  for (const auto& [rule, word] : kMeanings) {
    comparisons.push_back(comparison(word, difference(rule)));
    sentence += fmt::format("{}{}: {}, {}", sentence.empty() ? "" : "; ", word, share(rule),
                            points(comparisons.back().difference));
  }
  return check(where, used, std::move(comparisons), std::move(sentence));
}

Check more_than_its_size(const std::string& where, const Cell& cell) {
  return by_both(
      where, {cell.learned, cell.sized},
      [&](const HidingRule& rule) { return hiding_difference(*cell.learned, *cell.sized, rule); },
      [&](const HidingRule& rule) { return beside(cell, rule); });
}

std::string net_points(const Cell& cell, const HidingRule& rule) {
  return points(hiding_difference(*cell.learned, *cell.sized, rule));
}

}  // namespace mirage::paper
