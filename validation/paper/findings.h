// Which findings of the paper hold in the numbers measured here: a claim is a statement about a difference of
// shares, and its verdict follows from where the 95 % interval of that difference lies (finding.h).
#pragma once

#include <vector>

#include "validation/paper/finding.h"

namespace mirage::paper {

/// The paper's findings, in its order, and those about defences of our own, parts of the object and kinds of
/// fusion, on every rig whose evaluations are there; the comparisons of each kind are corrected as one
/// family.
std::vector<Finding> findings(const Evidence& evidence);

}  // namespace mirage::paper
