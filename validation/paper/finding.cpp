#include "validation/paper/finding.h"

#include <algorithm>

namespace mirage::paper {
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
