#include "attack/host_labels.h"

#include <atomic>
#include <string>
#include <vector>

#include "attack/evaluation.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/parallel.h"
#include "detection/detect.h"
#include "detection/upright.h"
#include "scene/data/kitti.h"
#include "scene/data/layouts.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

/// The cars of a frame, by what a detector finds there.
std::vector<Label> found_cars(Detector& detector, const Frame& frame, double score) {
  std::vector<Label> labels;
  for (const Detection& found : detect_vehicles(detector, frame, score))
    if (auto label = projected_label("Car", upright(found, frame.sweep), frame.calibration))
      labels.push_back(std::move(*label));
  return labels;
}

}  // namespace

std::filesystem::path label_by_detections(const AttackSettings& settings, const DetectorPool& detectors) {
  const Detector& detector = *detectors.front();
  if (detector.capabilities().matching().in_picture())
    throw FieldError("hosts_from", "detections",
                     detector.name() + " finds boxes in the picture, which stand nowhere in space",
                     "use a detector that reads the LiDAR's returns");
  std::vector<std::string> unlabelled;
  for (const std::string& id : list_frames(settings.data))
    if (!read_annotations(settings.data, id).labelled) unlabelled.push_back(id);
  if (unlabelled.empty())
    throw FieldError("hosts_from", "detections", "every frame has labels", "leave it out");
  const std::filesystem::path folder = settings.out / "labelled";
  const double score = EvaluationSettings{}.score_threshold;
  std::atomic<std::size_t> cars = 0;
  parallel_for(detectors.size(), [&](std::size_t worker) {
    for (std::size_t i = worker; i < unlabelled.size(); i += detectors.size()) {
      throw_if_interrupted("frames are looked at anew");
      const Frame frame = read_frame(settings.data, unlabelled[i]);
      const std::vector<Label> found = found_cars(*detectors[worker], frame, score);
      cars += found.size();
      write_labels(folder / "label_2" / (frame.id + ".txt"), found, frame.calibration);
    }
  });
  write_given_labels(folder, settings.data,
                     {{"detector", settings.detector.detector},
                      {"weights", escape_name(settings.detector.weights.string())},
                      {"score", score}});
  spdlog::warn("{} cars in {} frames without labels are {}'s own boxes: of its AP on them nothing follows",
               cars.load(), unlabelled.size(), detector.name());
  return folder;
}

}  // namespace mirage
