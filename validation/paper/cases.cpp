#include "validation/paper/cases.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "attack/attack_settings.h"
#include "attack/objective.h"
#include "base/error.h"

namespace mirage::paper {

std::filesystem::path data_folder(const ReproduceSettings& settings, const std::string& rig) {
  const auto& given = rig == "real" ? settings.real : rig == "xenith" ? settings.xenith : settings.kitti64;
  return given.empty() ? settings.out / "data" / rig : given;
}

std::string Case::setting(const std::string& key, const std::string& otherwise) const {
  const auto entry = settings.find(key);
  return entry == settings.end() ? otherwise : entry->second;
}

NamedSettings Case::settings_in(const std::filesystem::path& out) const {
  NamedSettings all = settings;
  for (const auto& [folder, need] : needs) all[folder] = (out / need).string();
  return all;
}

const std::string& Case::hosts_of() const {
  const auto other =
      std::find_if(needs.begin(), needs.end(), [](const auto& need) { return need.first == "hosts_of"; });
  return other == needs.end() ? run() : other->second;
}

const Case& Experiments::at(const std::string& name) const {
  const auto match = std::find_if(cases.begin(), cases.end(), [&](const Case& c) { return c.name == name; });
  if (match == cases.end()) throw InputError("experiments", name, "no such case", "name one of the list");
  return *match;
}

namespace {

/// A defence at the end of a case's name: "jpeg:50" as "-jpeg50", "a+b" as "-a-b"; empty for none.
std::string defense_suffix(std::string defense) {
  if (defense.empty()) return "";
  std::erase(defense, ':');
  std::replace(defense.begin(), defense.end(), '+', '-');
  return "-" + defense;
}

/// "fusion-both" of "runs/kitti64-fusion-both".
std::string last_part(const std::string& name) {
  return name.substr(name.find('/') + 1);
}

}  // namespace

std::string run_name(const std::string& rig, const std::string& detector, const std::string& target,
                     const Variant& variant) {
  std::string name = fmt::format("{}-{}-{}", rig, detector, target);
  if (variant.size > 0) name += fmt::format("-size{:.1f}", variant.size);
  if (!variant.parts.empty()) name += "-" + variant.parts;
  return name + defense_suffix(variant.defense);
}

Case CaseList::judging(const std::string& name, const std::string& run, const std::string& baselines) const {
  return {"evaluations/" + name,
          Case::Kind::evaluate,
          {{"random_meshes", std::to_string(settings_.random_meshes)}, {"baseline", baselines}},
          {{"run", run}}};
}

void CaseList::add_data(Case& command, const std::string& rig) {
  if (rig == "real" || !(rig == "kitti64" ? settings_.kitti64 : settings_.xenith).empty())
    command.settings["data"] = data_folder(settings_, rig).string();
  else
    command.needs.emplace_back(
        "data", add({"data/" + rig,
                     Case::Kind::generate,
                     {{"rig", rig}, {"frames", std::to_string(settings_.frames)}, {"seed", "3"}},
                     {}}));
}

std::string CaseList::attack(const std::string& rig, const std::string& detector, const std::string& target,
                             const Variant& variant) {
  const AttackSettings recipe;
  Case command{"runs/" + run_name(rig, detector, target, variant),
               Case::Kind::attack,
               {{"detector", detector},
                {"target", target},
                {"iterations", std::to_string(settings_.iterations)},
                {"batch", std::to_string(recipe.batch)},
                {"vertex_rate", fmt::format("{}", recipe.vertex_rate)},
                {"texel_rate", fmt::format("{}", recipe.texel_rate)},
                {"fp_top_k", std::to_string(recipe.objective.fp_top_k)},
                {"lidar_gradient", to_word(LidarGradient::silhouette)},
                {"free", "true"},  // as the paper's mesh is
                {"seed", std::to_string(settings_.seed)}},
               {}};
  if (variant.size > 0) command.settings["size"] = fmt::format("{:.1f}", variant.size);
  if (!variant.parts.empty()) command.settings["parts"] = variant.parts;
  if (!variant.defense.empty()) command.settings["defense"] = variant.defense;
  add_data(command, rig);
  return add(command);
}

void CaseList::add_hosts(Case& command, const std::string& run) {
  const std::string rig = last_part(run).substr(0, last_part(run).find('-'));
  if (settings_.judge_frames == 0 || rig == "real") return;
  command.needs.emplace_back(
      "data", add({"data/" + rig + "-judge",
                   Case::Kind::generate,
                   {{"rig", rig}, {"frames", std::to_string(settings_.judge_frames)}, {"seed", "23"}},
                   {}}));
}

std::string CaseList::evaluate(const std::string& run) {
  const Case& attacked = at(run);
  const std::string detector = attacked.setting("detector");
  bool usual = attacked.setting("target") == all_sensors(detector);
  for (const char* variant : {"size", "parts", "defense"}) usual = usual && attacked.setting(variant).empty();
  Case command = judging(last_part(run), run, usual ? "start,sized,cuboid" : "sized");
  add_hosts(command, run);
  if (usual && detector == "fusion") command.settings["pictures"] = std::to_string(settings_.pictures);
  return add(command);
}

std::string CaseList::transfer(const std::string& from, const std::string& onto) {
  Case command = judging(fmt::format("{}--on--{}", last_part(from), last_part(onto)), from, "sized");
  if (settings_.judge_frames == 0) {
    command.needs.emplace_back("hosts_of", onto);
    return add(command);
  }
  command.settings["detector"] = at(onto).setting("detector");
  add_hosts(command, onto);
  return add(command);
}

std::string CaseList::on_real(const std::string& run, const std::string& detector, bool cuboid) {
  Case command = judging(fmt::format("{}--on--real-{}", last_part(run), detector), run,
                         cuboid ? "sized,cuboid" : "sized");
  command.settings["detector"] = detector;
  add_data(command, "real");
  return add(command);
}

std::string CaseList::detect(const std::string& rig, const std::string& detector,
                             const std::string& defense) {
  Case command{fmt::format("detect/{}-{}{}", rig, detector, defense_suffix(defense)),
               Case::Kind::detect,
               {{"detector", detector}},
               {}};
  if (!defense.empty()) command.settings["defense"] = defense;
  add_data(command, rig);
  return add(command);
}

const Case& CaseList::at(const std::string& name) const {
  return *std::find_if(cases.begin(), cases.end(), [&](const Case& c) { return c.name == name; });
}

std::string CaseList::add(Case command) {
  const auto known =
      std::find_if(cases.begin(), cases.end(), [&](const Case& c) { return c.name == command.name; });
  if (known == cases.end())
    cases.push_back(command);
  else if (known->settings != command.settings || known->needs != command.needs)
    throw std::logic_error("two cases named " + command.name);
  return command.name;
}

namespace {

constexpr char kMark = '+';

bool is_repeated(const Case& command) {
  return command.kind == Case::Kind::attack || command.kind == Case::Kind::evaluate;
}

/// With another seed, and on the runs of that; pictures are made once.
Case repeated(const Case& command, int number, const ReproduceSettings& settings) {
  Case rerun = command;
  rerun.name = repetition(command.name, number);
  if (command.kind == Case::Kind::evaluate)
    for (auto& [folder, need] : rerun.needs)
      if (folder != "data") need = repetition(need, number);
  rerun.settings.erase("pictures");
  rerun.settings["seed"] = std::to_string(settings.seed + static_cast<std::uint64_t>(number));
  return rerun;
}

}  // namespace

std::string repetition(const std::string& name, int number) {
  return number == 0 ? name : fmt::format("{}{}{}", name, kMark, number);
}

bool is_repetition(const std::string& name) {
  return name.find(kMark) != std::string::npos;
}

void repeat(Experiments& experiments, const ReproduceSettings& settings) {
  experiments.seeds = settings.seeds;
  const std::size_t once = experiments.cases.size();
  for (int number = 1; number < settings.seeds; ++number)
    for (std::size_t i = 0; i < once; ++i)
      if (is_repeated(experiments.cases[i]))
        experiments.cases.push_back(repeated(experiments.cases[i], number, settings));
}

}  // namespace mirage::paper
