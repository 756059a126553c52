#include "validation/paper/reproduce.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <set>

#include "attack/attack_settings.h"
#include "base/clock.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "detection/detector.h"
#include "detection/reliance.h"
#include "scene/data/data_rig.h"
#include "validation/paper/evaluation_arms.h"
#include "validation/paper/findings.h"
#include "validation/process.h"

namespace mirage::paper {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

fs::path record_file(const Case& command, const fs::path& out) {
  std::string name = command.name;
  std::replace(name.begin(), name.end(), '/', '_');
  return out / "steps" / (name + ".json");
}

/// The arguments with the folders of other cases by their names, so that OUT may be moved.
std::vector<std::string> movable(const Case& command, std::vector<std::string> arguments) {
  for (std::string& argument : arguments)
    for (const std::string& need : command.needs)
      if (argument.ends_with("/" + need)) argument = need;
  return arguments;
}

/// What the command reads that may change under the same arguments, as hashes of the content.
json inputs(const Case& command, const fs::path& out) {
  json read = json::object();
  if (command.kind == Case::Kind::evaluation) {
    read["adversary"] = content_hash(read_file(out / command.needs.front() / "adversary.glb"));
    read["hosts"] = content_hash(read_file(out / command.needs.back() / "run.json"));
  } else if (command.kind != Case::Kind::data) {
    read["weights"] = "";  // without the file the command itself says what is missing
    try {
      DetectorOptions detector;
      detector.detector = argument(command, "--detector");
      detector.rig = data_rig(argument(command, "--data"));
      detector.defense = argument(command, "--defense", "none");
      read["weights"] = content_hash(read_file(weights_file(detector)));
    } catch (const InputError&) {
    }
  }
  return read;
}

json to_json(const Step& step) {
  const char* words[] = {"missing", "done", "failed"};
  json entry = {{"status", words[static_cast<int>(step.status)]}};
  if (!step.error.empty()) entry["error"] = step.error;
  if (step.seconds > 0) entry["seconds"] = step.seconds;
  return entry;
}

void write_page(const fs::path& out, json& result) {
  const std::string python = plotting_python().string();
  if (python.empty() ||
      run_program({python, shipped_file("validation/paper/paper_page.py").string(), out.string()}) != 0) {
    spdlog::warn("no page: install python3-jinja2 and python3-pil (the tables are in {})",
                 (out / "reproduce.md").string());
    return;
  }
  result["page"] = (out / "reproduce.html").string();
}

/// Each attacked detector on its data once: [{case, …as detection/reliance.h writes it}].
json reliance_json(const Evidence& evidence) {
  json list = json::array();
  std::set<std::string> seen;
  for (const bool own : {true, false})  // a detector's own runs name it best
    for (const auto& [name, judged] : evidence.evaluations) {
      if (own == (name.find("--on--") != std::string::npos)) continue;
      const json& measured = judged.learned->reliance;
      if (!measured.is_object() || !seen.insert(judged.learned->data + measured.dump()).second) continue;
      list.push_back(measured);
      list.back()["case"] = name.substr(name.find('/') + 1);
    }
  return list;
}

std::string reliance_markdown(const json& list) {
  std::string text = "## Whether the detectors use their pictures\n\n";
  for (const auto& entry : list) {
    const Reliance reliance = reliance_from_json(entry);
    const std::string note = picture_note(reliance);
    text += fmt::format("- {}: {}{}.\n", entry.at("case").get<std::string>(), describe(reliance),
                        note.empty() ? "" : "; " + note);
  }
  return text + "\n";
}

std::string findings_markdown(const json& findings) {
  std::string text = "## The paper's findings\n\n";
  for (const auto& finding : findings) {
    text += fmt::format("- **{}**", finding.at("claim").get<std::string>());
    if (finding.at("checks").empty()) text += ": not measured in this run.";
    text += "\n";
    for (const auto& check : finding.at("checks")) {
      text += fmt::format("  - {}: {}. {}.", check.at("rig").get<std::string>(),
                          check.at("verdict").get<std::string>(), check.at("sentence").get<std::string>());
      if (const auto why = check.at("why").get<std::string>(); !why.empty()) text += " (" + why + ")";
      text += "\n";
    }
  }
  return text;
}

}  // namespace

