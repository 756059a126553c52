#include "validation/paper/reproduce.h"

#include <set>

#include "attack/attack_settings.h"
#include "base/child_process.h"
#include "base/field_json.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/ranks.h"
#include "validation/paper/findings.h"

namespace mirage::paper {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

/// Texts and page. The page's file; empty if it could not be written.
fs::path write_page(const fs::path& out, const std::vector<TableResult>& tables) {
  // None of an earlier run stays where Python is missing.
  fs::remove(text_file(out, "reproduce"));
  for (const TableResult& table : tables) fs::remove(text_file(out, table.name));
  const std::string python = plotting_python().string();
  if (!python.empty() &&
      run_program({python, shipped_file("validation/paper/paper_page.py").string(), out.string()}) == 0)
    return out / "reproduce.html";
  spdlog::warn("no page: install python3-jinja2 and python3-pil (all figures are in {})",
               (out / "reproduce.json").string());
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

}  // namespace

fs::path text_file(const fs::path& out, const std::string& table) {
  return out / (table + ".md");
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
                {"confidence", kConfidence}}},
              {"tables", list_json(result.tables)},
              {"arms", list_json(result.arms)},
              {"findings", list_json(result.findings)},
              {"reliance", json::array()},
              {"steps", json::object()}};
  for (const auto& [name, reliance] : result.reliance) {
    all["reliance"].push_back(to_json(reliance));
    const std::string note = picture_note(reliance);
    all["reliance"].back()["case"] = name;
    all["reliance"].back()["words"] = describe(reliance) + (note.empty() ? "" : "; " + note);
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
  result.steps = execute(list, result.settings, run);
  if (rank() > 0) return result;
  const Evidence evidence = gather(list, out, result.steps);
  for (const Table& table : list.tables) result.tables.push_back(table_result(table, list, evidence));
  result.arms = evaluation_arms(list, result.settings, evidence);
  result.findings = findings(evidence);
  result.reliance = reliance_of(evidence);
  write_json(out / "reproduce.json", to_json(result));
  result.page = write_page(out, result.tables);
  return result;
}

}  // namespace mirage::paper
