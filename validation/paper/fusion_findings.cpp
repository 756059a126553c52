// Which side of a fusion is the weaker one, and whether what was learned against one works on the others.
// Everything is net of random meshes of the learned one's size: vanished and missed at IoU 0.7, the seed's.
#include <fmt/format.h>

#include <array>
#include <functional>

#include "validation/paper/checks.h"
#include "validation/paper/fusions.h"

namespace mirage::paper {
namespace {

/// Both meanings of hidden, and their words.
const std::array<std::pair<HidingRule, const char*>, 2> kMeanings = {
    {{kHidingRules[0], "vanished"}, {kHidingRules[2], "missed at IoU 0.7"}}};

/// One of the matrix's cells, with its control.
struct Cell {
  const Outcomes *learned = nullptr, *sized = nullptr;
  explicit operator bool() const { return learned && sized; }
};

Cell cell(const Evidence& evidence, const std::string& rig, const Attacked& attacked,
          const std::string& judge) {
  const std::string name = cell_case(rig, attacked, judge);
  return {evidence.learned(name), evidence.sized(name)};
}

/// A check of a difference by both meanings. `share`: what stands in the sentence before the difference.
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

/// The mesh's share and its control's.
std::string beside(const Cell& cell, const HidingRule& rule) {
  return fmt::format("{} learned, {} random of its size", percent(*hiding(*cell.learned, rule)),
                     percent(*hiding(*cell.sized, rule)));
}

Check more_than_its_size(const std::string& where, const Cell& cell) {
  return by_both(
      where, {cell.learned, cell.sized},
      [&](const HidingRule& rule) { return hiding_difference(*cell.learned, *cell.sized, rule); },
      [&](const HidingRule& rule) { return beside(cell, rule); });
}

Finding net(const Evidence& evidence) {
  return on_each_rig("fusions-net",
                     "Not in the paper: a learned mesh hides more than a random one of its size",
                     [&](const std::string& rig, std::vector<Check>& checks) {
                       for (const std::string& detector : fusion_detectors())
                         if (const Cell own = cell(evidence, rig, through_all(detector), detector))
                           checks.push_back(more_than_its_size(title(rig) + ", " + detector, own));
                     });
}

Finding sides(const Evidence& evidence) {
  return on_each_rig(
      "fusions-side", "Not in the paper: the picture is the weaker side of a fusion, net of the mesh's size",
      [&](const std::string& rig, std::vector<Check>& checks) {
        for (const std::string& detector : fused_detectors()) {
          const Cell image = cell(evidence, rig, {detector, "image"}, detector),
                     lidar = cell(evidence, rig, {detector, "lidar"}, detector);
          if (!image || !lidar) continue;
          const auto net_words = [](const Cell& cell, const HidingRule& rule) {
            return points(hiding_difference(*cell.learned, *cell.sized, rule));
          };
          checks.push_back(about_images(
              by_both(
                  title(rig) + ", " + detector, {image.learned, image.sized, lidar.learned, lidar.sized},
                  [&](const HidingRule& rule) {
                    return net_difference({image.learned, image.sized}, {lidar.learned, lidar.sized}, rule);
                  },
                  [&](const HidingRule& rule) {
                    return fmt::format("net {} through the image, {} through LiDAR, image − LiDAR",
                                       net_words(image, rule), net_words(lidar, rule));
                  }),
              {image.learned, lidar.learned}));
        }
      });
}

Finding transfer_between(const Evidence& evidence) {
  return on_each_rig(
      "fusions-transfer",
      "Not in the paper: what is learned against one fusion hides from the others, net of its size",
      [&](const std::string& rig, std::vector<Check>& checks) {
        for (const std::string& from : fused_detectors())
          for (const std::string& onto : fused_detectors())
            if (const Cell moved = cell(evidence, rig, through_all(from), onto); moved && from != onto)
              checks.push_back(more_than_its_size(fmt::format("{}, {} → {}", title(rig), from, onto), moved));
      });
}

}  // namespace

std::vector<Finding> fusion_findings(const Evidence& evidence) {
  return {net(evidence), sides(evidence), transfer_between(evidence)};
}

}  // namespace mirage::paper
