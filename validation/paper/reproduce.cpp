#include "validation/paper/reproduce.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <set>

#include "attack/attack_settings.h"
#include "base/clock.h"
#include "base/error.h"
#include "base/field_json.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/unused_memory.h"
#include "detection/detector.h"
#include "scene/data/data_rig.h"
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

/// What the case's result is made of: settings, other cases by their names so that OUT may be moved, and
/// hashes of the files that may change under the same settings.
json made_of(const Case& command, const fs::path& out) {
  json read = json::object();
  if (command.kind == Case::Kind::evaluate) {
    read["adversary"] = file_hash(out / command.run() / "adversary.glb");
    read["hosts"] = file_hash(out / command.hosts_of() / "run.json");
  } else if (command.kind != Case::Kind::generate) {
    read["weights"] = "";  // without the file the command itself says what is missing
    try {
      DetectorOptions detector;
      detector.detector = command.setting("detector");
      detector.rig = data_rig(command.settings_in(out).at("data"));
      detector.defense = command.setting("defense", "none");
      read["weights"] = weights_hash(detector);
    } catch (const InputError&) {
    }
  }
  return {{"command", to_word(command.kind)},
          {"settings", command.settings},
          {"needs", command.needs},
          {"read", read}};
}

/// The page's file; empty if it could not be written.
fs::path write_page(const fs::path& out) {
  const std::string python = plotting_python().string();
  if (!python.empty() &&
      run_program({python, shipped_file("validation/paper/paper_page.py").string(), out.string()}) == 0)
    return out / "reproduce.html";
  spdlog::warn("no page: install python3-jinja2 and python3-pil (the tables are in {})",
               (out / "reproduce.md").string());
  return {};
}

/// Each attacked detector on its data once.
std::vector<CaseReliance> reliance_of(const Evidence& evidence) {
  std::vector<CaseReliance> list;
  std::set<std::string> seen;
  for (const bool own : {true, false})  // a detector's own runs name it best
    for (const auto& [name, judged] : evidence.evaluations) {
      if (own == (name.find("--on--") != std::string::npos)) continue;
      const auto& measured = judged.learned->reliance;
      if (!measured || !seen.insert(judged.learned->data + to_json(*measured).dump()).second) continue;
      list.push_back({name.substr(name.find('/') + 1), *measured});
    }
  return list;
}

std::string markdown(const std::vector<CaseReliance>& list) {
  std::string text = "## Whether the detectors use their pictures\n\n";
  for (const auto& [name, reliance] : list) {
    const std::string note = picture_note(reliance);
    text += fmt::format("- {}: {}{}.\n", name, describe(reliance), note.empty() ? "" : "; " + note);
  }
  return text + "\n";
}

/// Seconds that the finished case took. InputError naming file and field.
double recorded_seconds(const fs::path& file) {
  const json record = read_json(file);
  return JsonFields(file, record, kMakeAgain).number("seconds", 0, Range::kMost);
}

}  // namespace

bool is_finished(const Case& command, const fs::path& out) {
  if (!fs::exists(out / command.name / "result.json")) return false;
  try {
    return read_json(record_file(command, out)).value("made_of", json()) == made_of(command, out);
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
    const auto broken = std::find_if(command.needs.begin(), command.needs.end(), [&](const auto& need) {
      return steps[need.second].status != Step::Status::done;
    });
    if (broken != command.needs.end()) {
      step.status = Step::Status::failed;
      step.error = "needs " + broken->second;
      say(": left out, it needs what failed");
      continue;
    }
    try {
      if (is_finished(command, settings.out)) {
        say(": kept");
      } else {
        say("");
        NamedSettings named = command.settings_in(settings.out);
        named["out"] = (settings.out / command.name).string();
        named["threads"] = std::to_string(settings.threads);
        named["quiet"] = fmt::format("{}", settings.quiet);
        fs::remove(record_file(command, settings.out));
        const auto start = Clock::now();
        run(to_word(command.kind), named);
        return_unused_memory();
        write_json(record_file(command, settings.out), {{"case", command.name},
                                                        {"made_of", made_of(command, settings.out)},
                                                        {"seconds", seconds_since(start)}});
      }
      step.status = Step::Status::done;
      step.seconds = recorded_seconds(record_file(command, settings.out));
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

json to_json(const ReproduceResult& result) {
  const ReproduceSettings& settings = result.settings;
  const AttackSettings recipe;  // CaseList takes these from it
  json all = {{"what", settings.what},
              {"settings",
               {{"iterations", settings.iterations},
                {"batch", recipe.batch},
                {"vertex_rate", recipe.vertex_rate},
                {"texel_rate", recipe.texel_rate},
                {"seed", settings.seed},
                {"seeds", settings.seeds},
                {"random_meshes", settings.random_meshes},
                {"frames", settings.frames},
                {"judge_frames", settings.judge_frames},
                {"quick", settings.quick},
                {"kitti64", data_folder(settings, "kitti64").filename().string()},
                {"xenith", data_folder(settings, "xenith").filename().string()},
                {"real", settings.real.filename().string()},
                {"confidence", BootstrapSettings().confidence},
                {"replicates", BootstrapSettings().replicates}}},
              {"tables", list_json(result.tables)},
              {"arms", list_json(result.arms)},
              {"findings", list_json(result.findings)},
              {"reliance", json::array()},
              {"steps", json::object()}};
  for (const auto& [name, reliance] : result.reliance) {
    all["reliance"].push_back(to_json(reliance));
    all["reliance"].back()["case"] = name;
  }
  for (const auto& [name, step] : result.steps) all["steps"][name] = to_json(step);
  if (!result.page.empty()) all["page"] = result.page.string();
  return all;
}

ReproduceResult reproduce(const ReproduceSettings& given, const Execute& run) {
  ReproduceResult result;
  result.settings = given;
  const fs::path out = result.settings.out = fs::absolute(given.out).lexically_normal();
  const Experiments list = experiments(result.settings);
  const Evidence evidence = gather(list, out, execute(list, result.settings, run));
  std::string text = "# The experiments of Tu et al. (CoRL 2021)\n\n";
  for (const Table& table : list.tables) {
    result.tables.push_back(table_result(table, list, evidence));
    const std::string written = markdown(result.tables.back());
    write_file(out / (table.name + ".md"), written);
    text += written;
  }
  result.arms = evaluation_arms(list, result.settings, evidence);
  result.findings = findings(evidence);
  result.reliance = reliance_of(evidence);
  result.steps = evidence.steps;
  write_json(out / "reproduce.json", to_json(result));
  write_file(out / "reproduce.md", text + markdown(result.reliance) + markdown(result.findings));
  result.page = write_page(out);
  return result;
}

}  // namespace mirage::paper
