// Stands in for the program in tests of `mirage reproduce`: nothing is attacked or judged.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "base/error.h"
#include "base/field_text.h"
#include "base/files.h"
#include "validation/paper/experiments.h"
#include "validation/paper_fixture.h"

namespace mirage::test {

inline paper::ReproduceSettings settings_in(const std::filesystem::path& out,
                                            const std::string& what = "all") {
  paper::ReproduceSettings settings;
  settings.out = out;
  settings.what = what;
  settings.quiet = true;
  return settings;
}

/// Stands in for the program: writes what the tables read; remembers what was asked for.
class Program {
 public:
  struct Call {
    std::string command;
    NamedSettings settings;
  };
  std::vector<Call> calls;
  std::string broken;  ///< folder whose command fails
  MadeUp learned{40, 5, 3, 1, 30}, random{40, 5, 1, 0, 30};
  bool uses_picture = true;
  /// Meshes of single evaluations, learned and random, by their folder's name.
  std::map<std::string, std::pair<MadeUp, MadeUp>> planted;
  int worse_by_seed = 0;  ///< so many fewer vehicles a frame are hidden in each further run

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
