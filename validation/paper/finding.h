// A finding, and the checks of it (findings.h has the list).
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "validation/paper/evidence.h"
#include "validation/paper/verdicts.h"

namespace mirage::paper {

/// A false positive is far from the host beyond this, m: about three lengths of a car, as the pictures of
/// mirage evaluate have it.
inline constexpr double kFar = 12;
/// Fewer vehicles or false positives than this, or fewer clusters, tell nothing whatever the interval says.
inline constexpr int kFewest = 10;
inline constexpr int kFewestClusters = 5;

/// A finding on one rig's data.
struct Check {
  std::string rig;
  Verdict verdict = Verdict::open;
  std::string sentence;  ///< the numbers, in words
  std::string why;       ///< other evidence that speaks to the cause; may be empty
  int vehicles = 0;
  std::vector<Comparison> comparisons;
  bool few = false;    ///< too few vehicles or clusters: open, and no part of the family
  bool agree = false;  ///< its comparisons are the same question asked twice: open unless they agree
  /// What it would take to tell, where it is open and a number follows.
  std::optional<long> vehicles_needed = {};
};

struct Finding {
  std::string name, claim;
  std::vector<Check> checks;  ///< empty: nothing was measured that could tell
};

/// Over the finding's checks: "holds" or "does not hold" if those that can be told agree, "holds in part" if
/// they do not, "cannot be told", "not measured" without any.
std::string overall(const Finding& finding);

/// {name, claim, verdict, checks: [{rig, verdict, sentence, why, vehicles, vehicles_needed, comparisons:
/// [{what, difference: {value, low, high}, verdict, p, p_family}]}]}; vehicles_needed is null where it is
/// told.
nlohmann::json to_json(const Finding& finding);

}  // namespace mirage::paper
