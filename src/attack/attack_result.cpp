#include "attack/attack_result.h"

namespace mirage {

nlohmann::json to_json(const PlateauReport& report) {
  return {{"stopped", report.stopped},
          {"best_iteration", report.best_iteration},
          {"best", report.best},
          {"kept_iteration", report.kept_iteration},
          {"vehicles", report.vehicles},
          {"frames", report.frames},
          {"steps", report.steps},
          {"every", report.every},
          {"iterations", report.iterations},
          {"values", report.values}};
}

nlohmann::json to_json(const AutoReport& report) {
  auto candidates = nlohmann::json::array(), starts = nlohmann::json::array();
  for (const AutoReport::Candidate& c : report.candidates)
    candidates.push_back({{"start", c.start},
                          {"target", to_word(c.target)},
                          {"vertex_rate", c.vertex_rate},
                          {"texel_rate", c.texel_rate},
                          {"seed", c.seed},
                          {"steps", c.steps},
                          {"rounds", c.rounds},
                          {"held_out", c.held_out},
                          {"kept_iteration", c.kept_iteration}});
  for (const AutoReport::Start& start : report.starts)
    starts.push_back({{"start", start.name}, {"held_out", start.held_out}});
  const AutoReport::Search& search = report.search;
  return {{"candidates", candidates},
          {"chosen", report.chosen},
          {"starts", starts},
          {"search",
           {{"generations", search.generations},
            {"shapes", search.values.size()},
            {"vehicles", search.vehicles},
            {"steps", search.steps},
            {"values", search.values}}},
          {"vehicles", report.vehicles},
          {"steps", report.steps}};
}

nlohmann::json to_json(const BlackBoxReport& report) {
  auto starts = nlohmann::json::array();
  for (const AutoReport::Start& start : report.starts)
    starts.push_back({{"start", start.name}, {"loss", start.held_out}});
  return {{"vehicles", report.vehicles},
          {"queries", report.queries},
          {"numbers", report.numbers},
          {"samples", report.samples},
          {"generations", report.generations},
          {"starts", starts},
          {"start", report.start},
          {"loss", report.loss}};
}

nlohmann::json to_json(const AttackResult& result) {
  nlohmann::json json = {{"attack", to_word(result.attack)},
                         {"vehicles_train", result.vehicles_train},
                         {"vehicles_test", result.vehicles_test},
                         {"found_clean", to_json(result.found_clean)},
                         {"clusters", to_json(result.clusters)},
                         {"rooftops", to_json(result.rooftops)},
                         {"iterations", result.iterations},
                         {"loss", result.loss},
                         {"seconds_per_iteration", result.seconds_per_iteration},
                         {"stages", result.stages},
                         {"placement", text_of(result.placement)},
                         {"placed", to_json(result.placement)},
                         {"left_out", to_json(result.left_out)},
                         {"buildable", to_json(result.buildable)},
                         {"plateau", nullptr}};
  if (result.plateau) json["plateau"] = to_json(*result.plateau);
  if (result.black_box) json["black_box"] = to_json(*result.black_box);
  if (result.automatic) json["auto"] = to_json(*result.automatic);
  return json;
}

}  // namespace mirage
