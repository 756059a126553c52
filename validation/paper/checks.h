// What the findings share: words for numbers, and comparisons of two evaluations of the same hosts.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "validation/paper/finding.h"

namespace mirage::paper {

std::string title(const std::string& rig);
/// "+3.1 points (-1.0 to +7.2)"
std::string points(const Interval& difference);
/// "31.9 % (24.1–40.0)" of the vehicles detected clean.
std::string asr(const Outcomes& outcomes, const Which& which = is_fooled);
std::string percent(const Interval& share);
/// Case of the evaluation of RIG-RUN on its own held-back hosts.
std::string evaluation(const std::string& rig, const std::string& run);
/// Vehicles of the evaluation that has fewest.
int fewest(const std::vector<const Outcomes*>& all);

/// A check with its comparisons; too few vehicles leave it open.
Check check(const std::string& where, const std::vector<const Outcomes*>& used,
            std::vector<Comparison> comparisons, std::string sentence, std::string why = "");

/// A check of a claim about images. Where one of the detectors that were attacked does not use its picture,
/// nothing can be told, and its note stands in place of all sentences.
Check about_images(Check check, const std::vector<const Outcomes*>& attacked);

/// The claim about success(a) − success(b).
Comparison more(const std::string& what, const Outcomes& a, const Outcomes& b, const Which& which = is_fooled,
                Claim claim = Claim::more);

/// Corrects the comparisons of these findings as one family, and says what follows: verdicts of the checks,
/// and in their sentences which of several comparisons tell what, what the correction leaves open, and how
/// many vehicles it would take.
void settle(std::vector<Finding>& findings);

/// The finding's checks on each rig for which `make` finds its evaluations.
template <class Make>
Finding on_each_rig(const std::string& name, const std::string& claim, const Make& make) {
  Finding finding{name, claim, {}};
  for (const char* rig : {"kitti64", "xenith", "real"}) make(std::string(rig), finding.checks);
  return finding;
}

/// The findings about defences, kinds of fusion and parts of the object; findings() has them all.
std::vector<Finding> defence_findings(const Evidence& evidence);
/// About defences and controls that are not in the paper.
std::vector<Finding> own_defence_findings(const Evidence& evidence);
std::vector<Finding> fusion_findings(const Evidence& evidence);
std::vector<Finding> part_findings(const Evidence& evidence);

// Checks by both meanings of hidden, vanished and missed at IoU 0.7 (attack/hiding.h), of meshes beside
// random ones of their size.

/// A learned mesh, with its control.
struct Cell {
  const Outcomes *learned = nullptr, *sized = nullptr;
  explicit operator bool() const { return learned && sized; }
};
/// Of the case; without both of them false.
Cell cell_of(const Evidence& evidence, const std::string& evaluation);

/// A check of a difference by both meanings. `share`: what stands in the sentence before the difference.
Check by_both(const std::string& where, const std::vector<const Outcomes*>& used,
              const std::function<Interval(const HidingRule&)>& difference,
              const std::function<std::string(const HidingRule&)>& share);

/// That the mesh hides more than its control.
Check more_than_its_size(const std::string& where, const Cell& cell);

/// "+3.1 points (-1.0 to +7.2)", net of the control.
std::string net_points(const Cell& cell, const HidingRule& rule);

}  // namespace mirage::paper
