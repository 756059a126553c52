#include "detection/reliance.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>

#include "base/error.h"

namespace mirage {

Reliance no_camera() {
  Reliance blind;
  blind.reads_picture = false;
  return blind;
}

Reliance reliance_of(const Audit& audit) {
  using Kind = AuditChange::Kind;
  Reliance result;
  result.frames = audit.frames;
  result.left_out = audit.left_out;
  result.vehicles = audit.vehicles;
  result.clusters = audit.clusters;
  result.ap70 = audit.ap70;
  if (const AuditRow* swapped = audit.row(Kind::other_picture)) {
    result.ap70_swapped = swapped->ap70;
    result.drop = swapped->drop;
    result.mean_delta_logit = swapped->delta_logit.value;
    result.delta_logit_high = swapped->delta_logit.high;
    result.mean_delta_score = swapped->delta_score;
  }
  if (const AuditRow* black = audit.row(Kind::black_picture)) result.ap70_black = black->ap70;
  if (const AuditRow* none = audit.row(Kind::no_picture); none && none->refused.empty())
    result.ap70_none = none->ap70;
  return result;
}

Reliance measure_reliance(std::span<Detector* const> detectors, const RecordedFrames& source,
                          const std::vector<std::string>& ids,
                          const std::function<void(std::size_t, std::size_t)>& progress,
                          std::map<std::string, std::vector<Detection>>* seen) {
  if (!detectors.front()->capabilities().reads_image) return no_camera();
  Audit audit = run_audit(detectors, source, ids, gate_changes(), {}, 0, progress);
  if (seen) *seen = std::move(audit.as_recorded);
  return reliance_of(audit);
}

std::string picture_note(const Reliance& reliance) {
  if (reliance.uses_picture()) return "";
  if (!reliance.reads_picture) return "this detector has no picture input, so this says nothing about images";
  if (reliance.vehicles == 0)
    return "whether this detector uses its picture cannot be measured here, so this says nothing about "
           "images";
  if (reliance.ap70 <= 0)
    return "this detector finds no vehicle as recorded, so this says nothing about images";
  if (!reliance.ignores_picture())
    return fmt::format(
        "whether this detector uses its picture cannot be told from {} cars in {} frames, so this says "
        "nothing about images",
        reliance.vehicles, reliance.frames);
  return "this detector does not use its picture, so this says nothing about images";
}

std::string describe(const Reliance& reliance) {
  if (!reliance.reads_picture) return "no camera";
  return fmt::format(
      "AP 0.7 {:.1f} % with the right picture, {:.1f} % with another frame's: {} points; logits of cars move "
      "by {:.2f}",
      100 * reliance.ap70, 100 * reliance.ap70_swapped, signed_points(reliance.drop),
      reliance.mean_delta_logit);
}

nlohmann::json to_json(const Reliance& reliance) {
  nlohmann::json json = {{"reads_picture", reliance.reads_picture},
                         {"uses_picture", reliance.uses_picture()},
                         {"note", picture_note(reliance)}};
  if (!reliance.reads_picture) return json;
  json.update({{"ap70", reliance.ap70},
               {"ap70_swapped", reliance.ap70_swapped},
               {"ap70_black", reliance.ap70_black},
               {"drop", reliance.drop.value},
               {"drop_low", reliance.drop.low},
               {"drop_high", reliance.drop.high},
               {"mean_delta_logit", reliance.mean_delta_logit},
               {"mean_delta_score", reliance.mean_delta_score},
               {"frames", reliance.frames},
               {"frames_left_out", reliance.left_out},
               {"vehicles", reliance.vehicles},
               {"clusters", to_json(reliance.clusters)}});
  if (std::isfinite(reliance.delta_logit_high)) json["delta_logit_high"] = reliance.delta_logit_high;
  if (reliance.ap70_none) json["ap70_none"] = *reliance.ap70_none;
  return json;
}

Reliance reliance_from_json(const JsonFields& fields) {
  Reliance reliance;
  reliance.reads_picture = fields.truth("reads_picture");
  if (!reliance.reads_picture) return reliance;
  constexpr double kOne = 1 + 1e-9;  // rounded
  const auto share = [&](const char* key) { return fields.number(key, -kOne, kOne); };
  reliance.ap70 = share("ap70");
  reliance.ap70_swapped = share("ap70_swapped");
  reliance.ap70_black = share("ap70_black");
  if (fields.has("ap70_none")) reliance.ap70_none = share("ap70_none");
  reliance.drop = {share("drop"), share("drop_low"), share("drop_high")};
  reliance.mean_delta_logit = fields.number("mean_delta_logit", 0, 1e9);
  reliance.delta_logit_high = fields.has("delta_logit_high") ? fields.number("delta_logit_high", 0, 1e9)
                                                             : std::numeric_limits<double>::infinity();
  reliance.mean_delta_score = share("mean_delta_score");
  reliance.frames = fields.count("frames");
  reliance.left_out = fields.count("frames_left_out");
  reliance.vehicles = fields.count("vehicles");
  reliance.clusters = cluster_count_from_json(fields.object("clusters"));
  return reliance;
}

}  // namespace mirage
