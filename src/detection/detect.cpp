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

std::vector<Detection> scored_over(std::span<const Detection> proposals, double least) {
  std::vector<Detection> kept;
  std::copy_if(proposals.begin(), proposals.end(), std::back_inserter(kept),
               [&](const Detection& proposal) { return proposal.score() > least; });
  return kept;
}

std::vector<Detection> detect_vehicles(Detector& detector, const Frame& frame, double score_threshold) {
  const std::vector<LidarPoint> points = points_in_view(frame.sweep, frame.calibration);
  return suppress(detector.forward(view_of(frame, frame.image, points), score_threshold, false),
                  detector.capabilities().matching());
}

std::vector<std::string> first_frames(const std::filesystem::path& data, std::size_t limit) {
  std::vector<std::string> ids = list_frames(data);
  if (limit > 0 && ids.size() > limit) ids.resize(limit);
  return ids;
}

namespace {

/// InputError for a box that no reader of the files takes: what is written must be read.
void check_readable(std::span<const Detection> detections, Matching matching, const std::string& who) {
  if (matching.in_picture()) return;
  for (std::size_t i = 0; i < detections.size(); ++i) {
    const BevBox& box = detections[i].box.bev;
    if (const std::string problem = box_problem({box, 0, kNominalHeight}); !problem.empty())
      throw InputError(who, fmt::format("box {} of {}", i, detections.size()),
                       fmt::format("x {:g}, y {:g}, length {:g}, width {:g} m {}", box.x, box.y, box.length,
                                   box.width, problem),
                       "limit the sizes and places that the network gives");
  }
}

}  // namespace

DetectionRun detect_data_set(Detector& detector, const std::filesystem::path& data, std::size_t limit,
                             const std::function<void(std::size_t, std::size_t)>& progress,
                             const std::function<void(const Frame&, const std::vector<Detection>&)>& seen) {
  using Clock = std::chrono::steady_clock;
  DetectionRun run;
  run.matching = detector.capabilities().matching();
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
    auto detections = suppress(
        detector.forward(view_of(frame, frame.image, points), kScoreThresholdForAp, false), run.matching);
    seconds += std::chrono::duration<double>(Clock::now() - start).count();
    check_readable(detections, run.matching, detector.name() + ", frame " + run.ids[i]);
    if (seen) seen(frame, detections);
    run.frames.push_back(scored(std::move(detections), ground_truth(frame, detector.region()),
                                frame.calibration.camera.fy, run.matching));
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
