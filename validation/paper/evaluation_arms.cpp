#include "validation/paper/evaluation_arms.h"

#include "validation/paper/repetitions.h"

namespace mirage::paper {
namespace {

using nlohmann::json;

/// "kitti64" of "kitti64-fusion-both--on--xenith-fusion-both": "xenith", whose frames they are.
std::string rig_of(const std::string& arm) {
  const std::size_t on = arm.find("--on--");
  const std::string judged = on == std::string::npos ? arm : arm.substr(on + 6);
  return judged.substr(0, judged.find('-'));
}

json rates_json(const Outcomes& outcomes) {
  json rates;
  for (const HidingRule& rule : kHidingRules) {
    const auto share = hiding(outcomes, rule);
    rates[rule.name] = share ? to_json(*share) : json();
    if (share) rates[rule.name]["vehicles"] = found_clean(outcomes, rule);
  }
  return rates;
}

json net_json(const Outcomes& learned, const Outcomes& sized) {
  json net;
  for (const HidingRule& rule : kHidingRules)
    net[rule.name] = hiding(learned, rule) ? to_json(hiding_difference(learned, sized, rule)) : json();
  return net;
}

}  // namespace

json arms_json(const Experiments& experiments, const ReproduceSettings& settings, const Evidence& evidence) {
  json list = json::array();
  for (const Case& command : experiments.cases) {
    if (command.kind != Case::Kind::evaluation || is_repetition(command.name)) continue;
    const auto judged = evidence.evaluations.find(command.name);
    if (judged == evidence.evaluations.end()) continue;
    const Case &attack = experiments.at(command.needs.front()), &stage = experiments.at(command.needs.back());
    const std::string name = command.name.substr(command.name.find('/') + 1);
    const Outcomes* sized = judged->second.sized.get();
    for (const auto& [mesh, outcomes] :
         {std::pair("learned", judged->second.learned), std::pair("start", judged->second.random),
          std::pair("sized", judged->second.sized), std::pair("cuboid", judged->second.cuboid)}) {
      if (!outcomes) continue;
      json seeds = json::array();
      for (int run = 0; run < outcomes->runs; ++run)
        seeds.push_back(settings.seed + static_cast<std::uint64_t>(run));
      json arm = {{"name", name},
                  {"detector", argument(attack, "--detector")},
                  {"target", argument(attack, "--target")},
                  {"rig", rig_of(name)},
                  {"judge", argument(command, "--detector", argument(stage, "--detector"))},
                  {"mesh", mesh},
                  {"seeds", seeds},
                  {"vehicles", outcomes->vehicles},
                  {"frames", outcomes->frames()},
                  {"asr", rates_json(*outcomes)},
                  {"fp_asr", to_json(success(*outcomes, is_false_positive))},
                  {"interval",
                   {{"confidence", BootstrapSettings().confidence},
                    {"drawn", outcomes->runs > 1 ? "runs and clusters" : "clusters"}}}};
      if (const std::string defense = argument(attack, "--defense"); !defense.empty())
        arm["defense"] = defense;
      if (outcomes == judged->second.learned && sized) arm["net"] = net_json(*outcomes, *sized);
      list.push_back(std::move(arm));
    }
  }
  return list;
}

}  // namespace mirage::paper
