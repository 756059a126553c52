// What defences take off, and off what.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <span>
#include <vector>

#include "validation/paper/cases.h"
#include "validation/paper/checks.h"
#include "validation/paper/experiments.h"

namespace mirage::paper {
namespace {

constexpr double kUndefined = std::numeric_limits<double>::quiet_NaN();

/// What a defence takes off the ASR, against `before`.
Finding defence(const Evidence& evidence, const std::string& name, const std::string& claim,
                const std::string& before, const std::string& after, const std::string& words,
                const Which& which, const std::string& quantity) {
  return on_each_rig(name, claim, [&](const std::string& rig, std::vector<Check>& checks) {
    const Outcomes *without = evidence.learned(evaluation(rig, before)),
                   *with = evidence.learned(evaluation(rig, after));
    if (!without || !with) return;
    const Comparison taken =
        more(quantity + " taken off", *without, *with, which, name == "jpeg" ? Claim::no_help : Claim::more);
    std::string margin;
    if (name == "jpeg") {
      margin = fmt::format(" (under {:.0f} points counts as none)", 100 * kMargin);
    }
    const std::string why =
        fmt::format("misses {} → {}, false positives {} → {}", asr(*without, is_hidden),
                    asr(*with, is_hidden), asr(*without, is_false_positive), asr(*with, is_false_positive));
    Check rig_check = check(title(rig), {without, with}, {taken},
                            fmt::format("{} {} {}: {} taken off{}", quantity,
                                        fmt::format("{} → {}", asr(*without, which), asr(*with, which)),
                                        words, points(taken.difference), margin),
                            why);
    checks.push_back(concerns_picture(name) ? about_images(rig_check, {without, with}) : rig_check);
  });
}

/// Share of the misses that is left, and of the false positives; the second more than the first.
Finding harder(const Evidence& evidence) {
  return on_each_rig(
      "harder", "False positives are harder to remove than misses",
      [&](const std::string& rig, std::vector<Check>& checks) {
        const Outcomes* none = evidence.learned(evaluation(rig, "fusion-both"));
        for (const auto& [defense, words] : std::vector<std::pair<std::string, std::string>>{
                 {"adversarial", "adversarial training"}, {"denoising", "feature denoising"}}) {
          const Outcomes* with = evidence.learned(evaluation(rig, "fusion-both-" + defense));
          if (!none || !with) continue;
          SumsByCrossing by_name;  // hidden, with a false positive, vehicles; without the defence and with it
          const Outcomes a = shared_hosts(*none, *with), b = shared_hosts(*with, *none);
          for (int side = 0; side < 2; ++side)
            for (const Outcome& host : (side == 0 ? a : b).hosts) {
              if (!host.detected) continue;
              std::vector<double>& sums = by_name[{host.cluster(), host.run}];
              sums.resize(6);
              double* of = sums.data() + 3 * side;
              of[0] += host.hidden, of[1] += host.false_positive, of[2] += 1;
            }
          const auto left = [&](std::span<const double> sums, std::size_t part) {
            return sums.size() == 6 && sums[part] > 0 && sums[5] > 0
                       ? (sums[3 + part] / sums[5]) / (sums[part] / sums[2])
                       : kUndefined;
          };
          std::vector<double> all(6);
          for (const auto& [name, sums] : by_name)
            for (std::size_t i = 0; i < all.size(); ++i) all[i] += sums[i];
          const double misses = left(all, 0), positives = left(all, 1);
          const Interval difference = plain_interval(
              jackknife(by_name, [&](std::span<const double> sums) { return left(sums, 1) - left(sums, 0); }),
              1 / std::max(1.0, std::min(all[0], all[1])));
          if (std::isnan(misses) || std::isnan(positives)) {
            Check rig_check;
            rig_check.rig = title(rig) + ", " + words;
            rig_check.vehicles = fewest({none, with});
            rig_check.sentence =
                "the undefended detector has no miss or no false positive that could be removed";
            checks.push_back(rig_check);
            continue;
          }
          Check rig_check =
              check(title(rig) + ", " + words, {none, with},
                    {comparison("share of the false positives left − of the misses", difference)},
                    fmt::format("left are {:.0f} % of the misses (FN ASR {} → {}) and {:.0f} % of the false "
                                "positives (FP ASR {} → {}); difference {}",
                                100 * misses, asr(a, is_hidden), asr(b, is_hidden), 100 * positives,
                                asr(a, is_false_positive), asr(b, is_false_positive), points(difference)));
          checks.push_back(defense == "denoising" ? about_images(rig_check, {none, with}) : rig_check);
        }
      });
}

}  // namespace

std::vector<Finding> defence_findings(const Evidence& evidence) {
  return {defence(evidence, "jpeg", "JPEG compression does not help", "fusion-both", "fusion-both-jpeg50",
                  "with JPEG at quality 50", is_fooled, "ASR"),
          defence(evidence, "adversarial", "Adversarial training helps", "fusion-both",
                  "fusion-both-adversarial", "with adversarial training", is_fooled, "ASR"),
          defence(evidence, "denoising", "Feature denoising helps more than adversarial training alone",
                  "fusion-both-adversarial", "fusion-both-denoising", "with feature denoising as well",
                  is_fooled, "ASR"),
          harder(evidence)};
}

std::vector<Finding> own_defence_findings(const Evidence& evidence) {
  return {
      defence(evidence, "roof-objects",
              "Not in the paper: adversarial training is worth more than having seen things on roofs",
              "fusion-both-roof-objects", "fusion-both-adversarial",
              "with the adversary in the random meshes' place", is_fooled, "ASR"),
      defence(evidence, "picture-dropout", "Not in the paper: leaving out pictures in training helps",
              "fusion-both", "fusion-both-picture-dropout", "with half of the pictures left out", is_fooled,
              "ASR"),
      defence(evidence, "consistency", "Not in the paper: consistency of the sensors helps", "fusion-both",
              "fusion-both-consistency", "with consistency of the sensors", is_fooled, "ASR"),
      defence(evidence, "shadows", "Not in the paper: bodies and shadows of the sweep help", "fusion-both",
              "fusion-both-shadows", "held against the sweep's bodies", is_fooled, "ASR"),
      defence(evidence, "adversarial+shadows",
              "Not in the paper: bodies and shadows help on top of adversarial training",
              "fusion-both-adversarial", "fusion-both-adversarial-shadows",
              "held against the sweep's bodies as well", is_fooled, "ASR"),
      defence(evidence, "ceiling:1.4", "Not in the paper: looking at nothing above roofs helps",
              "fusion-both", "fusion-both-ceiling1.4", "under a ceiling of 1.4 m", is_fooled, "ASR"),
      defence(evidence, "ceiling", "Not in the paper: training under the ceiling takes off more",
              "fusion-both-ceiling1.4", "fusion-both-ceiling", "trained under it", is_fooled, "ASR"),
      defence(evidence, "gate", "Not in the paper: the depth gate removes false positives", "fusion-both",
              "fusion-both-depth-gate", "with the depth gate", is_false_positive, "FP ASR")};
}

// Which side of a fusion is the weaker one, and whether what was learned against one works on the others.
// Everything is net of random meshes of the learned one's size: vanished and missed at IoU 0.7, the seed's.

namespace {

Cell cell(const Evidence& evidence, const std::string& rig, const Attacked& attacked,
          const std::string& judge) {
  return cell_of(evidence, cell_case(rig, attacked, judge));
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
          checks.push_back(about_images(
              by_both(
                  title(rig) + ", " + detector, {image.learned, image.sized, lidar.learned, lidar.sized},
                  [&](const HidingRule& rule) {
                    return net_difference({image.learned, image.sized}, {lidar.learned, lidar.sized}, rule);
                  },
                  [&](const HidingRule& rule) {
                    return fmt::format("net {} through the image, {} through LiDAR, image − LiDAR",
                                       net_points(image, rule), net_points(lidar, rule));
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

// Whether shape and texture each hide by themselves, and whether either is more than size.

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
