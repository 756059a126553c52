#include "validation/fidelity/vehicle_result.h"

#include "base/field_json.h"

namespace mirage {

using nlohmann::json;

json to_json(const VehicleResult& vehicle) {
  json out = vehicle.shown;
  out.update(fields_json(vehicle));
  out.update({{"frame", vehicle.host.frame}, {"label", vehicle.host.label}});
  return out;
}

VehicleResult read_vehicle(const std::filesystem::path& file, const json& raw) {
  const JsonFields from(file, raw, "delete the file; it is made again");
  VehicleResult vehicle;
  vehicle.host = {from.text("frame"), from.count("label")};
  read_fields(from, vehicle);
  if (!vehicle.seen) return vehicle;
  const SeenResult& seen = *vehicle.seen;
  if (seen.arms && seen.arms->arms.empty()) from.fail("arms", "has no entries");
  if (seen.ladder && seen.detected)
    for (const LightRungResult& rung : seen.ladder->light)
      if (!rung.outcome) from.fail("ladder", rung.effect + " has no score");
  for (const char* part : {"bev", "picture_boxes", "host_rect", "crop_rect"})
    if (raw.contains(part)) vehicle.shown[part] = raw.at(part);
  return vehicle;
}

}  // namespace mirage
