#include "validation/paper/finding.h"

#include <algorithm>
#include <cmath>
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

/// z with P(|N(0, 1)| > z) = p.
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
  std::vector<Comparison*> sorted = family;
  std::stable_sort(sorted.begin(), sorted.end(),
                   [](const Comparison* a, const Comparison* b) { return a->p < b->p; });
  double largest = 0;
  for (std::size_t i = 0; i < sorted.size(); ++i) {
    Comparison& comparison = *sorted[i];
    comparison.rank = static_cast<int>(i);
    comparison.family = static_cast<int>(sorted.size());
    largest = std::max(largest, std::min(1.0, static_cast<double>(sorted.size() - i) * comparison.p));
    comparison.p_family = largest;
    if (!(largest < kAlpha)) comparison.verdict = Verdict::open;
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
