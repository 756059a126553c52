// Which findings of the paper hold in the numbers measured here: a claim is a statement about a difference of
// shares, and its verdict follows from where the 95 % interval of that difference lies (verdicts.h).
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "validation/paper/finding.h"

namespace mirage::paper {

/// The paper's findings, in its order, and those about kinds of fusion, on every rig whose evaluations are
/// there; the comparisons of either are corrected as one family.
std::vector<Finding> findings(const Evidence& evidence);

/// Over the finding's checks: "holds" or "does not hold" if those that can be told agree, "holds in part" if
/// they do not, "cannot be told", "not measured" without any.
std::string overall(const Finding& finding);

/// [{name, claim, verdict, checks: [{rig, verdict, sentence, why, vehicles, vehicles_needed, comparisons:
/// [{what, difference: {value, low, high}, verdict, p, p_family}]}]}]; vehicles_needed is null where it is
/// told.
nlohmann::json findings_json(const std::vector<Finding>& findings);

}  // namespace mirage::paper
