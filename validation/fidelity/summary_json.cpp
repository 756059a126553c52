// The summary as result.json has it.
#include "base/fields.h"
#include "validation/fidelity/summary.h"

namespace mirage {
namespace {

using nlohmann::json;

json change_figures(const MeanChange& change) {
  json out = {
      {"mae", change.mae}, {"relative", change.relative}, {"ssim", change.ssim}, {"flip", change.flip}};
  if (change.psnr) out["psnr"] = *change.psnr;
  return out;
}

json error_figures(const PooledError& error) {
  return {{"error_plain", error.plain},          {"floor", error.floor},
          {"error_drawn", error.drawn},          {"error_unbiased", error.unbiased.value},
          {"interval", to_json(error.unbiased)}, {"interval_over", to_word(error.over)}};
}

json rung_figures(const RungSummary& rung) {
  json out = {{"effect", rung.effect},
              {"vehicles", rung.vehicles},
              {"detected", rung.detected},
              {"hidden", rung.hidden},
              {"false_positive", rung.false_positive},
              {"fn_asr", rung.fn_asr},
              {"asr", rung.asr},
              {"mean_score", rung.mean_score},
              {"score_change", rung.score_change},
              {"seconds", rung.seconds}};
  if (rung.logit) out["logit"] = *rung.logit;
  return out;
}

json light_figures(const LightRungSummary& rung) {
  json out = rung_figures(rung);
  out.update(change_figures(rung.change));
  out.update(error_figures(rung.error));
  out.update({{"crop", change_figures(rung.crop)}, {"to_full", change_figures(rung.to_full)}});
  if (!rung.group.empty()) out["group"] = rung.group;
  if (!rung.base.empty()) out["base"] = rung.base;
  return out;
}

json lidar_figures(const LidarRungSummary& rung) {
  json out = rung_figures(rung);
  out.update({{"returns", rung.returns}, {"changed", rung.changed}, {"returns_change", rung.returns_change}});
  return out;
}

json full_figures(const FullSummary& full) {
  json out = change_figures(full.change);
  out["seconds"] = full.seconds;
  if (full.error) out.update(error_figures(*full.error));
  return out;
}

json matched_figures(const MatchedSummary& m) {
  return {{"mask_iou", m.mask_iou},
          {"mask_iou_worst", m.mask_iou_worst},
          {"mae", m.mae},
          {"max_error", m.max_error},
          {"depth_error_m", m.depth_error},
          {"pixels", m.pixels},
          {"pixels_off", m.pixels_off},
          {"range_error_m", m.range_error},
          {"hit_disagreements", m.hit_disagreements},
          {"rays", m.rays},
          {"returns", m.returns}};
}

json fooled_figures(const FooledSummary& fooled) {
  return {{"detected_clean", fooled.detected_clean},
          {"hidden_raster", fooled.hidden_raster},
          {"hidden_cycles", fooled.hidden_cycles},
          {"hidden_both", fooled.hidden_both},
          {"fn_asr_raster", fooled.share(fooled.hidden_raster)},
          {"fn_asr_cycles", fooled.share(fooled.hidden_cycles)},
          {"asr_raster", fooled.share(fooled.fooled_raster)},
          {"asr_cycles", fooled.share(fooled.fooled_cycles)}};
}

}  // namespace

json to_json(const ValidationSummary& summary) {
  auto light = json::array(), lidar = json::array();
  for (const LightRungSummary& rung : summary.ladder) light.push_back(light_figures(rung));
  for (const LidarRungSummary& rung : summary.lidar_ladder) lidar.push_back(lidar_figures(rung));
  return {{"frames", summary.frames},
          {"test_frames", summary.test_frames},
          {"vehicles", summary.vehicles},
          {"rooftops", to_json(summary.rooftops)},
          {"matched", matched_figures(summary.matched)},
          {"full", full_figures(summary.full)},
          {"noise", summary.noise},
          {"ladder", light},
          {"lidar_ladder", lidar},
          {"attack", fooled_figures(summary.attack)},
          {"attack_train", fooled_figures(summary.attack_train)}};
}

}  // namespace mirage