bool is_finished(const Case& command, const fs::path& out) {
  if (!fs::exists(out / command.name / "result.json")) return false;
  try {
    const json record = read_json(record_file(command, out));
    return movable(command, record.at("arguments")) == movable(command, command.arguments) &&
           record.at("inputs") == inputs(command, out);
  } catch (const std::exception&) {
    return false;  // the command itself will say what is wrong
  }
}

std::map<std::string, Step> execute(const Experiments& experiments, const ReproduceSettings& settings,
                                    const Execute& run) {
  std::map<std::string, Step> steps;
  std::size_t number_of = 0;
  for (const Case& command : experiments.cases) {
    throw_if_interrupted("finished steps are kept; run the same command to go on");
    Step& step = steps[command.name];
    const auto say = [&](const char* what) {
      if (settings.quiet) return;
      std::fputs(fmt::format("\n== {}/{} {}{} ==\n", number_of, experiments.cases.size(), command.name, what)
                     .c_str(),
                 stdout);
      std::fflush(stdout);
    };
    ++number_of;
    const auto broken =
        std::find_if(command.needs.begin(), command.needs.end(),
                     [&](const std::string& need) { return steps[need].status != Step::Status::done; });
    if (broken != command.needs.end()) {
      step.status = Step::Status::failed;
      step.error = "needs " + *broken;
      say(": left out, it needs what failed");
      continue;
    }
    try {
      if (is_finished(command, settings.out)) {
        say(": kept");
      } else {
        say("");
        auto arguments = command.arguments;
        arguments.insert(arguments.end(), {"--out", (settings.out / command.name).string(), "--threads",
                                           std::to_string(settings.threads)});
        if (settings.quiet) arguments.push_back("--quiet");
        fs::remove(record_file(command, settings.out));
        const auto start = Clock::now();
        run(std::move(arguments));
        write_json(record_file(command, settings.out), {{"case", command.name},
                                                        {"arguments", movable(command, command.arguments)},
                                                        {"inputs", inputs(command, settings.out)},
                                                        {"seconds", seconds_since(start)}});
      }
      step.status = Step::Status::done;
      step.seconds = read_json(record_file(command, settings.out)).at("seconds");
    } catch (const Interrupted&) {
      throw;
    } catch (const std::exception& error) {
      step.status = Step::Status::failed;
      step.error = error.what();
      spdlog::warn("{}: {}", command.name, error.what());
    }
  }
  return steps;
}

json reproduce(const ReproduceSettings& given, const Execute& run) {
  ReproduceSettings settings = given;
  settings.out = fs::absolute(given.out).lexically_normal();
  const Experiments list = experiments(settings);
  const Evidence evidence = gather(list, settings.out, execute(list, settings, run));
  json tables = json::array(), steps = json::object();
  std::string text = "# The experiments of Tu et al. (CoRL 2021)\n\n";
  for (const Table& table : list.tables) {
    tables.push_back(table_json(table, list, evidence));
    write_file(settings.out / (table.name + ".md"), markdown(tables.back()));
    text += markdown(tables.back());
  }
  for (const auto& [name, step] : evidence.steps) steps[name] = to_json(step);
  const json judged = findings_json(findings(evidence)), reliance = reliance_json(evidence);
  const AttackSettings recipe;  // CaseList takes these from it
  json result = {{"what", settings.what},
                 {"settings",
                  {{"iterations", settings.iterations},
                   {"batch", recipe.batch},
                   {"vertex_rate", recipe.vertex_rate},
                   {"texel_rate", recipe.texel_rate},
                   {"seed", settings.seed},
                   {"seeds", settings.seeds},
                   {"random_meshes", settings.random_meshes},
                   {"quick", settings.quick},
                   {"kitti64", data_folder(settings, "kitti64").filename().string()},
                   {"xenith", data_folder(settings, "xenith").filename().string()},
                   {"real", settings.real.filename().string()},
                   {"confidence", BootstrapSettings().confidence},
                   {"replicates", BootstrapSettings().replicates}}},
                 {"tables", tables},
                 {"arms", arms_json(list, settings, evidence)},
                 {"findings", judged},
                 {"reliance", reliance},
                 {"steps", steps}};
  write_json(settings.out / "reproduce.json", result);
  write_file(settings.out / "reproduce.md", text + reliance_markdown(reliance) + findings_markdown(judged));
  write_page(settings.out, result);
  return result;
}

}  // namespace mirage::paper
