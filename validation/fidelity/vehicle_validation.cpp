#include "validation/fidelity/vehicle_validation.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <utility>

#include "attack/host_outcome.h"
#include "attack/observation.h"
#include "base/image.h"
#include "base/random.h"
#include "base/sizes.h"
#include "detection/average_precision.h"
#include "detection/detect.h"
#include "detection/reliance.h"
#include "exchange/gltf.h"
#include "simulation/adversary_lidar.h"
#include "validation/fidelity/picture_errors.h"

namespace mirage {
namespace {

Sweep sweep_with(const HostScene& scene, const LidarEffects& effects) {
  SimulationSettings settings = scene.simulation;
  settings.lidar_effects = effects;
  Simulated simulated;
  draw_in_lidar(*scene.prepared, scene.placed, settings, simulated);
  return std::move(simulated.sweep);
}

Simulated drawn_under(const HostScene& scene, const Simulated& attacked, LightModel light) {
  if (scene.simulation.light == light) return attacked;
  SimulationSettings settings = scene.simulation;
  settings.light = light;
  return simulate_host(scene, settings);
}

using nlohmann::json;
namespace fs = std::filesystem;

constexpr double kBevReach = 16;  // m around the host that the report's bird's-eye view shows

json box_json(const BevBox& b) {
  return {b.x, b.y, b.length, b.width, b.yaw};
}

json box_json(const PictureBox& b) {
  return {b.left, b.top, b.right, b.bottom};
}

/// Empty for a detector without boxes there.
json boxes_json(const std::vector<Detection>& proposals, bool in_picture, Matching judged_by) {
  auto list = json::array();
  if (in_picture != judged_by.in_picture()) return list;
  for (const Detection& p : proposals)
    list.push_back({{"box", in_picture ? box_json(p.picture) : box_json(p.box.bev)}, {"score", p.score()}});
  return list;
}

/// The detector's response to a view: its detections, and the logit of the host's proposal
/// (detection/reliance.h), which also exists below the detection threshold.
struct ViewResponse {
  std::vector<Detection> found;
  double logit = 0;
};

ViewResponse evaluate_view(Detector& detector, const SensorView& view, const ObjectBoxes& host,
                           const EvaluationSettings& settings) {
  std::vector<Detection> proposals =
      detector.forward(view, std::min(kFaintScore, settings.score_threshold), false);
  const double logit = matching_proposal(proposals, host, settings.matching).logit;
  std::erase_if(proposals,
                [&](const Detection& proposal) { return !(proposal.score() > settings.score_threshold); });
  return {suppress(std::move(proposals), settings.matching), logit};
}

/// A look judged.
struct Judged {
  HostOutcome outcome;
  double logit = 0;
  OutcomeResult result() const {
    return {outcome.attacked_iou, outcome.attacked_score, logit, outcome.hidden, outcome.false_positive};
  }
};

json bev_json(const PreparedFrame& prepared, const Label& host, const Simulated& simulated,
              const HostOutcome& raster, const HostOutcome& cycles) {
  const auto near_host = [&](double x, double y) {
    return std::abs(x - host.box.bev.x) <= kBevReach && std::abs(y - host.box.bev.y) <= kBevReach;
  };
  auto measured = json::array(), added = json::array(), truth = json::array();
  const auto millimetres = [](float value) { return std::round(1000.0 * value) / 1000; };
  const std::size_t first = simulated.sweep.size() - as_size(simulated.adversary_points);
  for (std::size_t i = 0; i < simulated.sweep.size(); ++i) {
    const LidarPoint& p = simulated.sweep[i];
    if (near_host(p.x, p.y)) (i < first ? measured : added).push_back({millimetres(p.x), millimetres(p.y)});
  }
  for (const Label& label : prepared.frame.labels)
    if (is_road_user(label) && has_box(label)) truth.push_back(box_json(label.box.bev));
  return {{"host", box_json(host.box.bev)},
          {"reach", kBevReach},
          {"points", measured},
          {"adversary_points", added},
          {"truth", truth},
          {"clean", boxes_json(raster.clean, false, raster.matching)},
          {"raster", boxes_json(raster.attacked, false, raster.matching)},
          {"cycles", boxes_json(cycles.attacked, false, raster.matching)}};
}

/// Boxes in the picture, for a detector that is judged there.
json picture_json(const Frame& frame, const Label& host, const std::optional<PictureBox>& object,
                  const HostOutcome& raster, const HostOutcome& cycles) {
  auto truth = json::array();
  for (const Label& label : frame.labels) truth.push_back(box_json(picture_box(label)));
  return {{"host", box_json(picture_box(host))},
          {"object", object ? box_json(*object) : json()},
          {"truth", truth},
          {"clean", boxes_json(raster.clean, true, raster.matching)},
          {"raster", boxes_json(raster.attacked, true, raster.matching)},
          {"cycles", boxes_json(cycles.attacked, true, raster.matching)}};
}

/// |a − b| of the encoded pictures, times `gain`.
ImageF difference(const ImageF& a, const ImageF& b, float gain) {
  ImageF out = encoded(a);
  const ImageF other = encoded(b);
  // write_srgb encodes once more; the picture is for the eye only, so undo nothing.
  for (std::size_t i = 0; i < out.data.size(); ++i)
    out.data[i] = std::min(1.0f, gain * std::abs(out.data[i] - other.data[i]));
  return out;
}

/// One camera's view of the vehicle, drawn by Mirage and by the reference.
struct DrawnView {
  std::size_t camera = 0;
  std::optional<PreparedFrame> turned;  ///< its frame, where it is not the first camera
  HostScene scene;                      ///< in that frame
  Simulated simulated;
  MatchedLight matched;
  FullLight full;

