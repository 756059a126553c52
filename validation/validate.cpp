#include "validation/validate.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/interrupt.h"
#include "base/progress.h"
#include "exchange/gltf.h"
#include "exchange/host_proxy.h"
#include "scene/data_rig.h"
#include "scene/shape/shape_rooftop.h"
#include "validation/blender_process.h"
#include "validation/fidelity.h"
#include "validation/host_validation.h"

namespace mirage {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr int kStoredVersion = 3;  // of hosts/*.json; raise it when their content changes
constexpr double kBevReach = 16;   // m around the host that the report's bird's-eye view shows

json box_json(const BevBox& b) {
  return {b.x, b.y, b.length, b.width, b.yaw};
}

json boxes_json(const std::vector<Proposal>& proposals) {
  auto list = json::array();
  for (const Proposal& p : proposals) list.push_back({{"box", box_json(p.box)}, {"score", p.score()}});
  return list;
}

json outcome_json(const HostOutcome& outcome) {
  return {{"iou", outcome.attacked_iou},
          {"score", outcome.attacked_score},
          {"hidden", outcome.hidden},
          {"false_positive", outcome.false_positive}};
}

json bev_json(const PreparedFrame& prepared, const Label& host, const Simulated& simulated,
              const HostOutcome& raster, const HostOutcome& cycles) {
  const auto near_host = [&](double x, double y) {
    return std::abs(x - host.box.bev.x) <= kBevReach && std::abs(y - host.box.bev.y) <= kBevReach;
  };
  auto measured = json::array(), added = json::array(), truth = json::array();
  const auto millimetres = [](float value) { return std::round(1000.0 * value) / 1000; };
  const std::size_t first = simulated.sweep.size() - static_cast<std::size_t>(simulated.adversary_points);
  for (std::size_t i = 0; i < simulated.sweep.size(); ++i) {
    const LidarPoint& p = simulated.sweep[i];
    if (near_host(p.x, p.y)) (i < first ? measured : added).push_back({millimetres(p.x), millimetres(p.y)});
  }
  for (const BevBox& box : ground_truth_boxes(prepared.frame)) truth.push_back(box_json(box));
  return {{"host", box_json(host.box.bev)},
          {"reach", kBevReach},
          {"points", measured},
          {"adversary_points", added},
          {"truth", truth},
          {"clean", boxes_json(raster.clean)},
          {"raster", boxes_json(raster.attacked)},
          {"cycles", boxes_json(cycles.attacked)}};
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

struct Context {
  const ValidationSettings& settings;
  const Run& run;
  FrameStore& store;
  Detector& detector;
  BlenderWorker& blender;
  std::map<std::string, std::vector<Proposal>> clean;  ///< a frame's clean detections serve all its hosts
};

json validate_host(Context& context, const HostId& id, bool with_ladder) {
  const PreparedFrame& prepared = context.store.get(id.frame);
  const Frame& frame = prepared.frame;
  const fs::path& out = context.settings.out;
  const std::string name = host_name(id);
  HostScene scene;
  scene.prepared = &prepared;
  scene.host = &label_of(frame, id);
  scene.rooftop = context.store.rooftop(id);
  scene.adversary = context.run.adversary;
  scene.placed = place(scene.adversary, scene.rooftop);
  scene.simulation = context.run.simulation;
  scene.samples = context.settings.samples;
  scene.seed = context.settings.seed;
  scene.glb = out / "scenes" / (name + ".glb");
  scene.scratch = out / "scratch";
  fs::create_directories(scene.scratch);
  write_scene(scene.glb, host_scene(frame, *scene.host, scene.rooftop, scene.adversary, name));

  const Simulated simulated =
      simulate(prepared, *scene.host, scene.rooftop, scene.adversary, scene.simulation);
  json result = {{"frame", id.frame},
                 {"label", id.label},
                 {"name", name},
                 {"from_box", scene.rooftop.from_box},
                 {"visible_share", simulated.visible_share},
                 {"adversary_points", simulated.adversary_points}};
  if (simulated.rect.empty()) return result;
  const MatchedLight matched = matched_light(context.blender, scene);
  const LidarCheck lidar = check_lidar(context.blender, scene, simulated);
  const FullLight full = full_light(context.blender, scene, simulated);
  result["matched"] = {{"mask_iou", matched.mask_iou},
                       {"mae", matched.mae},
                       {"max_error", matched.max_error},
                       {"mask_both", matched.mask_both},
                       {"mask_either", matched.mask_either},
                       {"range_error_m", lidar.range_error},
                       {"rays", lidar.rays},
                       {"returns", lidar.returns},
                       {"hit_disagreements", lidar.disagreements},
                       {"pixels_off", matched.pixels_off}};
  const ImageF seen_raster = encoded(full.raster), seen_cycles = encoded(full.cycles);
  result["full"] = {
      {"mae", mean_absolute_error(full.raster, full.cycles, full.mask)},
      {"mean", mean_absolute_error(full.cycles, ImageF(full.mask.width, full.mask.height, 3), full.mask)},
      {"ssim", ssim(grey(seen_raster), grey(seen_cycles), full.mask)},
      {"flip", flip(seen_cycles, seen_raster, full.mask)},
      {"seconds", full.seconds}};
  if (with_ladder) {
    result["ladder"] = json::array();
    for (const LadderRung& rung : light_ladder(context.blender, scene))
      result["ladder"].push_back({{"effect", rung.effect},
                                  {"mae", rung.mae},
                                  {"relative", rung.relative},
                                  {"ssim", rung.ssim},
                                  {"flip", rung.flip},
                                  {"seconds", rung.seconds}});
  }

  const EvaluationSettings& judge_by = context.settings.evaluation_settings;
  const auto look = [&](const ImageF& image, const Sweep& sweep) {
    return detections(context.detector, {&image, sweep, &frame.calibration}, judge_by);
  };
  const auto [clean, added] = context.clean.try_emplace(id.frame);
  if (added) clean->second = look(frame.image, frame.sweep);
  const HostOutcome raster =
      judge(id, frame, clean->second, look(simulated.image, simulated.sweep), judge_by);
  const HostOutcome cycles = judge(id, frame, clean->second, look(full.image, simulated.sweep), judge_by);
  result["range"] = raster.range;
  result["detected"] = raster.detected;
  result["clean"] = {{"iou", raster.clean_iou}, {"score", raster.clean_score}};
  result["raster"] = outcome_json(raster);
  result["cycles"] = outcome_json(cycles);
  result["bev"] = bev_json(prepared, *scene.host, simulated, raster, cycles);

  const auto save = [&](const std::string& picture, const ImageF& image) {
    const std::string file = "pictures/" + name + "_" + picture + ".png";
    write_srgb(out / file, image);
    result["pictures"][picture] = file;
  };
  const Label& host = *scene.host;
  result["host_rect"] = {host.left, host.top, host.right, host.bottom};
  result["crop_rect"] = {full.rect.u0, full.rect.v0, full.rect.u1, full.rect.v1};
  save("clean", frame.image);
  save("attacked", simulated.image);
  save("cycles", full.image);
  save("raster_crop", full.raster);
  save("cycles_crop", full.cycles);
  save("difference", difference(full.raster, full.cycles, 1));
  save("matched_raster", matched.raster);
  save("matched_cycles", matched.cycles);
  save("matched_difference", difference(matched.raster, matched.cycles, 10));
  return result;
}

/// What a stored result depends on; another key means that it is made again.
std::string key_of(const ValidationSettings& settings, const Run& run, const fs::path& data) {
  std::string bytes = read_file(settings.run / "adversary.glb") + to_json(run.simulation).dump();
  const auto& d = settings.detector;
  bytes += fmt::format("|{}|{}|{}|{}|{}|{}|{}|{}", kStoredVersion, d.detector, d.weights.string(),
                       data.string(), settings.samples, settings.seed,
                       settings.evaluation_settings.score_threshold, rooftop_model_hash(settings.rooftop));
  return content_hash(bytes + read_file(weights_file(d)));
}

/// Whether the pictures that a stored result names are still there: the report embeds them.
bool pictures_exist(const fs::path& out, const json& stored) {
  const json pictures = stored.value("pictures", json::object());
  for (const auto& [name, file] : pictures.items())
    if (!file.is_string() || !fs::exists(out / file.get<std::string>())) return false;
  return true;
}

/// How many vehicles the adversary fools, seen by the rasteriser and by Cycles.
struct Fooled {
  int detected = 0, hidden_raster = 0, hidden_cycles = 0, hidden_both = 0, raster = 0, cycles = 0;

  void add(const json& host) {
    if (!host.at("detected").get<bool>()) return;
    ++detected;
    const bool in_raster = host.at("raster").at("hidden"), in_cycles = host.at("cycles").at("hidden");
    hidden_raster += in_raster;
    hidden_cycles += in_cycles;
    hidden_both += in_raster && in_cycles;
    raster += in_raster || host.at("raster").at("false_positive").get<bool>();
    cycles += in_cycles || host.at("cycles").at("false_positive").get<bool>();
  }
  json to_json() const {
    const double base = std::max(1, detected);
    return {{"detected_clean", detected},
            {"hidden_raster", hidden_raster},
            {"hidden_cycles", hidden_cycles},
            {"hidden_both", hidden_both},
            {"fn_asr_raster", hidden_raster / base},
            {"fn_asr_cycles", hidden_cycles / base},
            {"asr_raster", raster / base},
            {"asr_cycles", cycles / base}};
  }
};

json summary(const std::vector<json>& hosts, const Run& run) {
  std::set<std::string> frames, test_frames;
  for (const HostId& id : run.test) test_frames.insert(id.frame);
  double both = 0, either = 0, error = 0, largest = 0, range_error = 0, worst_iou = 1;
  RooftopCount rooftops;
  int rays = 0, pixels_off = 0, returns = 0, disagreements = 0, vehicles = 0;
  Fooled held_back, trained_on;  // an attack is judged on vehicles that it never saw
  double full_mae = 0, full_mean = 0, full_ssim = 0, full_flip = 0, full_seconds = 0;
  std::map<std::string, std::pair<int, std::array<double, 5>>> rungs;
  std::vector<std::string> order;
  for (const json& host : hosts) {
    if (!host.contains("matched")) continue;
    ++vehicles;
    ++(host.at("from_box").get<bool>() ? rooftops.from_box : rooftops.fitted);
    frames.insert(host.at("frame").get<std::string>());
    const json& m = host.at("matched");
    both += m.at("mask_both").get<double>();
    either += m.at("mask_either").get<double>();
    error += m.at("mae").get<double>() * m.at("mask_either").get<double>();
    largest = std::max(largest, m.at("max_error").get<double>());
    worst_iou = std::min(worst_iou, m.at("mask_iou").get<double>());
    range_error = std::max(range_error, m.at("range_error_m").get<double>());
    rays += m.at("rays").get<int>();
    pixels_off += m.at("pixels_off").get<int>();
    returns += m.at("returns").get<int>();
    disagreements += m.at("hit_disagreements").get<int>();
    const json& full = host.at("full");
    full_mae += full.at("mae").get<double>();
    full_mean += full.at("mean").get<double>();
    full_ssim += full.at("ssim").get<double>();
    full_flip += full.at("flip").get<double>();
    full_seconds += full.at("seconds").get<double>();
    for (const json& rung : host.value("ladder", json::array())) {
      const auto effect = rung.at("effect").get<std::string>();
      auto [place, added] = rungs.try_emplace(effect);
      if (added) order.push_back(effect);
      ++place->second.first;
      int k = 0;
      for (const char* key : {"mae", "relative", "ssim", "flip", "seconds"})
        place->second.second[k++] += rung.at(key).get<double>();
    }
    (test_frames.count(host.at("frame").get<std::string>()) ? held_back : trained_on).add(host);
  }
  const double n = std::max(1, vehicles);
  auto ladder = json::array();
  for (const std::string& effect : order) {
    const auto& [count, sums] = rungs.at(effect);
    ladder.push_back({{"effect", effect},
                      {"mae", sums[0] / count},
                      {"relative", sums[1] / count},
                      {"ssim", sums[2] / count},
                      {"flip", sums[3] / count},
                      {"seconds", sums[4] / count},
                      {"vehicles", count}});
  }
  const auto tested =
      std::count_if(frames.begin(), frames.end(), [&](const auto& f) { return test_frames.count(f); });
  return {{"frames", frames.size()},
          {"test_frames", tested},
          {"vehicles", vehicles},
          {"rooftops", to_json(rooftops)},
          {"matched",
           {{"mask_iou", either > 0 ? both / either : 1},
            {"mask_iou_worst", worst_iou},
            {"mae", either > 0 ? error / either : 0},
            {"max_error", largest},
            {"pixels", either},
            {"pixels_off", pixels_off},
            {"range_error_m", range_error},
            {"hit_disagreements", disagreements},
            {"rays", rays},
            {"returns", returns}}},
          {"full",
           {{"mae", full_mae / n},
            {"relative", full_mean > 0 ? full_mae / full_mean : 0},
            {"ssim", full_ssim / n},
            {"flip", full_flip / n},
            {"seconds", full_seconds / n}}},
          {"ladder", ladder},
          {"attack", held_back.to_json()},
          {"attack_train", trained_on.to_json()}};
}

void write_report(const ValidationSettings& settings) {
  const std::string python = plotting_python().string();
  if (python.empty())
    throw InputError("python3", "", "not found on PATH", "install it with apt-get install python3-jinja2");
  std::vector<std::string> arguments = {python,         shipped_file("validation/report.py").string(),
                                        "--validation", settings.out.string(),
                                        "--run",        settings.run.string()};
  if (!settings.evaluation.empty())
    arguments.insert(arguments.end(), {"--evaluation", settings.evaluation.string()});
  if (const int status = run_program(arguments); status != 0)
    throw Failure("report.py", fmt::format("ended with status {}", status),
                  "install python3-matplotlib and python3-jinja2; finished vehicles are kept");
}

}  // namespace

std::vector<HostId> select_hosts(const Run& run, int frames) {
  std::vector<HostId> chosen;
  std::set<std::string> seen;
  for (const auto* list : {&run.test, &run.train}) {
    if (frames == 0 && list == &run.train) break;
    for (const HostId& id : *list) {
      if (!seen.count(id.frame) && frames > 0 && static_cast<int>(seen.size()) >= frames) continue;
      seen.insert(id.frame);
      chosen.push_back(id);
    }
  }
  return chosen;
}

json validate(const ValidationSettings& given) {
  ValidationSettings settings = given;
  const Run run = read_run(settings.run);
  if (!settings.evaluation.empty()) {  // the report needs it in the end: complain now
    if (fs::is_directory(settings.evaluation)) settings.evaluation /= "result.json";
    read_json(settings.evaluation);
  }
  if (settings.data.empty()) settings.data = run.data;
  require_own_data(run, settings.data);
  use_detector_of(run, settings.detector);
  if (settings.rooftop.empty()) settings.rooftop = run.rooftop;
  const std::vector<HostId> hosts = select_hosts(run, settings.frames);
  if (hosts.empty())
    throw InputError((settings.run / "run.json").string(), "test", "no vehicles to validate",
                     "run mirage attack on a data set with cars in view");
  make_output_folder(settings.out);
  for (const char* folder : {"hosts", "scenes", "pictures"}) fs::create_directories(settings.out / folder);
  BlenderWorker blender(settings.out / "blender.log");
  settings.detector.rig = data_rig(settings.data);
  const auto detector = load_detector(settings.detector);
  FrameStore store(settings.data, run.depth, settings.rooftop);
  Context context{settings, run, store, *detector, blender, {}};
  const std::string key = key_of(settings, run, settings.data);
  Progress progress("validate", hosts.size(), settings.quiet);
  std::vector<json> results;
  for (std::size_t i = 0; i < hosts.size(); ++i) {
    throw_if_interrupted("finished vehicles are kept; run the same command again to go on");
    const fs::path file = settings.out / "hosts" / (host_name(hosts[i]) + ".json");
    const bool with_ladder = static_cast<int>(i) < settings.ladder;
    if (fs::exists(file)) {
      json stored = json::parse(read_file(file), nullptr, false);  // a damaged one is made again
      if (stored.is_object() && stored.value("key", "") == key && pictures_exist(settings.out, stored) &&
          (!with_ladder || stored.contains("ladder"))) {
        if (!with_ladder) stored.erase("ladder");
        results.push_back(std::move(stored));
        progress.update(i + 1);
        continue;
      }
    }
    json result = validate_host(context, hosts[i], with_ladder);
    result["key"] = key;
    write_json(file, result);
    results.push_back(std::move(result));
    progress.update(i + 1, host_name(hosts[i]));
  }
  std::error_code ignored;
  fs::remove_all(settings.out / "scratch", ignored);
  json result = summary(results, run);
  auto names = json::array();
  for (const json& host : results) names.push_back(host.at("name"));
  result["hosts"] = names;
  result["samples"] = settings.samples;
  result["blender"] = blender.version();
  result["blender_restarts"] = blender.restarts();
  result["report"] = (settings.out / "report.html").string();
  write_json(settings.out / "result.json", result);  // the report reads it
  write_report(settings);
  return result;
}

}  // namespace mirage
