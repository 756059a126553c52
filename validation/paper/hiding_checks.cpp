#include "validation/paper/hiding_checks.h"

#include <fmt/format.h>

#include <array>
#include <utility>

namespace mirage::paper {
namespace {

/// Both meanings of hidden, and their words.
const std::array<std::pair<HidingRule, const char*>, 2> kMeanings = {
    {{kHidingRules[0], "vanished"}, {kHidingRules[2], "missed at IoU 0.7"}}};

/// The mesh's share and its control's.
std::string beside(const Cell& cell, const HidingRule& rule) {
  return fmt::format("{} learned, {} random of its size", percent(*hiding(*cell.learned, rule)),
                     percent(*hiding(*cell.sized, rule)));
}

}  // namespace

Cell cell_of(const Evidence& evidence, const std::string& evaluation) {
  return {evidence.learned(evaluation), evidence.sized(evaluation)};
}

Check by_both(const std::string& where, const std::vector<const Outcomes*>& used,
              const std::function<Interval(const HidingRule&)>& difference,
              const std::function<std::string(const HidingRule&)>& share) {
  std::vector<Comparison> comparisons;
  std::string sentence;
  for (const auto& [rule, word] : kMeanings) {
    comparisons.push_back(comparison(word, difference(rule)));
    sentence += fmt::format("{}{}: {}, {}", sentence.empty() ? "" : "; ", word, share(rule),
                            points(comparisons.back().difference));
  }
  return check(where, used, std::move(comparisons), std::move(sentence));
}

Check more_than_its_size(const std::string& where, const Cell& cell) {
  return by_both(
      where, {cell.learned, cell.sized},
      [&](const HidingRule& rule) { return hiding_difference(*cell.learned, *cell.sized, rule); },
      [&](const HidingRule& rule) { return beside(cell, rule); });
}

std::string net_points(const Cell& cell, const HidingRule& rule) {
  return points(hiding_difference(*cell.learned, *cell.sized, rule));
}

}  // namespace mirage::paper
