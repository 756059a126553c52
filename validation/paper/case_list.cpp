#include "validation/paper/case_list.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "attack/attack_settings.h"
#include "attack/objective.h"

namespace mirage::paper {
namespace {

using Words = std::vector<std::string>;

/// "jpeg:50" as part of a folder's name.
std::string in_a_name(std::string defense) {
  std::erase(defense, ':');
  return defense;
}

/// "fusion-both" of "runs/kitti64-fusion-both".
std::string last_part(const std::string& name) {
  return name.substr(name.find('/') + 1);
}

}  // namespace

Words CaseList::beside(const std::string& baselines) const {
  return {"--random-meshes", std::to_string(settings_.random_meshes), "--baseline", baselines};
}

std::string CaseList::attack(const std::string& rig, const std::string& detector, const std::string& target,
                             double size, const std::string& defense) {
  std::string name = fmt::format("runs/{}-{}-{}", rig, detector, target);
  const AttackSettings recipe;
  Words arguments = {"attack",
                     "--data",
                     data(rig).string(),
                     "--detector",
                     detector,
                     "--target",
                     target,
                     "--iterations",
                     std::to_string(settings_.iterations),
                     "--batch",
                     std::to_string(recipe.batch),
                     "--vertex-rate",
                     fmt::format("{}", recipe.vertex_rate),
                     "--texel-rate",
                     fmt::format("{}", recipe.texel_rate),
                     "--fp-top-k",
                     std::to_string(kFpTopK),
                     "--lidar-gradient",
                     to_word(LidarGradient::silhouette),
                     "--seed",
                     std::to_string(settings_.seed)};
  if (size > 0) {
    name += fmt::format("-size{:.1f}", size);
    arguments.insert(arguments.end(), {"--size", fmt::format("{:.1f}", size)});
  }
  if (!defense.empty()) {
    name += fmt::format("-{}", in_a_name(defense));
    arguments.insert(arguments.end(), {"--defense", defense});
  }
  return add({name, Case::Kind::attack, arguments, data_case(rig)});
}

std::string CaseList::evaluate(const std::string& run, bool start, bool pictures) {
  Words arguments = {"evaluate", "--run", folder(run)};
  for (auto& word : beside(start ? "start,sized,cuboid" : "sized")) arguments.push_back(std::move(word));
  if (pictures) arguments.insert(arguments.end(), {"--pictures", std::to_string(settings_.pictures)});
  return add({"evaluations/" + last_part(run), Case::Kind::evaluation, arguments, {run}});
}

std::string CaseList::transfer(const std::string& from, const std::string& onto) {
  Words arguments = {"evaluate", "--run", folder(from), "--hosts-of", folder(onto)};
  for (auto& word : beside("sized")) arguments.push_back(std::move(word));
  return add({fmt::format("evaluations/{}--on--{}", last_part(from), last_part(onto)),
              Case::Kind::evaluation,
              arguments,
              {from, onto}});
}

std::string CaseList::on_real(const std::string& run, const std::string& detector, bool cuboid) {
  Words arguments = {"evaluate",   "--run", folder(run), "--data", data("real").string(),
                     "--detector", detector};
  for (auto& word : beside(cuboid ? "sized,cuboid" : "sized")) arguments.push_back(std::move(word));
  return add({fmt::format("evaluations/{}--on--real-{}", last_part(run), detector),
              Case::Kind::evaluation,
              arguments,
              {run}});
}

std::string CaseList::detect(const std::string& rig, const std::string& detector,
                             const std::string& defense) {
  std::string name = fmt::format("detect/{}-{}", rig, detector);
  Words arguments = {"detect", "--data", data(rig).string(), "--detector", detector};
  if (!defense.empty()) {
    name += fmt::format("-{}", in_a_name(defense));
    arguments.insert(arguments.end(), {"--defense", defense});
  }
  return add({name, Case::Kind::detection, arguments, data_case(rig)});
}

Words CaseList::data_case(const std::string& rig) {
  if (rig == "real" || !(rig == "kitti64" ? settings_.kitti64 : settings_.xenith).empty()) return {};
  return {add({"data/" + rig,
               Case::Kind::data,
               {"generate", "--rig", rig, "--frames", std::to_string(settings_.frames), "--seed", "3"},
               {}})};
}

std::string CaseList::add(Case command) {
  const auto known =
      std::find_if(cases.begin(), cases.end(), [&](const Case& c) { return c.name == command.name; });
  if (known == cases.end())
    cases.push_back(command);
  else if (known->arguments != command.arguments || known->needs != command.needs)
    throw std::logic_error("two cases named " + command.name);
  return command.name;
}

}  // namespace mirage::paper
