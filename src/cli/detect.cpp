// mirage detect: runs a detector over a data set and scores it.
#include "detection/detect.h"

#include <memory>

#include "base/files.h"
#include "base/progress.h"
#include "cli/command.h"

namespace mirage::cli {
namespace {

struct DetectOptions {
  std::filesystem::path data;
  DetectorOptions detector;
  std::size_t frames = 0;
};

nlohmann::json box_json(const BevBox& box) {
  return {{"x", box.x}, {"y", box.y}, {"length", box.length}, {"width", box.width}, {"yaw", box.yaw}};
}

nlohmann::json detections_json(const DetectionRun& run) {
  nlohmann::json frames = nlohmann::json::array();
  for (std::size_t i = 0; i < run.ids.size(); ++i) {
    nlohmann::json found = nlohmann::json::array(), boxes = nlohmann::json::array();
    for (const Proposal& proposal : run.frames[i].detections) {
      nlohmann::json entry = box_json(proposal.box);
      entry["score"] = proposal.score();
      found.push_back(std::move(entry));
    }
    for (const BevBox& box : run.frames[i].truth.boxes) boxes.push_back(box_json(box));
    frames.push_back({{"frame", run.ids[i]}, {"detections", found}, {"vehicles", boxes}});
  }
  return {{"frames", frames}};
}

}  // namespace

Command detect_command() {
  const auto chosen = std::make_shared<DetectOptions>();
  Command command;
  command.name = "detect";
  command.help = "Runs a detector over a data set and scores it (AP in the bird's-eye view)";
  command.default_out = "out/detect";
  command.options = [chosen](CLI::App& app) {
    app.add_option("--data", chosen->data, "Data set in KITTI layout")->required();
    app.add_option("--detector", chosen->detector.detector, "fusion, lidar or a plugin (*.so)")
        ->capture_default_str();
    app.add_option("--weights", chosen->detector.weights, "Weights file (default: the shipped one)");
    app.add_option("--frames", chosen->frames, "Only the first N frames (0: all)")->capture_default_str();
  };
  command.run = [chosen](const Common& common) -> nlohmann::json {
    make_output_folder(common.out);
    chosen->detector.seed = common.seed;
    chosen->detector.threads = common.threads;
    const auto detector = load_detector(chosen->detector);
    std::unique_ptr<Progress> progress;
    const DetectionRun run =
        detect_data_set(*detector, chosen->data, chosen->frames, [&](std::size_t done, std::size_t total) {
          if (!progress) progress = std::make_unique<Progress>("detect", total, common.quiet);
          progress->update(done);
        });
    progress.reset();
    write_json(common.out / "detections.json", detections_json(run));
    if (!common.quiet)
      std::printf("frames %zu   vehicles %d   AP50 %.3f   AP70 %.3f   recall50 %.3f   %.3f s a frame\n",
                  run.ids.size(), run.at50.boxes, run.at50.average_precision, run.at70.average_precision,
                  run.at50.recall, run.seconds_per_frame);
    return {{"frames", run.ids.size()},           {"vehicles", run.at50.boxes},
            {"ap50", run.at50.average_precision}, {"ap70", run.at70.average_precision},
            {"recall50", run.at50.recall},        {"recall70", run.at70.recall},
            {"detector", detector->name()},       {"seconds_per_frame", run.seconds_per_frame}};
  };
  return command;
}

}  // namespace mirage::cli
