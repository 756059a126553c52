// The rule by which a claim about a difference of shares holds. Every claim says "the difference lies above a
// bound". One rule decides all, so that claims about one difference agree with each other:
//     holds            the whole 95 % interval lies above the bound
//     does not hold    all of it lies below
//     cannot be told   the bound lies within
// more: bound 0. no_less ("at least as much", non-inferiority; Schuirmann, 1987): bound −kMargin, so that a
// loss smaller than the margin counts as no less. no_help: the mirror of no_less, "a defence takes off less
// than kMargin". So `more` implies `no_less`, and a gain smaller than the margin is both `more` and
// `no_help`. Both are reported.
//
// A run asks some thirty of these questions; one or two would be decided by chance. Their p-values are
// corrected together (Holm, Scandinavian Journal of Statistics 6, 1979), the paper's findings as one family,
// those about our own defences, parts of the object and kinds of fusion as three others: a claim that is not
// decided after that is left open. p comes from the interval: the tail of Student's t over its clusters that
// puts the interval's end where it is. A normal tail would be too short: with five clusters one family in
// three would then decide a claim where there is no effect.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "base/intervals.h"
#include "validation/paper/results.h"

namespace mirage::paper {

/// open: cannot be told.
enum class Verdict { holds, fails, open };
std::string to_string(Verdict verdict);

/// Differences below this share count as none where a claim is "no less than" or "of no help".
inline constexpr double kMargin = kSameWithin;

/// The claim about a difference; no_help: about the share that a defence takes off.
enum class Claim { more, no_less, no_help };

/// The rule above, on one interval alone.
Verdict judge(Claim claim, const Interval& difference);
/// fails if one fails, else open if one is open.
Verdict all_of(const std::vector<Verdict>& verdicts);

/// Two-sided p of the claim's bound: below 0.05 exactly where judge() decides. 1 for an interval without end.
/// `clusters`: of the difference.
double p_value(Claim claim, const Interval& difference, int clusters = kManyClusters);

/// One question of a finding.
struct Comparison {
  std::string what;
  Difference difference = {};
  Claim claim = Claim::more;
  Verdict verdict = Verdict::open;  ///< alone, and after correct() in its family
  double p = 1, p_family = 1;       ///< alone; adjusted for the family
  int rank = 0, family = 1;         ///< place by p among `family` questions, the smallest first
};
/// A comparison with its own verdict, before any correction.
Comparison comparison(std::string what, const Difference& difference, Claim claim = Claim::more);

/// Holm's correction over a family: p_family, and open verdicts where it is not below 0.05.
void correct(const std::vector<Comparison*>& family);

/// The vehicles needed to decide a comparison that `vehicles` left open, if the difference stays what it is
/// and intervals narrow with the root of the vehicles: with a chance of 80 %, against the family's threshold
/// at its rank, by Student's t over its clusters. Rounded up to two digits. Empty if the difference lies on
/// the bound or a million is too few.
std::optional<long> vehicles_needed(const Comparison& comparison, int vehicles);

// A finding and its checks (findings.toml has the list).

/// Fewer vehicles or false positives than this, or fewer clusters, tell nothing whatever the interval says.
inline constexpr int kMinCount = 10;
inline constexpr int kMinClusters = 5;

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
  /// The vehicles needed to decide, if the check is open and a number follows.
  std::optional<long> vehicles_needed = {};
};

struct Finding {
  std::string name, claim;
  std::vector<Check> checks;  ///< empty: no measurement could decide it
};

// Numbers as words for sentences and tables.

/// "KITTI rig"
std::string title(const std::string& rig);
/// "+3.1 points (−1.0 to +7.2)"
std::string points(const Interval& difference);
/// "31.9 % (24.1–40.0)"
std::string percent(const Interval& share);

/// A check with its comparisons of the evaluations `used`; too few vehicles leave it open.
Check check(const std::string& where, const std::vector<const Outcomes*>& used,
            std::vector<Comparison> comparisons, std::string sentence, std::string why = "");

/// All of findings.toml, on every rig whose evaluations are there, settled by families.
std::vector<Finding> findings(const Evidence& evidence);

/// Over the finding's checks: "holds" or "does not hold" if the decided checks agree, "holds in part" if they
/// do not, "cannot be told", "not measured" without any.
std::string overall(const Finding& finding);

/// {name, claim, verdict, checks: [{rig, verdict, sentence, why, vehicles, vehicles_needed, comparisons:
/// [{what, difference: {value, low, high}, verdict, p, p_family}]}]}; vehicles_needed is null for a decided
/// check.
nlohmann::json to_json(const Finding& finding);

}  // namespace mirage::paper
