#include "validation/report/pages.h"

#include <fmt/format.h>

#include <algorithm>
#include <optional>
#include <set>

#include "attack/observation.h"
#include "base/child_process.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/sizes.h"
#include "detection/average_precision.h"
#include "detection/car_in_picture.h"

namespace mirage {
namespace {

/// The reason why a script made no plot, by its last line.
std::string reason(const std::string& last_line) {
  return last_line.empty() ? "install python3-matplotlib" : last_line;
}

/// One point a hit: between hits the recall stays.
nlohmann::json curve_json(const PrecisionRecall& result) {
  nlohmann::json recall = nlohmann::json::array(), precision = nlohmann::json::array();
  double last = 0;
  for (const auto& [r, p] : result.curve) {
    if (r <= last) continue;
    recall.push_back(last = r);
    precision.push_back(p);
  }
  return {{"ap", result.average_precision},
          {"vehicles", result.boxes},
          {"recall", recall},
          {"precision", precision}};
}

using nlohmann::json;
namespace fs = std::filesystem;

/// Raw little-endian floats, for numpy.fromfile.
void write_floats(const fs::path& file, const std::vector<float>& values) {
  write_file(file, {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float)});
}

json bev_json(const BevBox& box) {
  auto outline = json::array();
  for (const Vec2d& c : corners(box)) outline.push_back({c.x(), c.y()});
  return outline;
}

/// The eight corners' pixels; null if one lies behind the camera.
json pixels_json(const Box3& box, const Calibration& calibration) {
  auto list = json::array();
  for (const Vec3d& corner : corners(box)) {
    const Vec3d p = calibration.camera_from_velo * corner;
    if (p.z() < 0.1) return nullptr;
    const Vec2d uv = calibration.camera.project(p);
    list.push_back({uv.x(), uv.y()});
  }
  return list;
}

/// A detection's box as it stands in the image: on the host's ground with the mean car's height
/// (kNominalHeight) where it overlaps no label, else as high as the label.
Box3 standing(const BevBox& box, const Frame& frame, const Label& host) {
  Box3 result{box, host.box.bottom, kNominalHeight};
  double best = 0;
  for (const Label& label : frame.labels) {
    if (!has_box(label)) continue;
    if (const double overlap = iou(box, label.box.bev); overlap > best) {
      best = overlap;
      result.bottom = label.box.bottom;
      result.height = label.box.height;
    }
  }
  return result;
}

/// The four corners of a box in the picture.
json pixels_json(const PictureBox& box) {
  return {{box.left, box.top}, {box.right, box.top}, {box.right, box.bottom}, {box.left, box.bottom}};
}

/// `camera`: whose pixels the boxes are drawn in.
json detections_json(const std::vector<Detection>& proposals, const Frame& frame, const Label& host,
                     Matching matching, std::size_t camera) {
  auto list = json::array();
  for (const Detection& d : proposals) {
    const BevBox box = matching.flat(d);
    list.push_back({{"score", d.score()},
                    {"outline", bev_json(box)},
                    {"pixels", matching.in_picture()
                                   ? pixels_json(d.picture)
                                   : pixels_json(standing(box, frame, host), frame.calibration_of(camera))}});
  }
  return list;
}

/// {file, width, height} of a map.
json map_json(const ImageF& map, const fs::path& folder, const std::string& name) {
  write_floats(folder / name, map.data);
  return {{"file", name}, {"width", map.width}, {"height", map.height}};
}

/// Null where the detector has no image features.
json features_json(Detector& detector, const SensorView& clean, const SensorView& attacked,
                   const fs::path& folder) {
  const ImageFeatures before = detector.image_features(clean);
  if (!(before.stride > 0) || before.map.empty()) return nullptr;
  const ImageFeatures after = detector.image_features(attacked);
  json result = {{"stride", before.stride},
                 {"clean", map_json(before.map, folder, "features_clean.f32")},
                 {"attacked", map_json(after.map, folder, "features_attacked.f32")}};
  if (!before.bev.empty() && before.cell > 0)
    result["bev"] = {{"cell", before.cell},
                     {"clean", map_json(before.bev, folder, "features_bev_clean.f32")},
                     {"attacked", map_json(after.bev, folder, "features_bev_attacked.f32")}};
  return result;
}

/// "000008_0", and where there are several objects "000008_0_kayak".
std::string picture_name(const RunEvaluation& evaluation, const HostOutcome& outcome) {
  std::string name = host_name(outcome.id);
  if (evaluation.objects.size() > 1)
    name += fmt::format("_{}", evaluation.objects[as_size(outcome.mesh)].file.stem().string());
  return name;
}

/// The title of the pictures: `name`, after the label that is judged in the host's place. `itself`: the
/// object is judged.
std::string picture_title(const HostOutcome& outcome, bool itself, const std::string& name) {
  if (itself) return "object at " + name;
  if (outcome.victim < 0) return name;
  return fmt::format("{} (host {})", host_name({outcome.id.frame, outcome.victim}), name);
}

/// Simulates the host again and writes the data of its pictures.
json host_json(const RunEvaluation& evaluation, const HostOutcome& outcome, const fs::path& data) {
  FrameStore& store = *evaluation.store;
  Detector& detector = *evaluation.detectors.front();
  const HostId& id = outcome.id;
  const SimulationSettings& simulation = evaluation.target_run.settings.simulation;
  const TexturedMesh& mesh =
      evaluation.objects.empty() ? evaluation.run.adversary : evaluation.objects[as_size(outcome.mesh)].mesh;
  JudgedScene scene(store, id, mesh, simulation, evaluation.settings);
  const Frame& frame = scene.recorded().frame;
  const Simulated& simulated = scene.observation().simulated();
  const Placement placement = store.placement(id);
  const bool itself = placement.victim == Victim::object;  // the clean frame has a plain object in it
  const TexturedMesh plain = itself ? plain_object(placement) : TexturedMesh();
  std::optional<JudgedScene> with_plain;
  if (itself) with_plain.emplace(store, id, plain, simulation, evaluation.settings);
  const Label host =
      itself ? in_a_camera(own_label(placement, place(mesh, placement).mesh, frame.calibration), simulated)
             : label_of(frame, {id.frame, outcome.victim < 0 ? id.label : outcome.victim});
  const std::string name = picture_name(evaluation, outcome);
  const fs::path folder = data / name;
  // The camera that the host's label is in; boxes of a detector that is judged in the picture are the
  // first's.
  const std::size_t camera = outcome.matching.in_picture() ? 0 : as_size(host.camera);
  // The picture of another camera that shows nothing of the object is empty.
  const auto shown = [&](const Simulated& of) -> const ImageF& {
    const ImageF& seen = of.sight(camera).image;
    return seen.empty() ? frame.image_of(camera) : seen;
  };
  write_srgb(folder / "clean.png",
             itself ? shown(with_plain->observation().simulated()) : frame.image_of(camera));
  write_srgb(folder / "attacked.png", shown(simulated));
  std::vector<float> points;  // x, y, whether it is a return on the adversary
  const auto first = simulated.sweep.size() - as_size(simulated.adversary_points);
  for (std::size_t i = 0; i < simulated.sweep.size(); ++i)
    points.insert(points.end(), {simulated.sweep[i].x, simulated.sweep[i].y, i >= first ? 1.0f : 0.0f});
  write_floats(folder / "points.f32", points);
  auto truth = json::array();
  const HostTruth labelled =
      itself ? HostTruth::of_object(frame, host, outcome.matching) : HostTruth(frame, host, outcome.matching);
  for (const ObjectBoxes& box : labelled.labels()) truth.push_back(bev_json(outcome.matching.flat(box)));
  auto new_boxes = json::array();
  for (const NewBox& found : outcome.new_boxes) {
    const BevBox box = outcome.matching.flat(found.box);
    new_boxes.push_back({{"outline", bev_json(box)},
                         {"x", box.x},
                         {"y", box.y},
                         {"score", found.score},
                         {"distance", found.distance}});
  }
  const SensorView clean =
      itself ? with_plain->observation().view(detector.capabilities(), false) : view_of(frame);
  const SensorView attacked = scene.observation().view(detector.capabilities(), false);
  return {{"name", name},
          {"title", picture_title(outcome, itself, name)},
          {"folder", folder.filename().string()},
          {"camera", camera == 0 ? json() : json(frame.name_of(camera))},
          {"range", outcome.range},
          {"clean_score", outcome.clean_score},
          {"clean_iou", outcome.clean_iou},
          {"attacked_score", outcome.attacked_score},
          {"attacked_iou", outcome.attacked_iou},
          {"window", {host.left, host.top, host.right, host.bottom}},
          {"host",
           {{"x", host.box.bev.x},
            {"y", host.box.bev.y},
            {"outline", bev_json(host.box.bev)},
            {"pixels", outcome.matching.in_picture() ? pixels_json(picture_box(host))
                                                     : pixels_json(host.box, frame.calibration_of(camera))}}},
          {"truth", truth},
          {"clean", detections_json(outcome.clean, frame, host, outcome.matching, camera)},
          {"attacked", detections_json(outcome.attacked, frame, host, outcome.matching, camera)},
          {"new", new_boxes},
          {"features", features_json(detector, clean, attacked, folder)}};
}

/// `count` of `places`, in their order, hosts of frames that are not among them yet before the others.
std::vector<std::size_t> spread_over_frames(const std::vector<HostOutcome>& hosts,
                                            const std::vector<std::size_t>& places, int count) {
  std::vector<std::size_t> first, others;
  std::set<std::string> frames;
  for (const std::size_t i : places) (frames.insert(hosts[i].id.frame).second ? first : others).push_back(i);
  first.insert(first.end(), others.begin(), others.end());
  first.resize(std::min(first.size(), as_size(std::max(0, count))));
  return first;
}

}  // namespace

