#include "validation/view/view.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <set>

#include "attack/evaluate_run.h"
#include "attack/evaluation.h"
#include "attack/observation.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/sizes.h"
#include "detection/detect.h"
#include "frames/data_check.h"
#include "frames/frame_store.h"
#include "frames/hosts.h"
#include "geometry/box.h"
#include "scene/data/read_frames.h"
#include "validation/fidelity/validate.h"
#include "validation/view/drive_view.h"
#include "validation/view/frame_pack.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr double kMegabyte = 1e6;

/// A run's adversary on its hosts, and its detector's response.
class Attacker {
 public:
  /// `shown`: the vehicles of all frames.
  Attacker(const ViewSettings& settings, Run& run, const std::vector<HostId>& shown)
      : run_(run), store_(run.settings) {
    const std::vector<HostId> learned =
        hosts_learned_on(run, run.settings, shown, frames_learned_on(run, run.settings.data));
    learned_.insert(learned.begin(), learned.end());
    if (!settings.detect) return;
    DetectorOptions options = settings.detector;
    use_detector_of(run, options);
    detector_ = load_detector(for_data(options, run.settings));
    name_ = detector_->name();
    evaluation_.matching = detector_->capabilities().matching();
    evaluation_.score_threshold = kScoreThreshold;  // the page has a slider
  }

  const std::string& detector() const { return name_; }
  /// How its boxes are compared; the default without a detector.
  Matching matching() const { return evaluation_.matching; }
  /// Whether the object itself is judged; the recorded frame then has a plain object in its place.
  bool judges_object() const { return run_.settings.placement.victim == Victim::object; }

  void add(ViewFrame& view, const std::vector<HostId>& hosts) {
    const auto prepared = store_.get(view.frame.id);
    const Frame& seen = prepared->frame;
    std::vector<Detection> clean;
    if (detector_) {
      clean = detections(*detector_, view_of(seen), evaluation_);
      view.found = {listed(clean, seen, view.frame), true};
    }
    for (const HostId& id : hosts) {
      const Placement placement = store_.placement(id);
      require_hosted(store_.place(), placement, id);
      const Simulated simulated = simulate(*prepared, placement, run_.adversary, run_.settings.simulation);
      ViewAttack attack = attack_of(view, *prepared, id, simulated);
      attack.outcome["learned_on"] = learned_.contains(id);
      const EvaluationLabels boxes = labelled_boxes(placement, place(run_.adversary, placement).mesh,
                                                    seen.calibration, carried_box(simulated, placement));
      attack.victim = boxes.victim;
      if (boxes.own) attack.object = in_a_camera(*boxes.own, simulated);
      if (detector_)
        judge_attack(view.frame, *prepared, id,
                     placement.victim == Victim::object
                         ? clean_of(*detector_, *prepared, placement, run_.settings.simulation, evaluation_)
                         : clean,
                     simulated, boxes, attack);
      view.attacks.push_back(std::move(attack));
    }
    const auto range = [&](const ViewAttack& attack) {
      const BevBox& box = view.frame.labels[as_size(attack.label)].box.bev;
      return horizontal_distance(box);
    };
    std::ranges::stable_sort(view.attacks, {}, range);
  }

 private:
  /// `seen`: the frame as the detector gets it.
  std::vector<KittiDetection> listed(const std::vector<Detection>& found, const Frame& seen,
                                     const Frame& whole) const {
    const Capabilities can = detector_->capabilities();
    return kitti_detections(found, evaluation_.matching, whole, can.types, cameras_by_place(seen, can));
  }

  void judge_attack(const Frame& whole, const PreparedFrame& prepared, const HostId& id,
                    const std::vector<Detection>& clean, const Simulated& simulated,
                    const EvaluationLabels& boxes, ViewAttack& attack) {
    const Frame& seen = prepared.frame;
    const auto attacked =
        detections(*detector_, view_of(prepared, simulated, detector_->capabilities()), evaluation_);
    attack.found = {listed(attacked, seen, whole), true};
    EvaluationSettings judging = evaluation_;
    judging.score_threshold = EvaluationSettings{}.score_threshold;
    const auto sure = [&](std::vector<Detection> proposals) {
      std::erase_if(proposals, [&](const Detection& p) { return p.score() < judging.score_threshold; });
      return proposals;
    };
    const HostOutcome outcome = judge(id, seen, sure(clean), sure(attacked), judging, boxes);
    attack.outcome.update({{"clean_iou", outcome.clean_iou},
                           {"attacked_iou", outcome.attacked_iou},
                           {"clean_score", outcome.clean_score},
                           {"attacked_score", outcome.attacked_score},
                           {"detected", outcome.detected},
                           {"hidden", outcome.hidden},
                           {"vanished", !kMissCriteria[0].finds(outcome, false)},
                           {"new_boxes", outcome.new_boxes.size()}});
  }

