#include "validation/fidelity/vehicle_result.h"

#include <algorithm>

#include "base/json_fields.h"

namespace mirage {

using nlohmann::json;

void MatchedResult::add(const MatchedResult& other) {
  range_error = std::max(range_error, other.range_error);
  rays += other.rays, returns += other.returns, hit_disagreements += other.hit_disagreements;
  const double own = mask_either, theirs = other.mask_either, all = own + theirs;
  if (theirs == 0) return;
  mask_both += other.mask_both, mask_either += other.mask_either, pixels_off += other.pixels_off;
  mask_iou = own == 0 ? other.mask_iou : mask_both / all;
  mae = own == 0 ? other.mae : (own * mae + theirs * other.mae) / all;
  depth_error_mean =
      own == 0 ? other.depth_error_mean : (own * depth_error_mean + theirs * other.depth_error_mean) / all;
  max_error = std::max(max_error, other.max_error);
  depth_error = std::max(depth_error, other.depth_error);
}

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
  if (seen.conditions && seen.conditions->conditions.empty()) from.fail("arms", "has no entries");
  if (seen.surround && seen.surround->cameras.empty()) from.fail("cameras", "has no entries");
  if (seen.ladder && seen.detected)
    for (const LightRungResult& rung : seen.ladder->light)
      if (!rung.outcome) from.fail("ladder", rung.effect + " has no score");
  for (const char* part : {"bev", "picture_boxes", "host_rect", "crop_rect"})
    if (raw.contains(part)) vehicle.shown[part] = raw.at(part);
  return vehicle;
}

}  // namespace mirage
