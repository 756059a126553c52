#include "detection/detect.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <future>
#include <iterator>

#include "base/error.h"
#include "base/interrupt.h"
#include "base/parallel.h"
#include "detection/points_in_view.h"
#include "detection/upright.h"
#include "scene/data/layouts.h"
#include "scene/data/read_frames.h"

namespace mirage {

std::vector<Proposal> scored_over(std::span<const Proposal> proposals, double least) {
  std::vector<Proposal> kept;
  std::copy_if(proposals.begin(), proposals.end(), std::back_inserter(kept),
               [&](const Proposal& proposal) { return proposal.score() > least; });
  return kept;
}

std::vector<Proposal> detect_vehicles(Detector& detector, const ImageF& image, const Sweep& sweep,
                                      const Calibration& calibration, double score_threshold) {
  const std::vector<LidarPoint> points = points_in_view(sweep, calibration);
  return suppress(detector.forward({&image, points, &calibration}, score_threshold, false),
                  detector.capabilities().plane());
}

std::vector<std::string> first_frames(const std::filesystem::path& data, std::size_t limit) {
  std::vector<std::string> ids = list_frames(data);
  if (limit > 0 && ids.size() > limit) ids.resize(limit);
  return ids;
}

namespace {

/// InputError for a box that no reader of the files takes: what is written must be read.
void check_detections(std::span<const Proposal> detections, Plane plane, const std::string& who) {
  if (plane == Plane::picture) return;
  for (std::size_t i = 0; i < detections.size(); ++i)
    if (const std::string problem = box_problem({detections[i].box, 0, kNominalHeight}); !problem.empty())
      throw InputError(
          who, fmt::format("box {} of {}", i, detections.size()),
          fmt::format("x {:g}, y {:g}, length {:g}, width {:g} m {}", detections[i].box.x,
                      detections[i].box.y, detections[i].box.length, detections[i].box.width, problem),
          "limit the sizes and places that the network gives");
}

}  // namespace

DetectionRun detect_data_set(Detector& detector, const std::filesystem::path& data, std::size_t limit,
                             const std::function<void(std::size_t, std::size_t)>& progress,
                             const std::function<void(const Frame&, const std::vector<Proposal>&)>& seen,
                             const ProposalObserver& proposed) {
  using Clock = std::chrono::steady_clock;
  DetectionRun run;
  run.plane = detector.capabilities().plane();
  run.ids = first_frames(data, limit);
  double seconds = 0;
  const auto policy = thread_count() > 1 ? std::launch::async : std::launch::deferred;
  const auto read = [&](std::size_t i) {
    return std::async(policy, [&data, id = run.ids[i]] { return read_frame(data, id); });
  };
  std::future<Frame> next;
  if (!run.ids.empty()) next = read(0);
  for (std::size_t i = 0; i < run.ids.size(); ++i) {
    throw_if_interrupted("no results were written yet");
    const Frame frame = next.get();
    if (i + 1 < run.ids.size()) next = read(i + 1);
    const std::vector<LidarPoint> points = points_in_view(frame.sweep, frame.calibration);
    const auto start = Clock::now();
    const std::vector<Proposal> proposals = detector.forward(
        {&frame.image, points, &frame.calibration}, proposed ? kFaintScore : kScoreThresholdForAp, false);
    auto detections = suppress(scored_over(proposals, kScoreThresholdForAp), run.plane);
    seconds += std::chrono::duration<double>(Clock::now() - start).count();
    check_detections(detections, run.plane, detector.name() + ", frame " + run.ids[i]);
    if (proposed) proposed(frame, points, proposals);
    if (seen) seen(frame, detections);
    run.frames.push_back(scored(std::move(detections), ground_truth(frame, detector.region()),
                                frame.calibration.camera.fy, run.plane));
    if (progress) progress(i + 1, run.ids.size());
  }
  run.at50 = average_precision(run.frames, 0.5);
  run.at70 = average_precision(run.frames, 0.7);
  for (const Stratum& stratum : standard_strata())
    run.strata.push_back(
        {stratum, average_precision(run.frames, 0.5, stratum), average_precision(run.frames, 0.7, stratum)});
  run.seconds_per_frame = run.ids.empty() ? 0 : seconds / static_cast<double>(run.ids.size());
  return run;
}

}  // namespace mirage
