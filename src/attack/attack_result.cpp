#include "attack/attack_result.h"

namespace mirage {

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
                         {"buildable", fields_json(result.buildable)},
                         {"plateau", nullptr}};
  if (result.plateau) json["plateau"] = fields_json(*result.plateau);
  if (result.black_box) json["black_box"] = fields_json(*result.black_box);
  if (result.automatic) json["auto"] = fields_json(*result.automatic);
  return json;
}

}  // namespace mirage