  Run& run_;
  FrameStore store_;
  std::set<HostId> learned_;  ///< of the vehicles that are shown
  std::unique_ptr<Detector> detector_;
  EvaluationSettings evaluation_;
  std::string name_;
};

/// The word by which the page counts and filters: "hidden", "found", "unfound"; "" without a detector.
std::string outcome_word(const json& outcome) {
  if (!outcome.contains("detected")) return "";
  if (!outcome.at("detected").get<bool>()) return "unfound";
  return outcome.at("hidden").get<bool>() ? "hidden" : "found";
}

/// The parts of the page before and after its frames: page.html with each {{NAME}} replaced by the shipped
/// file of that name.
std::pair<std::string, std::string> page_around() {
  std::string page = read_file(shipped_file("validation/view/page.html"));
  std::size_t frames = 0;
  for (std::size_t at = 0; (at = page.find("{{", at)) != std::string::npos;) {
    const std::size_t end = page.find("}}", at);
    const std::string name = page.substr(at + 2, end - at - 2);
    const std::string part = name == "frames" ? "" : read_file(shipped_file("validation/view/" + name));
    if (name == "frames") frames = at;
    page.replace(at, end + 2 - at, part);
    at += part.size();
  }
  return {page.substr(0, frames), page.substr(frames)};
}

std::string element(const std::string& id, const std::string& type, const std::string& content) {
  return "<script id=\"" + id + "\" type=\"" + type + "\">" + content + "</script>\n";
}

/// JSON that may stand in a script element.
std::string escape_for_script(const json& value) {
  std::string text = json_text(value);
  for (std::size_t at = 0; (at = text.find('<', at)) != std::string::npos; at += 6)
    text.replace(at, 1, "\\u003c");
  return text;
}

}  // namespace

