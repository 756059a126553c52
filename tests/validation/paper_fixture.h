// Made-up evaluations for tests of the paper's tables and findings, and a stand-in for the program in tests
// of `mirage reproduce`. Nothing in them was measured.
#pragma once

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "attack/evaluation.h"
#include "attack/host_outcome.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "detection/reliance.h"
#include "support/files.h"
#include "validation/paper/experiments.h"
#include "validation/paper/finding.h"
#include "validation/paper/results.h"

namespace mirage::test {

/// Number of vehicles per frame, of `hosts`, that are hidden, and that get a false positive `distance` m
/// away; the first ones.
struct MadeUp {
  int frames = 40, hosts = 5, hidden = 0, false_positive = 0;
  double distance = 30;
  double left = 0.3;  ///< best IoU with a hidden vehicle; 0.1 and less: it vanished
};

/// Hides `hidden` of five vehicles per frame, in three frames of four, with no remaining box.
inline MadeUp vanishing(int hidden) {
  return {120, 5, hidden, 0, 30, 0.05};
}

/// The format of to_json(Evaluation), by the real writers. In the picture `distance` is in pixels.
inline nlohmann::json outcomes_json(const MadeUp& made, Matching matching = kFromAbove) {
  std::vector<HostOutcome> hosts;
  for (int f = 0; f < made.frames; ++f)
    for (int h = 0; h < made.hosts; ++h) {
      // One frame in four differs; otherwise there would be no spread to resample.
      const bool odd = f % 4 == 0;
      HostOutcome host;
      host.id = {fmt::format("{:06d}", f), h};
      host.matching = matching;
      host.range = 10.0 + h;
      host.detected = true;
      host.hidden = h < made.hidden && !odd;
      host.false_positive = h < made.false_positive && !odd;
      host.clean_iou = 0.9;
      host.attacked_iou = host.hidden ? made.left : 0.85;
      if (host.false_positive) {
        host.false_positive_distance = made.distance;
        host.new_boxes = {{{}, 0.5, made.distance, 0}};
      }
      hosts.push_back(std::move(host));
    }
  return {{"vehicles", made.frames * made.hosts},
          {"outcomes", mirage::outcomes_json(hosts, 1)},
          {"false_positives", false_positives_json(hosts)}};
}

/// A detector that loses 20 points of AP with another frame's picture, or none.
inline Reliance made_up_reliance(bool uses_picture) {
  Reliance made;
  made.ap70 = 0.8;
  made.ap70_swapped = uses_picture ? 0.6 : 0.8;
  made.ap70_black = 0.5;
  made.drop = {made.ap70 - made.ap70_swapped, uses_picture ? 0.1 : -0.01, uses_picture ? 0.3 : 0.01};
  made.mean_delta_logit = uses_picture ? 2 : 0.07;
  made.frames = 40;
  made.vehicles = 200;
  return made;
}

inline nlohmann::json evaluation_json(const MadeUp& learned, const MadeUp& random, bool uses_picture = true) {
  nlohmann::json json = outcomes_json(learned);
  json["reliance"] = to_json(made_up_reliance(uses_picture));
  json["random"] = outcomes_json(random);
  json["random"]["meshes"] = 1;
  json["sized"] = json["cuboid"] = json["random"];
  return json;
}

/// Evidence from evaluations, by the name of their run.
class WithEvidence : public testing::Test {
 protected:
  void judged(const std::string& run, const MadeUp& learned, const MadeUp& random = {},
              bool uses_picture = true) {
    const auto file = folder_ / (std::to_string(count_++) + ".json");
    write_json(file, evaluation_json(learned, random, uses_picture));
    evidence_.evaluations["evaluations/" + run] = paper::read_evaluation(file, "data");
  }
  /// The checks of one finding.
  std::vector<paper::Check> checks(const std::string& name) const {
    for (const paper::Finding& finding : paper::findings(evidence_))
      if (finding.name == name) return finding.checks;
    ADD_FAILURE() << name;
    return {};
  }
  TemporaryFolder folder_;
  paper::Evidence evidence_;
  int count_ = 0;
};

inline paper::ReproduceSettings settings_in(const std::filesystem::path& out,
                                            const std::string& what = "all") {
  paper::ReproduceSettings settings;
  settings.out = out;
  settings.what = what;
  settings.quiet = true;
  return settings;
}

/// Stands in for the program: writes the files that the tables read, and records its calls.
class PaperProgram {
 public:
  struct Call {
    std::string command;
    NamedSettings settings;
  };
  std::vector<Call> calls;
  std::string broken;  ///< folder with a failing command
  MadeUp learned{40, 5, 3, 1, 30}, random{40, 5, 1, 0, 30};
  bool uses_picture = true;
  /// Meshes of single evaluations, learned and random, by folder name.
  std::map<std::string, std::pair<MadeUp, MadeUp>> planted;
  int worse_by_seed = 0;  ///< number of vehicles per frame that each further run hides less

  void operator()(const std::string& command, const NamedSettings& settings) {
    const auto given = [&](const char* name) { return settings.contains(name) ? settings.at(name) : ""; };
    const std::filesystem::path out = settings.at("out");
    calls.push_back({command, settings});
    if (!broken.empty() && out.string().ends_with(broken)) throw Failure(broken, "made to fail", "nothing");
    nlohmann::json result = {{"rig", given("rig")}, {"frames", 120}};
    if (command == "attack") {
      write_file(out / "adversary.glb", "mesh of " + out.string());
      write_file(out / "run.json", "{}");
    }
    if (command == "evaluate") {
      const auto own = planted.find(out.filename().string());
      MadeUp mesh = own == planted.end() ? learned : own->second.first;
      mesh.hidden -= given("seed").empty() ? 0 : worse_by_seed * std::stoi(given("seed"));
      result = evaluation_json(mesh, own == planted.end() ? random : own->second.second, uses_picture);
    }
    if (command == "detect") result = {{"ap50", 0.9}, {"ap70", 0.8}};
    write_json(out / "result.json", result);
  }
};

}  // namespace mirage::test