std::vector<std::string> plot_precision_recall(std::span<const ScoredStratum> parts, const std::string& title,
                                               const std::filesystem::path& out) {
  auto curves = list_json(parts, [](const ScoredStratum& part) -> json {
    return {{"name", part.stratum.name}, {"iou50", curve_json(part.at50)}, {"iou70", curve_json(part.at70)}};
  });
  write_json(out / "precision_recall.json", {{"title", title}, {"curves", curves}});
  if (std::string why; run_script("validation/report/detection_plot.py", out, &why) != 0) {
    spdlog::warn("no precision-recall plot: {} (the curves are in {})", reason(why),
                 (out / "precision_recall.json").string());
    return {};
  }
  return {"precision_recall.png", "precision_recall.svg"};
}

PicturedHosts pictured_hosts(const std::vector<HostOutcome>& hosts, int count) {
  std::vector<std::size_t> hidden, false_positives;
  for (std::size_t i = 0; i < hosts.size(); ++i) {
    if (!hosts[i].detected) continue;
    if (hosts[i].hidden) hidden.push_back(i);
    if (hosts[i].false_positive) false_positives.push_back(i);
  }
  std::stable_sort(hidden.begin(), hidden.end(), [&](std::size_t a, std::size_t b) {
    return std::pair(hosts[a].attacked_iou, -hosts[a].clean_score) <
           std::pair(hosts[b].attacked_iou, -hosts[b].clean_score);
  });
  std::stable_sort(false_positives.begin(), false_positives.end(), [&](std::size_t a, std::size_t b) {
    return hosts[a].false_positive_distance > hosts[b].false_positive_distance;
  });
  return {spread_over_frames(hosts, hidden, count), spread_over_frames(hosts, false_positives, count)};
}

