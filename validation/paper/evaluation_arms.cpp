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

HidingRates rates(const Outcomes& outcomes) {
  const auto of = [&](std::size_t rule) -> std::optional<HidingRate> {
    const auto share = hiding(outcomes, kHidingRules[rule]);
    if (!share) return std::nullopt;
    return HidingRate{*share, found_clean(outcomes, kHidingRules[rule])};
  };
  return {*of(0), *of(1), *of(2), of(3), of(4)};
}

/// The learned mesh's, where it has a control of its size.
void add_net(Arm& arm, const Outcomes& learned, const Outcomes& sized) {
  auto& net = arm.net.emplace();
  for (std::size_t i = 0; i < net.size(); ++i)
    if (hiding(learned, kHidingRules[i])) net[i] = hiding_difference(learned, sized, kHidingRules[i]);
}

}  // namespace

std::vector<Arm> evaluation_arms(const Experiments& experiments, const ReproduceSettings& settings,
                                 const Evidence& evidence) {
  std::vector<Arm> list;
  for (const Case& command : experiments.cases) {
    if (command.kind != Case::Kind::evaluate || is_repetition(command.name)) continue;
    const auto found = evidence.evaluations.find(command.name);
    if (found == evidence.evaluations.end()) continue;
    const Judged& judged = found->second;
    const Case &attack = experiments.at(command.run()), &stage = experiments.at(command.hosts_of());
    for (const auto& [mesh, outcomes] :
         {std::pair("learned", judged.learned), std::pair("start", judged.random),
          std::pair("sized", judged.sized), std::pair("cuboid", judged.cuboid)}) {
      if (!outcomes) continue;
      Arm arm;
      arm.name = command.name.substr(command.name.find('/') + 1);
      arm.detector = attack.setting("detector");
      arm.target = attack.setting("target");
      arm.defense = attack.setting("defense");
      arm.parts = attack.setting("parts");
      arm.rig = rig_of(arm.name);
      arm.judge = command.setting("detector", stage.setting("detector"));
      arm.mesh = mesh;
      for (int run = 0; run < outcomes->runs; ++run)
        arm.seeds.push_back(settings.seed + static_cast<std::uint64_t>(run));
      arm.vehicles = outcomes->vehicles;
      arm.frames = outcomes->frames();
      arm.hiding = rates(*outcomes);
      if (outcomes == judged.learned && judged.sized) add_net(arm, *outcomes, *judged.sized);
      arm.false_positives = success(*outcomes, is_false_positive);
      list.push_back(std::move(arm));
    }
  }
  return list;
}

json to_json(const Arm& arm) {
  json result = {
      {"name", arm.name},
      {"detector", arm.detector},
      {"target", arm.target},
      {"rig", arm.rig},
      {"judge", arm.judge},
      {"mesh", arm.mesh},
      {"seeds", arm.seeds},
      {"vehicles", arm.vehicles},
      {"frames", arm.frames},
      {"hidden", to_json(arm.hiding)},
      {"fp_asr", to_json(arm.false_positives)},
      {"interval",
       {{"confidence", kConfidence}, {"drawn", arm.seeds.size() > 1 ? "runs and clusters" : "clusters"}}}};
  if (!arm.defense.empty()) result["defense"] = arm.defense;
  if (!arm.parts.empty()) result["parts"] = arm.parts;
  if (arm.net)
    for (std::size_t i = 0; i < arm.net->size(); ++i) {
      const auto& net = (*arm.net)[i];
      result["net"][kHidingRules[i].name] = net ? to_json(*net) : json();
    }
  return result;
}

}  // namespace mirage::paper
