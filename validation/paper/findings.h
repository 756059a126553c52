// Which findings of the paper hold in the numbers measured here: a claim is a statement about a difference of
// shares, and its verdict follows from where the 95 % interval of that difference lies.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "validation/paper/tables.h"

namespace mirage::paper {

/// open: the interval lies on both sides, so these vehicles cannot tell.
enum class Verdict { holds, fails, open };
std::string to_string(Verdict verdict);

/// Differences below this share count as none where a claim is "no worse than" or "does not help".
inline constexpr double kMargin = 0.05;
/// A false positive is far from the host beyond this, m: about three lengths of a car, as the pictures of
/// mirage evaluate have it.
inline constexpr double kFar = 12;
/// Fewer vehicles or false positives than this, or fewer clusters, tell nothing whatever the interval says.
inline constexpr int kFewest = 10;
inline constexpr int kFewestClusters = 5;

/// difference > 0: holds with the whole interval above 0, fails with the whole interval below.
Verdict is_more(const Interval& difference);
/// difference ≥ 0 up to kMargin: holds with the whole interval above −kMargin, fails with all of it below 0.
Verdict is_no_less(const Interval& difference);
/// difference ≤ 0 up to kMargin: holds with the whole interval below kMargin, else fails with all above 0.
Verdict is_no_help(const Interval& reduction);
/// fails if one fails, else open if one is open.
Verdict all_of(const std::vector<Verdict>& verdicts);

struct Comparison {
  std::string what;
  Interval difference;
  Verdict verdict = Verdict::open;
};

/// A finding on one rig's data.
struct Check {
  std::string rig;
  Verdict verdict = Verdict::open;
  std::string sentence;  ///< the numbers, in words
  std::string why;       ///< other evidence that speaks to the cause; may be empty
  int vehicles = 0;
  std::vector<Comparison> comparisons;
};

struct Finding {
  std::string name, claim;
  std::vector<Check> checks;  ///< empty: nothing was measured that could tell
};

/// The paper's findings, in its order, on every rig whose evaluations are there.
std::vector<Finding> findings(const Evidence& evidence);

/// Over the finding's checks: "holds" or "does not hold" if those that can be told agree, "holds in part" if
/// they do not, "cannot be told", "not measured" without any.
std::string overall(const Finding& finding);

/// [{name, claim, verdict, checks: [{rig, verdict, sentence, why, vehicles, comparisons: [{what, difference:
/// {value, low, high}, verdict}]}]}]
nlohmann::json findings_json(const std::vector<Finding>& findings);

}  // namespace mirage::paper