std::vector<std::string> draw_evaluation_pictures(const RunEvaluation& evaluation, int count,
                                                  const fs::path& out) {
  const auto& hosts = evaluation.learned.hosts;
  const PicturedHosts pictured = pictured_hosts(hosts, count);
  std::set<std::size_t> all(pictured.hidden.begin(), pictured.hidden.end());
  all.insert(pictured.false_positives.begin(), pictured.false_positives.end());
  if (all.empty()) {
    if (count > 0) spdlog::warn("no pictures: no vehicle was hidden and no false positive made");
    return {};
  }
  const auto region = evaluation.detectors.front()->region();
  json about = {{"region", region},
                {"plane", evaluation.settings.matching.name()},
                {"score_threshold", evaluation.settings.score_threshold},
                {"detected_iou", evaluation.settings.detected_iou},
                {"nominal_height", kNominalHeight},
                {"victim", to_word(evaluation.target_run.settings.placement.victim)},
                {"hosts", json::array()}};
  const auto contains = [](const std::vector<std::size_t>& list, std::size_t i) {
    return std::ranges::find(list, i) != list.end();
  };
  std::vector<std::string> names;
  for (const std::size_t i : all) {
    throw_if_interrupted("an evaluation writes its result after the pictures; run it again");
    json host = host_json(evaluation, hosts[i], out / "data");
    const std::string name = host.at("name");
    auto pictures = json::array();
    if (contains(pictured.hidden, i)) pictures.push_back("hidden");
    if (contains(pictured.false_positives, i)) pictures.push_back("false_positives");
    if (!host.at("features").is_null()) pictures.push_back("features");
    for (const auto& kind : pictures) names.push_back(kind.get<std::string>() + "_" + name + ".png");
    host["pictures"] = pictures;
    about["hosts"].push_back(std::move(host));
  }
  write_json(out / "data" / "pictures.json", about);
  if (std::string why; run_script("validation/report/evaluation_pictures.py", out, &why) != 0) {
    spdlog::warn("no pictures: {} (what they show is in {})", reason(why), (out / "data").string());
    return {};
  }
  return names;
}

}  // namespace mirage
