// The verdict as result.json has it.
#include "base/field_json.h"
#include "detection/reliance.h"
#include "validation/fidelity/verdict.h"

namespace mirage {
namespace {

using nlohmann::json;

json share_figures(const SuccessShares& shares) {
  return {
      {"fn_asr", to_json(shares.fn_asr)}, {"fp_asr", to_json(shares.fp_asr)}, {"asr", to_json(shares.asr)}};
}

json success_figures(const Success& success) {
  json out = share_figures(success);
  out.update({{"vehicles", success.vehicles}, {"mean_score", success.mean_score}});
  return out;
}

template <class Look>
json compared_figures(const std::vector<Compared<Look>>& all) {
  return list_json(all, [](const Compared<Look>& entry) {
    json out = success_figures(entry);
    out.update(fields_json(entry.look));
    if (entry.difference)
      out.update({{"difference", to_json(*entry.difference)}, {"told", to_string(told(*entry.difference))}});
    out.update({{"flips", entry.flips},
                {"mean_delta_logit", entry.mean_delta_logit},
                {"mean_delta_score", entry.mean_delta_score}});
    return out;
  });
}

json group_figures(const VerdictGroup& group) {
  auto variants = list_json(group.variants, [](const VerdictVariant& variant) {
    json out = success_figures(variant);
    out["name"] = variant.name;
    return out;
  });
  return {{"frames", group.frames},
          {"vehicles", group.vehicles},
          {"clusters", to_json(group.clusters)},
          {"variants", std::move(variants)},
          {"arms", compared_figures(group.arms)},
          {"difference", share_figures(group.difference)},
          {"told", to_string(told(group.difference.asr))},
          {"agree", group.agree},
          {"score_correlation", group.score_correlation ? json(*group.score_correlation) : json()},
          {"score_mean_difference", group.score_mean_difference}};
}

const char* split(bool held_back) {
  return held_back ? "test" : "train";
}

json pair_figures(const ScorePair& pair) {
  return {{"name", pair.name},         {"frame", pair.frame},  {"split", split(pair.held_back)},
          {"detected", pair.detected}, {"clean", pair.clean},  {"soft", pair.soft},
          {"hard", pair.hard},         {"cycles", pair.cycles}};
}

json flip_figures(const VerdictFlip& flip) {
  const auto word = [](const OutcomeResult& outcome) { return outcome.hidden ? "hidden" : "found"; };
  return {{"name", flip.name},
          {"frame", flip.frame},
          {"split", split(flip.held_back)},
          {"range", flip.range},
          {"from", word(flip.soft)},
          {"to", word(flip.cycles)},
          {"soft_iou", flip.soft.iou},
          {"soft_score", flip.soft.score},
          {"cycles_iou", flip.cycles.iou},
          {"cycles_score", flip.cycles.score},
          {"pictures", flip.pictures}};
}

json truth(const std::optional<bool>& known) {
  return known ? json(*known) : json();
}

}  // namespace

json to_json(const Verdict& verdict) {
  return {{"confidence", kConfidence},
          {"held_back", group_figures(verdict.held_back)},
          {"all", group_figures(verdict.all)},
          {"pairs", list_json(verdict.pairs, pair_figures)},
          {"flips", list_json(verdict.flips, flip_figures)},
          {"of", &verdict.judged() == &verdict.held_back ? "held_back" : "all"},
          {"arms", compared_figures(verdict.judged().arms)},
          {"controls", compared_figures(verdict.controls)},
          {"vacuous",
           {{"image", truth(verdict.vacuous(Channel::image))},
            {"lidar", truth(verdict.vacuous(Channel::lidar))},
            {"bound", kLeastDeltaLogit}}}};
}

}  // namespace mirage