  FullResult full_result() const {
    const ImageF seen_raster = encoded(full.raster), seen_cycles = encoded(full.cycles);
    FullResult result;
    result.mae = mean_absolute_error(full.raster, full.cycles, full.mask);
    result.mean = mean_of(full.cycles, full.mask);
    result.ssim = ssim(grey(seen_raster), grey(seen_cycles), full.mask);
    result.flip = flip(seen_cycles, seen_raster, full.mask);
    result.noise = noise_of(full.radiance, full.mask, full.samples / 2).at(full.samples);
    result.seconds = full.seconds;
    result.error = raster_error(scene, simulated, full);
    return result;
  }
};

/// Cameras that see the object: the one that its host's label is in first, else the one that shows most.
std::vector<std::size_t> cameras_seeing(const Simulated& simulated, const Label& host) {
  std::vector<std::size_t> cameras;
  for (std::size_t k = 0; k <= simulated.others.size(); ++k)
    if (!simulated.sight(k).rect.empty()) cameras.push_back(k);
  const auto own = as_size(host.camera);
  std::stable_sort(cameras.begin(), cameras.end(), [&](std::size_t a, std::size_t b) {
    if (a == own || b == own) return a == own && b != own;
    return simulated.sight(a).visible_share > simulated.sight(b).visible_share;
  });
  return cameras;
}

/// With the object; they live as long as `simulated`.
Pictures pictures_of(const Simulated& simulated) {
  Pictures pictures = {&simulated.image};
  for (const CameraSight& other : simulated.others)
    pictures.push_back(other.image.empty() ? nullptr : &other.image);
  return pictures;
}

/// `photograph` with noise in place of the object in `camera`, as far as its silhouette covers each pixel.
ImageF noise_in_place(const CameraSight& seen, const ImageF& photograph, std::uint64_t seed,
                      std::size_t camera) {
  ImageF image = photograph;
  RandomStream random(seed, "noise in the object's place", camera);
  for (int v = seen.rect.v0; v < seen.rect.v1; ++v)
    for (int u = seen.rect.u0; u < seen.rect.u1; ++u) {
      const double covered = rgba_at(seen, u, v, 3);
      for (int c = 0; c < image.channels; ++c)
        image.at(u, v, c) =
            static_cast<float>((1 - covered) * image.at(u, v, c) + covered * random.uniform());
    }
  return image;
}

/// The ladders of light (in one camera) and LiDAR, each rung with the detector's outcome, and the features by
/// which a budget chooses (budget.h).
template <class Outcome>
LadderResult ladders(ReferenceRenderer& renderer, const DrawnView& at, const Simulated& simulated,
                     const Outcome& outcome) {
  const auto& [camera, turned, scene, drawn, matched, full] = at;
  LadderResult result;
  LightLadder light = light_ladder(renderer, scene, full);
  result.reference = light.reference;
  result.features = scene_features(scene, drawn);
  for (LadderRung& rung : light.rungs) {
    const ImageF picture = with_window(scene.prepared->frame.image, rung.picture, full.rect);
    Pictures pictures = pictures_of(simulated);
    pictures[camera] = &picture;
    rung.outcome = outcome(pictures, simulated.sweep);
    result.light.push_back(rung);
  }
  for (LidarRung& rung : lidar_ladder(scene)) {
    rung.outcome = outcome(pictures_of(simulated), rung.sweep);
    result.lidar.push_back(rung);
  }
  return result;
}

}  // namespace

VerdictResults evaluate_conditions(const HostScene& scene, const Simulated& attacked,
                                   const Simulated& learned, const Pictures& cycles,
                                   const ViewEvaluator& evaluate) {
  const Frame& frame = scene.prepared->frame;
  const Sweep ideal = sweep_with(scene, {}), realistic = sweep_with(scene, realistic_returns(scene));
  const Simulated raster = drawn_under(scene, attacked, LightModel::plain),
                  visible = drawn_under(scene, attacked, LightModel::visible);
  VerdictResults result;
  result.conditions.push_back(
      {{ConditionLight::learned, ConditionReturns::learned}, evaluate(pictures_of(learned), learned.sweep)});
  const std::pair<ConditionLight, Pictures> lights[] = {{ConditionLight::raster, pictures_of(raster)},
                                                        {ConditionLight::visible, pictures_of(visible)},
                                                        {ConditionLight::cycles, cycles}};
  for (const auto& [light, pictures] : lights) {
    result.conditions.push_back({{light, ConditionReturns::ideal}, evaluate(pictures, ideal)});
    result.conditions.push_back({{light, ConditionReturns::realistic}, evaluate(pictures, realistic)});
  }
  std::vector<ImageF> noise(frame.cameras());
  Pictures noisy(frame.cameras());
  for (std::size_t k = 0; k < frame.cameras(); ++k)
    if (!learned.sight(k).rect.empty()) {
      noise[k] = noise_in_place(learned.sight(k), frame.image_of(k), scene.seed, k);
      noisy[k] = &noise[k];
    }
  const auto control = [&](Channel channel, const char* name, const Pictures& pictures, const Sweep& sweep) {
    result.controls.push_back({{channel, name}, evaluate(pictures, sweep)});
  };
  control(Channel::image, "noise", noisy, learned.sweep);
  control(Channel::image, "photograph", Pictures(frame.cameras()), learned.sweep);
  control(Channel::lidar, "no returns", pictures_of(learned), frame.sweep);
  return result;
}

VehicleResult validate_vehicle(ValidationContext& context, const HostId& id, bool with_ladder) {
  const auto frame_handle = context.store.get(id.frame);
  const PreparedFrame& prepared = *frame_handle;
  const Frame& frame = prepared.frame;
  const fs::path& out = context.settings.out;
  const std::string name = host_name(id);
  const Placement known = context.store.placement(id);
  require_hosted(context.store.place(), known, id);
  // Built once: every renderer and every condition has this object, in this pose.
  const EvaluationSettings& evaluation = context.settings.evaluation_settings;
  const SampledEnvironment draw(evaluation.expectation, evaluation.expectation_seed, draw_of(id));
  const SampledHost built(evaluation.expectation.any() ? &draw : nullptr, prepared, known,
                          context.run.adversary, context.learned);
  HostScene scene =
      scene_of({prepared, id, built.placement(), context.run.settings.simulation}, built.object());
  scene.samples = context.settings.samples;
  scene.seed = context.settings.seed;
  scene.glb = out / "scenes" / (name + ".glb");
  scene.scratch = scratch_folder(out);
  fs::create_directories(scene.scratch);
  ExportScene exported = host_scene(frame, scene.placement, scene.adversary, name);
  write_scene(scene.glb, exported);

  const Simulated simulated = simulate(prepared, scene.placement, scene.adversary, scene.simulation);
  VehicleResult result;
  result.host = id;
  result.name = name;
  result.victim = scene.placement.neighbour.value_or(-1);
  result.from_box = scene.placement.carrier->from_box;
  result.visible_share = simulated.best_share();
  result.adversary_points = simulated.adversary_points;
  const std::vector<std::size_t> cameras = cameras_seeing(simulated, *scene.host);
  if (cameras.empty()) return result;
  SeenResult& seen = result.seen.emplace();
  const std::size_t lost_before = context.renderer.losses().size();
  std::deque<DrawnView> drawn_views;
  for (const std::size_t camera : cameras) {
    DrawnView& at = drawn_views.emplace_back();
    at.camera = camera;
    if (camera > 0) {
      at.scene = facing(scene, at.turned.emplace(facing(prepared, camera)), camera);
      at.scene.glb = scene.scratch / (name + ".glb");
      exported.camera = frame.name_of(camera);
      exported.calibration = frame.calibration_of(camera);
      exported.photograph = {};
      exported.others.clear();
      write_scene(at.scene.glb, exported);
      at.simulated = simulate_host(at.scene, scene.simulation);
    } else {
      at.scene = scene;
      at.simulated = simulated;
    }
    at.matched = matched_light(context.renderer, at.scene);
    if (context.settings.noise > 0 && &at == &drawn_views.front())
      scene.samples =
          samples_for(measure_noise(context.renderer, at.scene, at.simulated), context.settings.noise);
    at.scene.samples = scene.samples;
    at.full = full_light(context.renderer, at.scene, at.simulated);
    seen.matched.add(at.matched);
    if (frame.cameras() > 1) {
      if (!seen.surround) seen.surround.emplace();
      seen.surround->cameras.push_back({frame.name_of(camera), at.matched, at.full_result()});
    }
  }
  const DrawnView& best = drawn_views.front();
  const FullLight& full = best.full;
  seen.matched.add(check_lidar(context.renderer, scene, simulated));
  seen.samples = scene.samples;
  seen.full = seen.surround ? seen.surround->cameras[0].full : best.full_result();
  EvaluationSettings judge_by = context.settings.evaluation_settings;
  judge_by.matching = context.detector.capabilities().matching();
  const EvaluationLabels boxes = labelled_boxes(scene.placement, scene.placed.mesh, frame.calibration,
                                                carried_box(simulated, scene.placement));
  // One look at a frame serves all its hosts, unless it has a plain object in it.
  const auto looked = context.clean.try_emplace(boxes.plain ? host_name(id) : id.frame);
  std::vector<Detection>& clean = looked.first->second;
  if (looked.second)
    clean = clean_of(context.detector, prepared, scene.placement, scene.simulation, judge_by);
  // The detector reuses its results for the recorded frame: pictures differ in the window alone.
  UnchangedInput as_recorded = unchanged_input(prepared, simulated.rect);
  const Simulated learned = simulate(prepared, scene.placement, scene.adversary, built.simulation());
  as_recorded.changed = learned.rect;
  Pictures in_cycles(frame.cameras());
  for (const DrawnView& at : drawn_views) {
    in_cycles[at.camera] = &at.full.image;
    if (at.camera == 0) as_recorded.changed = united(at.full.rect, learned.rect);
  }
  const Label& judged = boxes.own ? *boxes.own : boxes.victim ? scene.placement.targets.front() : *scene.host;
  const ObjectBoxes judged_boxes = boxes_of(judged);
  const auto outcome_of = [&](const Pictures& pictures, const Sweep& sweep) -> Judged {
    const Capabilities can = context.detector.capabilities();
    SensorView view = view_of(prepared, simulated, can);
    view.image = pictures[0] ? pictures[0] : &frame.image;  // null: as recorded, not as attacked
    view.points = sweep;
    std::erase_if(view.others,
                  [](const SensorData& other) { return other.kind == SensorData::Kind::camera; });
    for (std::size_t k = 1; k < frame.cameras(); ++k)
      if (pictures[k] && can.names(frame.name_of(k)))
        view.others.push_back(sensor_beside(frame, k - 1, pictures[k]));
    if (can.why_whole.empty()) view.clean = &as_recorded;
    ViewResponse response = evaluate_view(context.detector, view, judged_boxes, judge_by);
    return {judge(id, frame, clean, std::move(response.found), judge_by, boxes), response.logit};
  };
  const Judged seen_raster_as = outcome_of(pictures_of(simulated), simulated.sweep);
  const Judged seen_cycles_as = outcome_of(in_cycles, simulated.sweep);
  const HostOutcome &raster = seen_raster_as.outcome, &cycles = seen_cycles_as.outcome;
  SimulationSettings hard_edges = hard_limit(scene.simulation, true);
  hard_edges.supersampling = scene.simulation.supersampling;
  const Simulated hard = simulate_host(scene, hard_edges);
  seen.range = raster.range;
  seen.detected = raster.detected;
  seen.clean = {raster.clean_iou, raster.clean_score};
  seen.raster = seen_raster_as.result();
  seen.hard = outcome_of(pictures_of(hard), simulated.sweep).result();
  seen.cycles = seen_cycles_as.result();
  const auto evaluate = [&](const Pictures& pictures, const Sweep& sweep) {
    return outcome_of(pictures, sweep).result();
  };
  if (raster.detected)
    seen.conditions =
        evaluate_conditions(scene, simulated, learned, in_cycles, evaluate);  // else no outcome to change
  if (with_ladder) {
    // If the detector misses the vehicle without the adversary, there is no outcome to change.
    const auto outcome = [&](const Pictures& pictures, const Sweep& sweep) {
      return raster.detected ? std::optional(evaluate(pictures, sweep)) : std::nullopt;
    };
    seen.ladder = ladders(context.renderer, best, simulated, outcome);
  }
  result.shown["bev"] = bev_json(prepared, judged, simulated, raster, cycles);
  if (judge_by.matching.in_picture())
    result.shown["picture_boxes"] = picture_json(frame, judged, boxes.object, raster, cycles);

  result.shown["crop_rect"] = {full.rect.u0, full.rect.v0, full.rect.u1, full.rect.v1};
  result.shown["host_rect"] = as_size(judged.camera) == best.camera && judged.right > judged.left
                                  ? json({judged.left, judged.top, judged.right, judged.bottom})
                                  : result.shown["crop_rect"];
  Simulated plain;  // what the clean detections are of, where that is not the frame as recorded
  if (boxes.plain)
    plain = simulate(prepared, scene.placement, plain_object(scene.placement), scene.simulation);
  for (const DrawnView& at : drawn_views) {
    const auto save = [&](const std::string& picture, const ImageF& image) {
      const std::string kind = &at == &best ? picture : picture + "_" + frame.name_of(at.camera);
      const std::string file = "pictures/" + name + "_" + kind + ".png";
      write_srgb(out / file, image);
      seen.pictures[kind] = file;
    };
    const ImageF* clean_picture = boxes.plain ? &plain.sight(at.camera).image : nullptr;
    save("clean", clean_picture && !clean_picture->empty() ? *clean_picture : frame.image_of(at.camera));
    save("attacked", at.simulated.image);
    save("cycles", at.full.image);
    save("raster_crop", at.full.raster);
    save("cycles_crop", at.full.cycles);
    save("difference", difference(at.full.raster, at.full.cycles, 1));
    save("matched_raster", at.matched.raster);
    save("matched_cycles", at.matched.cycles);
    save("matched_difference", difference(at.matched.raster, at.matched.cycles, 10));
  }
  const auto& losses = context.renderer.losses();
  result.losses.assign(losses.begin() + static_cast<std::ptrdiff_t>(lost_before), losses.end());
  return result;
}

}  // namespace mirage
