// mirage detect: runs a detector over a data set and scores it.
#include "detection/detect.h"

#include <algorithm>
#include <cstdio>
#include <memory>

#include "base/error.h"
#include "base/files.h"
#include "base/names.h"
#include "base/progress.h"
#include "cli/detector_options.h"
#include "cli/picture_rows.h"
#include "detection/defense_words.h"
#include "detection/detection_files.h"
#include "detection/kitti_ap.h"
#include "detection/reliance.h"
#include "frames/data_check.h"
#include "frames/made_of.h"
#include "scene/data/label_census.h"
#include "validation/report/detection_plot.h"

namespace mirage::cli {
namespace {

struct DetectOptions {
  std::filesystem::path data;
  std::string rig;
  DetectorOptions detector;
  std::size_t frames = 0;
  bool reliance = false;
  std::filesystem::path claim, kitti;
};

/// The measured detectors that the file holds; none if there is no file.
nlohmann::json read_claims(const std::filesystem::path& file) {
  if (!std::filesystem::exists(file)) return nlohmann::json::object();
  nlohmann::json claims = read_json(file, kLargestRecord);
  if (!claims.is_object())
    throw InputError(file.string(), "", "is no object of measured detectors",
                     "name another file with --claim");
  return claims;
}

/// Puts what was measured under the weights' name into the file that the tests hold it against.
void write_claim(const std::filesystem::path& file, const DetectorOptions& detector,
                 const std::filesystem::path& data, const Reliance& reliance) {
  const Defense defense = read_defense(detector.defense);
  if (defense.around != read_defense(defense.weights).around)
    throw FieldError("claim", file.string(), "is of weights, and the defence stands around them",
                     "leave --defense or --claim out");
  const std::filesystem::path weights = weights_file(detector);
  nlohmann::json claims = read_claims(file);
  claims[weights.stem().string()] = to_json(reliance);
  claims[weights.stem().string()].update(
      {{"data", data.filename().string()}, {"weights_hash", file_hash(weights)}});
  write_json(file, claims);
}

nlohmann::json box_json(const BevBox& box) {
  return {{"x", box.x}, {"y", box.y}, {"length", box.length}, {"width", box.width}, {"yaw", box.yaw}};
}

nlohmann::json box_json(const PictureBox& box) {
  return {{"left", box.left}, {"top", box.top}, {"right", box.right}, {"bottom", box.bottom}};
}

/// A rectangle of the plane where the detector is judged, by its names there.
nlohmann::json box_json(const BevBox& rectangle, Plane plane) {
  return plane == Plane::picture ? box_json(picture_box(rectangle)) : box_json(rectangle);
}

nlohmann::json detections_json(const DetectionRun& run) {
  nlohmann::json frames = nlohmann::json::array();
  for (std::size_t i = 0; i < run.ids.size(); ++i) {
    nlohmann::json detections = nlohmann::json::array(), boxes = nlohmann::json::array();
    for (const Proposal& proposal : run.frames[i].detections) {
      nlohmann::json entry = box_json(rectangle(proposal, run.plane), run.plane);
      if (run.plane == Plane::bev && area(proposal.picture) > 0)
        entry["picture"] = box_json(proposal.picture);
      entry["score"] = proposal.score();
      detections.push_back(std::move(entry));
    }
    for (const BevBox& box : run.frames[i].truth.boxes) boxes.push_back(box_json(box, run.plane));
    frames.push_back({{"frame", escape_name(run.ids[i])}, {"detections", detections}, {"vehicles", boxes}});
  }
  return {{"frames", frames}};
}

nlohmann::json scores_json(const ScoredStratum& part) {
  return {{"vehicles", part.at50.boxes},
          {"ap50", part.at50.average_precision},
          {"ap70", part.at70.average_precision},
          {"recall50", part.at50.recall},
          {"recall70", part.at70.recall}};
}

std::string key(std::string name) {
  std::replace(name.begin(), name.end(), ' ', '_');
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
}

/// By Mirage's rules, percent. The first row's figures stand with their intervals.
void print_scores(const std::vector<ScoredStratum>& parts, const Interval& ap50, const Interval& ap70) {
  const auto row = [](const std::string& name, const std::string& vehicles, const std::string& at50,
                      const std::string& at70, const std::string& found50, const std::string& found70) {
    std::fputs(fmt::format("{:<10} {:>9} {:>22} {:>22} {:>10} {:>10}\n", name, vehicles, at50, at70, found50,
                           found70)
                   .c_str(),
               stdout);
  };
  row("", "vehicles", "AP 0.5 (95 %)", "AP 0.7 (95 %)", "recall 0.5", "recall 0.7");
  for (const auto& [stratum, at50, at70] : parts) {
    const bool all = &stratum == &parts.front().stratum;
    const auto ap = [&](const PrecisionRecall& at, const Interval& interval) {
      return all ? percent(interval.value, interval.low, interval.high) : percent(at.average_precision);
    };
    row(stratum.name, std::to_string(at50.boxes), ap(at50, ap50), ap(at70, ap70), percent(at50.recall),
        percent(at70.recall));
  }
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
  app.add_option("--data", options.data, "data set (KITTI's object, tracking or raw layout, nuScenes)")
      ->required();
  app.add_option("--rig", options.rig, kRigHelp);
  add_fields(app, options.detector);
  app.add_option("--frames", options.frames, "only the first N frames (0: all)")->capture_default_str();
  const auto reliance = app.add_flag("--reliance", options.reliance,
                                     "also measure whether the detector uses its picture: the same frames "
                                     "with another frame's picture, with a black one and with none");
  app.add_option("--claim", options.claim,
                 "with --reliance: put what was measured under the weights' name into this file "
                 "(plugins/detectors/fusion/weights/reliance.json is what the tests check)")
      ->needs(reliance);
  app.add_option(
      "--kitti", options.kitti,
      "also write KITTI result files ID.txt into this folder, for the official evaluation and other people's "
      "viewers (heights from the sweep: detectors find boxes in the bird's-eye view)");
}

nlohmann::json run(const DetectOptions& options, const Common& common) {
  make_output_folder(common.out);
  if (!options.claim.empty()) read_claims(options.claim);  // now, not after the work
  const DetectorOptions detector_options = with_common(options.detector, common, options.data, options.rig);
  check_data(options.data, options.rig, UnitUse::reads_sweeps);
  const auto detector = load_detector(detector_options);
  const LabelCensus census = count_labels(options.data, first_frames(options.data, options.frames));
  if (options.reliance && census.unlabelled == census.frames) require_cars(census, "--reliance");
  warn_of_labels(census);
  std::unique_ptr<Progress> progress;
  const auto tell = [&](const char* what) {
    return [&progress, what, quiet = common.quiet](std::size_t done, std::size_t total) {
      if (!progress) progress = std::make_unique<Progress>(what, total, quiet);
      progress->update(done);
    };
  };
  if (!options.kitti.empty()) make_output_folder(options.kitti);
  const Capabilities can = detector->capabilities();
  std::vector<KittiFrame> kitti;
  const auto seen = [&](const Frame& frame, const std::vector<Proposal>& proposals) {
    kitti.push_back(kitti_frame(frame, proposals, can.plane()));
    if (!options.kitti.empty())
      write_results(options.kitti / (frame.id + ".txt"), kitti.back().detections, frame.calibration);
  };
  add_detector(*common.made_of, detector_options);
  add_data(*common.made_of, options.data, first_frames(options.data, options.frames));
  std::unique_ptr<RelianceMeter> meter;
  ProposalObserver measure;
  if (options.reliance && reads_picture(*detector)) {
    meter = std::make_unique<RelianceMeter>(options.data, first_frames(options.data, options.frames));
    measure = [&](const Frame& frame, std::span<const LidarPoint> points, const auto& proposals) {
      meter->look(*detector, frame, points, proposals);
    };
  }
  const DetectionRun run =
      detect_data_set(*detector, options.data, options.frames,
                      tell(meter ? "detect, and use of the picture" : "detect"), seen, measure);
  progress.reset();
  write_json(common.out / "detections.json", detections_json(run));
  std::vector<ScoredStratum> parts(1);
  parts[0].stratum.name = "all";
  parts[0].at50 = run.at50;
  parts[0].at70 = run.at70;
  parts.insert(parts.end(), run.strata.begin(), run.strata.end());
  const Interval ap50 = average_precision_interval(run.frames, 0.5),
                 ap70 = average_precision_interval(run.frames, 0.7);
  std::vector<Plane> planes;
  if (can.finds_bev) planes.push_back(Plane::bev);
  if (can.finds_picture) planes.push_back(Plane::picture);
  const nlohmann::json by_kit = kitti_ap_json(kitti, planes);
  const ClusterCount clusters = clusters_of(run.frames);
  const bool scored = run.at50.boxes > 0;
  if (!common.quiet) {
    std::printf("frames %zu   %.3f s a frame   AP by Mirage's rules, %s\n", run.ids.size(),
                run.seconds_per_frame,
                run.plane == Plane::picture ? "boxes in the picture" : "bird's-eye view");
    if (scored) {
      print_scores(parts, ap50, ap70);
      print_kitti(by_kit);
      print_table({{"intervals over", to_string(clusters)}});
    } else {
      std::printf("no vehicle is labelled that must be found: nothing is scored\n");
    }
  }
  nlohmann::json result = scores_json(parts[0]);
  if (!scored)
    for (const char* figure : {"ap50", "ap70", "recall50", "recall70"}) result[figure] = nullptr;
  result["frames"] = run.ids.size();
  result["unlabelled_frames"] = census.unlabelled;
  result["ap50_interval"] = to_json(ap50);
  result["ap70_interval"] = to_json(ap70);
  result["kitti_ap"] = by_kit;
  result["detector"] = detector->name();
  result["plane"] = to_string(run.plane);
  result["precision"] = usable_precision(detector_options.precision);
  result["clusters"] = to_json(clusters);
  if (options.reliance) {
    const Reliance reliance = meter ? meter->result() : no_camera();
    result["reliance"] = to_json(reliance);
    if (!options.claim.empty()) write_claim(options.claim, detector_options, options.data, reliance);
    if (!common.quiet) print_table(picture_rows(reliance));
  }
  result["seconds_per_frame"] = run.seconds_per_frame;
  if (!scored) return result;
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
  result["plots"] = plot_precision_recall(parts, detector->name(), common.out);
  return result;
}

}  // namespace

Command detect_command() {
  auto options = std::make_shared<DetectOptions>();
  return Command{
      .name = "detect",
      .help =
          "runs a detector over a data set and scores it (AP in the bird's-eye view; in the picture for a "
          "detector of that alone)",
      .default_out = "out/detect",
      .example = "mirage detect --data path/to/kitti --detector fusion --reliance",
      .options = [options](CLI::App& app) { add_options(app, *options); },
      .run = [options](const Common& common) { return run(*options, common); },
  };
}

}  // namespace mirage::cli
