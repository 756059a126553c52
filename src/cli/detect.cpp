// mirage detect: runs a detector over a data set and scores it.
#include "detection/detect.h"

#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstdio>
#include <map>

#include "attack/detector_pool.h"
#include "attack/glue_check.h"
#include "base/files.h"
#include "base/names.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "cli/command.h"
#include "cli/options.h"
#include "detection/process_detector.h"
#include "frames/data_check.h"
#include "frames/frame_provenance.h"
#include "frames/frame_store.h"
#include "scene/data/read_frames.h"
#include "validation/report/pages.h"

namespace mirage::cli {
namespace {

struct DetectOptions : FrameSource {
  DetectorOptions detector;
  std::size_t frames = 0;
  int check = 0;
  std::filesystem::path kitti;
};

nlohmann::json box_json(const BevBox& box) {
  return {{"x", box.x}, {"y", box.y}, {"length", box.length}, {"width", box.width}, {"yaw", box.yaw}};
}

/// Names of a frame's cameras beside the first, by ObjectBoxes::camera.
using CameraNames = std::map<int, std::string>;

/// The box in the picture of its camera, by name if it is not the first.
nlohmann::json picture_json(const ObjectBoxes& boxes, const CameraNames& cameras) {
  const PictureBox& box = boxes.picture;
  nlohmann::json json = {{"left", box.left}, {"top", box.top}, {"right", box.right}, {"bottom", box.bottom}};
  if (const auto name = cameras.find(boxes.camera); name != cameras.end())
    json["camera"] = escape_name(name->second);
  return json;
}

/// The box that is compared, with its height if the detections have one.
nlohmann::json box_json(const ObjectBoxes& boxes, Matching matching, bool heights,
                        const CameraNames& cameras) {
  if (matching.in_picture()) return picture_json(boxes, cameras);
  nlohmann::json json = box_json(boxes.box.bev);
  if (heights && boxes.box.height > 0) json["bottom"] = boxes.box.bottom, json["height"] = boxes.box.height;
  return json;
}

/// `cameras`: one entry for each frame.
nlohmann::json detections_json(const DetectionRun& run, const Capabilities& can,
                               const std::vector<CameraNames>& cameras) {
  nlohmann::json frames = nlohmann::json::array();
  for (std::size_t i = 0; i < run.ids.size(); ++i) {
    nlohmann::json detections = nlohmann::json::array(), boxes = nlohmann::json::array();
    for (const Detection& proposal : run.frames[i].detections) {
      nlohmann::json entry = box_json(proposal, run.matching, can.finds_heights, cameras[i]);
      if (proposal.velocity)
        entry["velocity"] = {proposal.velocity->x(), proposal.velocity->y(), proposal.velocity->z()};
      if (can.types.size() > 1 || can.types.front() != kCars)
        entry["type"] = can.types.at(as_size(proposal.type));
      if (proposal.identity >= 0) entry["identity"] = proposal.identity;
      if (!run.matching.in_picture() && area(proposal.picture) > 0)
        entry["picture"] = picture_json(proposal, cameras[i]);
      entry["score"] = proposal.score();
      detections.push_back(std::move(entry));
    }
    for (const ObjectBoxes& box : run.frames[i].truth.boxes)
      boxes.push_back(box_json(box, run.matching, can.finds_heights, cameras[i]));
    frames.push_back({{"frame", escape_name(run.ids[i])}, {"detections", detections}, {"vehicles", boxes}});
  }
  return {{"frames", frames}};
}

/// Without a vehicle there are no figures: null.
nlohmann::json scores_json(const ScoredStratum& part) {
  const auto figure = [&](double value) {
    return part.at50.boxes > 0 ? nlohmann::json(value) : nlohmann::json();
  };
  return {{"vehicles", part.at50.boxes},
          {"ap50", figure(part.at50.average_precision)},
          {"ap70", figure(part.at70.average_precision)},
          {"recall50", figure(part.at50.recall)},
          {"recall70", figure(part.at70.recall)}};
}

std::string key(std::string name) {
  std::replace(name.begin(), name.end(), ' ', '_');
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
}

/// By Mirage's rules, percent; none where there is no vehicle. The first row's figures stand with their
/// intervals.
void print_scores(const std::vector<ScoredStratum>& parts, const Interval& ap50, const Interval& ap70) {
  Columns rows = {{"", "vehicles", "AP 0.5 (95 %)", "AP 0.7 (95 %)", "recall 0.5", "recall 0.7"}};
  for (const auto& [stratum, at50, at70] : parts) {
    const bool all = &stratum == &parts.front().stratum;
    if (at50.boxes == 0) {
      rows.push_back({stratum.name, "0", "none", "none", "none", "none"});
      continue;
    }
    const auto ap = [&](const PrecisionRecall& at, const Interval& interval) {
      return all ? percent(interval) : percent(at.average_precision);
    };
    rows.push_back({stratum.name, std::to_string(at50.boxes), ap(at50, ap50), ap(at70, ap70),
                    percent(at50.recall), percent(at70.recall)});
  }
  print_columns(rows);
}

/// By the kit's rules: a level without cars has no figure.
void print_kitti(const nlohmann::json& kitti) {
  for (const char* plane : {"bev", "image"}) {
    if (!kitti.contains(plane)) continue;
    std::string text;
    for (const char* level : {"easy", "moderate", "hard"}) {
      const nlohmann::json &at70 = kitti[plane][level], &at50 = kitti["iou50"][plane][level];
      text += fmt::format(
          "   {} {}", level,
          at70.is_null() ? "none"
                         : fmt::format("{} ({})", percent(at70.get<double>()), percent(at50.get<double>())));
    }
    std::printf("AP by KITTI's kit, %s, IoU 0.7 (0.5):%s\n", plane, text.c_str());
  }
}

void add_options(CLI::App& app, DetectOptions& options) {
  add_fields(app, static_cast<FrameSource&>(options), {"depth", "rooftop", "placement", "sun"});
  add_fields(app, options.detector);
  add_defaulted(app, "--frames", options.frames, "only the first N frames (0: all)");
  app.add_option(
         "--check", options.check,
         "also check how the detector is connected: boxes against labels, and gradients against finite "
         "differences at the first N vehicles found")
      ->check(within({1, 1000}));
  app.add_option("--kitti", options.kitti,
                 "also write KITTI result files ID.txt into this folder (heights come from the sweep)");
  add_cache_note(app);
}

nlohmann::json run(const DetectOptions& options, const Common& common) {
  const DetectorOptions detector_options = with_common(options.detector, common, options);
  check_known_options(detector_options, options.check > 0);
  check_data(options.data, options.rig, UnitUse::reads_sweeps);
  // One of ours works on all threads by itself; a program is started once a thread.
  DetectorPool pool;
  if (!is_program(detector_options.detector)) pool.push_back(load_detector(detector_options));
  const std::vector<std::string> frames = list_frames(options.data, options.frames);
  if (pool.empty()) pool = load_detector_pool(detector_options, static_cast<int>(frames.size()));
  const std::vector<Detector*> detectors = instances(pool);
  Detector* const detector = detectors.front();
  const LabelCensus census = count_labels(options.data, frames, options.classes);
  if (rank() == 0) warn_of_labels(census);
  if (!options.kitti.empty()) make_output_folder(options.kitti);
  const Capabilities can = detector->capabilities();
  std::vector<KittiFrame> kitti(frames.size());
  std::vector<CleanFrame> clean(frames.size());
  std::vector<CameraNames> cameras(frames.size());
  const auto seen = [&](std::size_t place, const Frame& frame, const std::vector<Detection>& proposals) {
    CleanFrame& here = clean[place];
    here.scored = scored(proposals, ground_truth(frame, detector->region(), can), frame.calibration.camera.fy,
                         can.matching());
    here.proposals = proposals;
    here.width = frame.image.width, here.height = frame.image.height;
    for (const TruthBox& box : here.scored.truth.boxes)
      here.hosts.emplace_back(frame, frame.labels[box.label], can.matching());
    kitti[place] = kitti_frame(frame, proposals, can.matching(), can.types);
    cameras[place] = cameras_by_place(frame, can);
    if (!options.kitti.empty())
      write_results(options.kitti / (frame.id + ".txt"), kitti[place].detections, frame.calibration);
  };
  const DetectionRun run = detect_data_set(
      detectors, recorded_frames(options, detector_identity(detector_options, can.version), "detect"),
      options.frames, progress_of("detect", common.quiet), seen);
  if (rank() > 0) return nlohmann::json::object();  // the first tells
  add_detector(*common.provenance, detector_options);
  common.provenance->set("classes", options.classes);
  common.provenance->input("sensors", sensors_identity(options.sensors));
  add_data(*common.provenance, options.data, frames, options.cameras);
  write_json(common.out / "detections.json", detections_json(run, can, cameras));
  std::vector<ScoredStratum> parts(1);
  parts[0].stratum.name = "all";
  parts[0].at50 = run.at50, parts[0].at70 = run.at70;
  parts.insert(parts.end(), run.strata.begin(), run.strata.end());
  const Interval ap50 = average_precision_interval(run.frames, 0.5),
                 ap70 = average_precision_interval(run.frames, 0.7);
  std::vector<Matching> ways;
  if (can.finds_bev) ways.push_back(kFromAbove);
  if (can.finds_heights) ways.push_back(kInSpace);
  if (can.finds_picture) ways.push_back(kInPicture);
  const nlohmann::json by_kit = kitti_ap_json(kitti, ways);
  const ClusterCount clusters = clusters_of(run.frames);
  const CleanPerformance found = clean_performance(clean, run.matching);
  const bool any_truth = run.at50.boxes > 0;
  if (!common.quiet) {
    std::printf("frames %zu   %.3f s a frame   AP by Mirage's rules, %s\n", run.ids.size(),
                run.seconds_per_frame, describe(run.matching).c_str());
    if (any_truth) {
      print_scores(parts, ap50, ap70);
      print_kitti(by_kit);
      print_table({{"intervals over", to_string(clusters)}});
    } else {
      std::printf("no labelled vehicle counts as ground truth, so there is no AP\n");
    }
  }
  nlohmann::json result = scores_json(parts[0]);
  result["found"] = found.found;
  result["hints"] = found.hints;
  if (options.check > 0) {
    FrameStore store(options);
    const BoxHabits habits = !run.matching.in_picture() ? box_habits(clean) : BoxHabits();
    const SeenChange change = seen_change(*detector, store, run.ids, options.check);
    result["check"] = {{"boxes", fields_json(habits)}, {"gradient", fields_json(change)}};
    print_table(rows_of(found, habits, change));
  } else if (any_truth && !found.hints.empty()) {
    spdlog::warn("{} {}, but {}", detector->name(), describe(found), fmt::join(found.hints, "; "));
  }
  result["frames"] = run.ids.size();
  result["unlabelled_frames"] = census.unlabelled;
  result["ap50_interval"] = to_json(ap50);
  result["ap70_interval"] = to_json(ap70);
  result["kitti_ap"] = by_kit;
  result["detector"] = detector->name();
  result["plane"] = run.matching.name();
  result["precision"] = usable_precision(detector_options.precision);
  result["clusters"] = to_json(clusters);
  result["seconds_per_frame"] = run.seconds_per_frame;
  if (!any_truth) {
    std::filesystem::remove(common.out / "precision_recall.json");  // of an earlier run
    return result;
  }
  for (const ScoredStratum& part : run.strata) result["strata"][key(part.stratum.name)] = scores_json(part);
  const std::vector<ScoredFrame> easier = without_look_alikes(run.frames);
  const double easier50 = average_precision(easier, 0.5).average_precision,
               easier70 = average_precision(easier, 0.7).average_precision;
  result["without_lookalikes"] = {{"ap50", easier50}, {"ap70", easier70}};
  const bool any = std::any_of(run.frames.begin(), run.frames.end(),
                               [](const ScoredFrame& frame) { return !frame.truth.look_alikes.empty(); });
  if (!common.quiet && any)
    std::fputs(
        fmt::format("with look-alikes ignored: AP 0.5 {}   AP 0.7 {}\n", percent(easier50), percent(easier70))
            .c_str(),
        stdout);
  result["plots"] =
      plot_precision_recall(parts, detector->name() + ": " + describe(run.matching), common.out);
  return result;
}

}  // namespace

Command detect_command() {
  return command_of<DetectOptions>({
      .name = "detect",
      .help =
          "runs a detector over a data set and scores it (AP in the bird's-eye view, or in the picture if "
          "the detector finds boxes only there)",
      .example = "mirage detect --data path/to/kitti --detector fusion",
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
