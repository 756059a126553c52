#include "validation/paper/finding.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "attack/upper_bound.h"

namespace mirage::paper {
namespace {

constexpr double kAlpha = 0.05;

/// The claim as "above the bound".
struct Above {
  Interval difference;
  double bound = 0;
};

Above as_above(Claim claim, const Interval& d) {
  if (claim == Claim::more) return {d, 0};
  if (claim == Claim::no_less) return {d, -kMargin};
  return {{-d.value, -d.high, -d.low}, -kMargin};
}

/// z with P(|N(0, 1)| > z) = p, never above it.
double two_sided_z(double p) {
  double low = 0, high = 40;
  for (int i = 0; i < 100; ++i) {
    const double middle = (low + high) / 2;
    (std::erfc(middle / std::sqrt(2)) > p ? low : high) = middle;
  }
  return low;
}

/// From the value to the end of the interval on the bound's side.
double reach(const Above& claim) {
  const Interval& d = claim.difference;
  return d.value > claim.bound ? d.value - d.low : d.high - d.value;
}

}  // namespace

std::string to_string(Verdict verdict) {
  return verdict == Verdict::holds ? "holds" : verdict == Verdict::fails ? "does not hold" : "cannot be told";
}

Verdict judge(Claim claim, const Interval& difference) {
  const auto [d, bound] = as_above(claim, difference);
  return d.low > bound ? Verdict::holds : d.high < bound ? Verdict::fails : Verdict::open;
}

Verdict all_of(const std::vector<Verdict>& verdicts) {
  const auto any = [&](Verdict verdict) {
    return std::find(verdicts.begin(), verdicts.end(), verdict) != verdicts.end();
  };
  return verdicts.empty() || (!any(Verdict::fails) && any(Verdict::open)) ? Verdict::open
         : any(Verdict::fails)                                            ? Verdict::fails
                                                                          : Verdict::holds;
}

double p_value(Claim claim, const Interval& difference) {
  const Above above = as_above(claim, difference);
  const double away = std::abs(above.difference.value - above.bound), end = reach(above);
  if (away == 0 || !std::isfinite(end)) return 1;
  if (end <= 0) return 0;
  return std::erfc(two_sided_z(kAlpha) * away / end / std::sqrt(2));
}

Comparison comparison(std::string what, const Interval& difference, Claim claim) {
  Comparison comparison;
  comparison.what = std::move(what);
  comparison.difference = difference;
  comparison.claim = claim;
  comparison.verdict = judge(claim, difference);
  comparison.p = comparison.p_family = p_value(claim, difference);
  return comparison;
}

void correct(const std::vector<Comparison*>& family) {
  std::vector<double> p;
  for (const Comparison* comparison : family) p.push_back(comparison->p);
  const std::vector<double> adjusted = holm(p);
  for (std::size_t i = 0; i < family.size(); ++i) {
    Comparison& comparison = *family[i];
    comparison.rank = 0;
    for (std::size_t k = 0; k < p.size(); ++k) comparison.rank += std::pair(p[k], k) < std::pair(p[i], i);
    comparison.family = static_cast<int>(p.size());
    comparison.p_family = adjusted[i];
    if (!(comparison.p_family < kAlpha)) comparison.verdict = Verdict::open;
  }
}

std::optional<long> vehicles_needed(const Comparison& comparison, int vehicles) {
  const Above above = as_above(comparison.claim, comparison.difference);
  const double away = std::abs(above.difference.value - above.bound),
               error = reach(above) / two_sided_z(kAlpha);
  if (!(away > 0) || !std::isfinite(error) || vehicles <= 0) return std::nullopt;
  constexpr double kPower = 0.8416;  // a normal variable exceeds −0.8416 with a chance of 80 %
  const double threshold = kAlpha / std::max(1, comparison.family - comparison.rank);
  return vehicles_to_tell(vehicles, (two_sided_z(threshold) + kPower) * error, away);
}

namespace {

using nlohmann::json;

json comparison_json(const Comparison& comparison) {
  return {{"what", comparison.what},
          {"difference", to_json(comparison.difference)},
          {"verdict", to_string(comparison.verdict)},
          {"p", comparison.p},
          {"p_family", comparison.p_family}};
}

json check_json(const Check& check) {
  json comparisons = json::array();
  for (const Comparison& comparison : check.comparisons) comparisons.push_back(comparison_json(comparison));
  return {{"rig", check.rig},
          {"verdict", to_string(check.verdict)},
          {"sentence", check.sentence},
          {"why", check.why},
          {"vehicles", check.vehicles},
          {"vehicles_needed", check.vehicles_needed ? json(*check.vehicles_needed) : json()},
          {"comparisons", comparisons}};
}

}  // namespace

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

Check check(const std::string& where, const std::vector<const Outcomes*>& used,
            std::vector<Comparison> comparisons, std::string sentence, std::string why) {
  Check check;
  check.rig = where;
  int frames = std::numeric_limits<int>::max(), clusters = frames;
  check.vehicles = frames;
  for (const Outcomes* outcomes : used) {
    check.vehicles = std::min(check.vehicles, outcomes->vehicles);
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

std::string overall(const Finding& finding) {
  const auto any = [&](Verdict verdict) {
    return std::any_of(finding.checks.begin(), finding.checks.end(),
                       [&](const Check& check) { return check.verdict == verdict; });
  };
  if (finding.checks.empty()) return "not measured";
  if (any(Verdict::holds) && any(Verdict::fails)) return "holds in part";
  return to_string(any(Verdict::holds)   ? Verdict::holds
                   : any(Verdict::fails) ? Verdict::fails
                                         : Verdict::open);
}

json to_json(const Finding& finding) {
  json checks = json::array();
  for (const Check& check : finding.checks) checks.push_back(check_json(check));
  return {
      {"name", finding.name}, {"claim", finding.claim}, {"verdict", overall(finding)}, {"checks", checks}};
}

}  // namespace mirage::paper