json make_view(const ViewSettings& requested) {
  ViewSettings settings = requested;
  Stopwatch clock;
  std::optional<Run> run;
  std::optional<DriveView> drive;
  std::vector<HostId> shown;
  std::map<std::string, std::vector<HostId>> hosts;
  std::vector<std::string> ids;
  Cameras cameras = Cameras::all;
  if (!settings.drive.empty()) {
    drive.emplace(DriveChoice{settings.drive, settings.vehicle, settings.run, settings.data, settings.trust});
    ids = drive->frames();
    settings.data = drive->settings().data;
    cameras = drive->settings().cameras;
  } else if (!settings.run.empty()) {
    run = read_run(settings.run, settings.trust);
    override_settings(*run, settings.overrides, settings.detector.seed);
    if (settings.data.empty()) settings.data = run->settings.data;
    require_own_data(*run, settings.data);
    run->settings.data = settings.data;
    cameras = run->settings.cameras;
    shown = shown_hosts(*run, settings.frames);
    require_unchanged(*run, shown);
    for (const HostId& id : shown) hosts[id.frame].push_back(id);
    for (const auto& [id, of_frame] : hosts) ids.push_back(id);
    if (ids.empty())
      throw InputError((settings.run / "run.json").string(), "test", "no test vehicles to show",
                       "give --frames N, which goes on with those that it learned on");
  } else {
    if (settings.data.empty())
      throw InputError("view", "DIR", "is missing", "give a data set, --run or --drive");
    for (const char* of_object : {"depth", "placement"})
      if (const auto given = settings.overrides.find(of_object); given != settings.overrides.end())
        throw FieldError(of_object, given->second, "tells of an object, and there is none",
                         "give --run or --drive with it");
    ids = list_frames(settings.data, as_size(settings.frames));
    if (settings.overrides.contains("cameras"))
      cameras = parse_word<Cameras>(settings.overrides.at("cameras"), "cameras");
    check_data(settings.data, settings.overrides.contains("rig") ? settings.overrides.at("rig") : "",
               UnitUse::reads_sweeps);
  }
  warn_of_labels(count_labels(settings.data, ids));
  std::optional<DetectionFiles> file;
  std::ptrdiff_t looked_at = 0;  // frames that the file has
  if (!settings.detections.empty()) {
    file.emplace(settings.detections);
    looked_at = std::ranges::count_if(ids, [&](const std::string& id) { return file->has(id); });
    if (looked_at == 0)
      throw InputError(settings.detections.string(), "frames",
                       "has none of the frames of " + settings.data.string() + " (" + ids.front() + ", …)",
                       "give the detections of that data set");
  }
  const auto [before, after] = page_around();
  constexpr double kOverhead = 200;  // bytes of an element around a frame
  const double room = settings.size * kMegabyte - static_cast<double>(before.size() + after.size()) - 1e5;
  const double limit = room / static_cast<double>(ids.size()) - kOverhead;
  if (limit < 1e4)
    throw FieldError("size", fmt::format("{:g} MB", settings.size),
                     fmt::format("is too small for {} frames", ids.size()), "give more, or fewer --frames");

  std::optional<Attacker> attacker;
  if (run) attacker.emplace(settings, *run, shown);
  std::optional<DriveAnimation> animation;
  if (!settings.animation.empty()) animation.emplace(settings.animation);
  std::string frames;
  PackSettings coarsest;
  double lowest = std::numeric_limits<double>::infinity(), highest = -lowest, brightest = 0;
  double faintest = 0;  // of the file's scores, which may be logits
  std::size_t points = 0, kept = 0, vehicles = 0, trained_on = 0, hidden = 0;
  json attacks = json::array();  // a frame's vehicles each: its word and its distance in m
  Progress progress("view", ids.size(), settings.quiet);
  const std::size_t batch = 2 * as_size(std::max(1, thread_count()));
  for (std::size_t first = 0; first < ids.size(); first += batch) {
    throw_if_interrupted("no page was written yet");
    const std::size_t count = std::min(batch, ids.size() - first);
    std::vector<ViewFrame> views(count);
    parallel_for(count, [&](std::size_t i) {
      views[i].frame = read_frame(settings.data, ids[first + i], cameras);
      find_instances(settings.data, views[i]);
      if (file) views[i].from_file = {file->of(views[i].frame), file->has(views[i].frame.id)};
    });
    if (attacker)
      for (ViewFrame& view : views) attacker->add(view, hosts[view.frame.id]);
    if (drive) parallel_for(count, [&](std::size_t i) { drive->add(views[i]); });
    if (animation)
      for (const ViewFrame& view : views) animation->add(view);
    std::vector<PackedFrame> packed(count);
    parallel_for(count, [&](std::size_t i) {
      packed[i] = pack(views[i], static_cast<std::size_t>(limit), {PackSettings{}.quality, coarsest.step});
    });
    for (std::size_t i = 0; i < count; ++i) {
      const PackedFrame& frame = packed[i];
      frames += element(fmt::format("frame-{}", first + i), "text/plain", frame.text);
      coarsest.step = std::max(coarsest.step, frame.settings.step);
      coarsest.quality = std::min(coarsest.quality, frame.settings.quality);
      lowest = std::min(lowest, frame.lowest);
      highest = std::max(highest, frame.highest);
      brightest = std::max(brightest, frame.brightest);
      for (const KittiDetection& found : views[i].from_file.found) faintest = std::min(faintest, found.score);
      points += frame.points;
      kept += frame.kept;
      vehicles += views[i].attacks.size();
      json& of_frame = attacks.emplace_back(json::array());
      for (const ViewAttack& attack : views[i].attacks) {
        const bool learned = attack.outcome.at("learned_on").get<bool>();
        if (learned) ++trained_on;
        const std::string word = learned && !drive ? "learned" : outcome_word(attack.outcome);
        if (word == "hidden") ++hidden;
        const Label& host = views[i].frame.labels.at(as_size(attack.label));
        of_frame.push_back({word, std::round(10 * horizontal_distance(host.box.bev)) / 10});
      }
    }
    progress.update(first + count);
  }
  json detector, object;
  if (drive) {
    detector = drive->detector();
    object = drive->object();
  } else if (run) {
    object = fs::weakly_canonical(settings.run).filename().string();
    if (!attacker->detector().empty()) detector = attacker->detector();
  }
  const std::string name = fs::weakly_canonical(settings.data).filename().string();
  json about = {{"data", name},
                {"frames", ids},
                {"run", object},
                {"detector", detector},
                {"drive", drive ? drive->vehicle() : json()},
                {"file", file ? json(fs::weakly_canonical(settings.detections).filename().string()) : json()},
                {"attacks", attacks},
                {"judged_at", drive ? drive->score_threshold() : EvaluationSettings{}.score_threshold},
                {"judged_iou", EvaluationSettings{}.detected_iou},
                {"matching", attacker ? attacker->matching().name() : kFromAbove.name()},
                {"plain", attacker && attacker->judges_object()},
                {"lowest_score", faintest},
                {"height", {lowest, highest}},
                {"reflectance", brightest},
                {"step", coarsest.step},
                {"quality", coarsest.quality},
                {"points", points},
                {"kept", kept},
                {"megabytes",
                 std::round(static_cast<double>(before.size() + frames.size() + after.size()) / 1e5) / 10}};
  const std::string page =
      before + element("about", "application/json", escape_for_script(about)) + frames + after;
  write_file(settings.page, page);
  if (animation) animation->write(*drive);
  json result = {{"page", settings.page.string()},
                 {"bytes", page.size()},
                 {"frames", ids.size()},
                 {"vehicles", vehicles},
                 {"learned_on", trained_on},
                 {"hidden", hidden},
                 {"points", points},
                 {"kept_points", kept},
                 {"step", coarsest.step},
                 {"quality", coarsest.quality},
                 {"seconds", clock.lap()}};
  if (drive) result["vehicle"] = drive->name();
  if (file) result["frames_in_file"] = looked_at;
  if (animation) result["animation"] = fs::file_size(settings.animation);
  return result;
}

}  // namespace mirage
