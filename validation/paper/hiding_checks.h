// Checks by both meanings of hidden, vanished and missed at IoU 0.7 (attack/hiding.h), of meshes beside
// random ones of their size.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "validation/paper/checks.h"

namespace mirage::paper {

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
