// Whether shape and texture each hide by themselves, and whether either is more than size.
#include <fmt/format.h>

#include <map>

#include "validation/paper/case_list.h"
#include "validation/paper/hiding_checks.h"

namespace mirage::paper {
namespace {

Cell cell(const Evidence& evidence, const std::string& target, const std::string& parts) {
  return cell_of(evidence, "evaluations/" + run_name("kitti64", "fusion", target, {.parts = parts}));
}

std::string where(const std::string& target) {
  const std::map<std::string, std::string> words = {
      {"image", "the image"}, {"lidar", target_title(target)}, {"both", "both sensors"}};
  return title("kitti64") + ", through " + words.at(target);
}

Check about(Check made, const std::string& target, const Cell& used) {
  return target == "lidar" ? made : about_images(std::move(made), {used.learned});
}

Finding alone(const Evidence& evidence) {
  Finding finding{
      "parts-alone", "Not in the paper: one part of the object hides by itself, net of its size", {}};
  for (const std::string target : {"image", "both"})  // through LiDAR only the shape is reached
    for (const std::string parts : {"shape", "texture"})
      if (const Cell own = cell(evidence, target, parts))
        finding.checks.push_back(about(more_than_its_size(where(target) + ", " + parts, own), target, own));
  return finding;
}

/// The whole object less the arm that learned these parts, on the same vehicles.
void add_gain(Finding& finding, const Evidence& evidence, const std::string& target, const std::string& parts,
              const char* word) {
  const Cell whole = cell(evidence, target, ""), part = cell(evidence, target, parts);
  if (!whole || !part) return;
  finding.checks.push_back(about(
      by_both(
          where(target), {whole.learned, part.learned},
          [&](const HidingRule& rule) { return hiding_difference(*whole.learned, *part.learned, rule); },
          [&](const HidingRule& rule) {
            return fmt::format("{} the whole object, {} {}", percent(*hiding(*whole.learned, rule)),
                               percent(*hiding(*part.learned, rule)), word);
          }),
      target, whole));
}

Finding gain(const Evidence& evidence, const std::string& name, const std::string& claim,
             const std::string& parts, const char* word) {
  Finding finding{name, claim, {}};
  for (const char* target : {"image", "lidar", "both"}) add_gain(finding, evidence, target, parts, word);
  return finding;
}

}  // namespace

std::vector<Finding> part_findings(const Evidence& evidence) {
  return {alone(evidence),
          gain(evidence, "parts-shape", "Not in the paper: a shape that is learned adds to the texture",
               "texture", "its texture alone"),
          gain(evidence, "parts-texture", "Not in the paper: a texture that is learned adds to the shape",
               "shape", "its shape alone"),
          gain(evidence, "parts-size", "Not in the paper: what is learned hides more than the best size does",
               "size", "the best size")};
}

}  // namespace mirage::paper
