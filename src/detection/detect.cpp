#include "detection/detect.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <future>
#include <iterator>
#include <mutex>
#include <optional>

#include "base/error.h"
#include "base/interrupt.h"
#include "base/json_rows.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "detection/car_in_picture.h"
#include "detection/points_in_view.h"
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

/// A frame's detections, and what they took, s.
struct Look {
  std::vector<Detection> detections;
  double seconds = 0;
};

Look look_at(Detector& detector, const Frame& frame, Matching matching) {
  using Clock = std::chrono::steady_clock;
  const std::vector<LidarPoint> points = RecordedFrames::points(frame);
  const auto start = Clock::now();
  auto detections =
      suppress(detector.forward(view_of(frame, frame.image, points), kScoreThresholdForAp, false), matching);
  return {std::move(detections), std::chrono::duration<double>(Clock::now() - start).count()};
}

}  // namespace

Frame RecordedFrames::read(const std::string& id) const {
  Frame frame = read_frame(data, id, cameras);
  seek(classes_of(classes), frame.labels);
  if (add_measurements) add_measurements(frame);
  return frame;
}

std::vector<LidarPoint> RecordedFrames::points(const Frame& frame) {
  return frame.others.empty() ? points_in_view(frame.sweep, frame.calibration) : frame.sweep;
}

DetectionRun detect_data_set(
    std::span<Detector* const> detectors, const RecordedFrames& frames, std::size_t limit,
    const std::function<void(std::size_t, std::size_t)>& progress,
    const std::function<void(std::size_t, const Frame&, const std::vector<Detection>&)>& seen) {
  DetectionRun run;
  run.matching = detectors.front()->capabilities().matching();
  run.ids = first_frames(frames.data, limit);
  run.frames.resize(run.ids.size());
  const bool tells = rank() == 0;  // the others fill what is kept, and read nothing that is there
  const std::vector<std::size_t> order = order_among_ranks(run.ids.size());
  std::atomic<std::size_t> next = 0;
  const auto policy = tells && thread_count() > 1 ? std::launch::async : std::launch::deferred;
  struct Reading {
    std::size_t place;  ///< of the frame; past the end: none is left
    std::future<Frame> frame = {};
  };
  const auto take = [&]() -> Reading {
    const std::size_t k = next++;
    if (k >= order.size()) return {order.size()};
    return {order[k], std::async(policy, [&frames, id = run.ids[order[k]]] { return frames.read(id); })};
  };
  double seconds = 0;
  std::mutex mutex;
  std::size_t done = 0, looked = 0;
  const auto look = [&](Detector& detector, const Frame& frame) {
    Look at = look_at(detector, frame, run.matching);
    const std::lock_guard lock(mutex);
    seconds += at.seconds;
    ++looked;
    return std::move(at.detections);
  };
  parallel_for(detectors.size(), [&](std::size_t worker) {
    Detector& detector = *detectors[worker];
    for (Reading reading = take(); reading.place < order.size();) {
      throw_if_interrupted(frames.kept ? "run it again: it goes on" : "no results were written yet");
      const std::size_t i = reading.place;
      std::optional<Frame> frame;
      if (tells) frame = reading.frame.get();
      Reading ahead = take();
      const auto now = [&] {
        if (!frame) frame = reading.frame.get();
        return look(detector, *frame);
      };
      std::vector<Detection> detections = frames.kept ? frames.kept(run.ids[i], now) : now();
      check_readable(detections, run.matching, detector.name() + ", frame " + run.ids[i]);
      const std::lock_guard lock(mutex);
      if (tells) {
        if (seen) seen(i, *frame, detections);
        run.frames[i] = scored(std::move(detections), ground_truth(*frame, detector.region()),
                               frame->calibration.camera.fy, run.matching);
      }
      if (progress) progress(++done, run.ids.size());
      reading = std::move(ahead);
    }
  });
  if (!tells) return run;
  if (looked == 0 && !run.ids.empty()) {  // all was kept; a network's first pass is slower than others
    const Frame frame = frames.read(run.ids.front());
    look_at(*detectors.front(), frame, run.matching);
    look(*detectors.front(), frame);
  }
  run.at50 = average_precision(run.frames, 0.5);
  run.at70 = average_precision(run.frames, 0.7);
  for (const Stratum& stratum : standard_strata())
    run.strata.push_back(
        {stratum, average_precision(run.frames, 0.5, stratum), average_precision(run.frames, 0.7, stratum)});
  run.seconds_per_frame = seconds / static_cast<double>(std::max<std::size_t>(1, looked));
  return run;
}

namespace {

constexpr const char* kFix = "write it again with mirage detect";

namespace fs = std::filesystem;
using nlohmann::json;

/// The ID.txt of a folder, by ID.
std::map<std::string, fs::path> texts_of(const fs::path& folder) {
  std::map<std::string, fs::path> texts;
  for (const auto& entry : fs::directory_iterator(folder))
    if (entry.is_regular_file() && entry.path().extension() == ".txt")
      texts[entry.path().stem().string()] = entry.path();
  return texts;
}

double number(const json& from, const char* key, const fs::path& file, const std::string& where) {
  if (!from.is_object() || !from.contains(key) || !from[key].is_number() ||
      !std::isfinite(from[key].get<double>()))
    throw InputError(file.string(), where + "." + key, "is missing or not a finite number", kFix);
  return from[key].get<double>();
}

PictureBox picture_of(const json& from, const fs::path& file, const std::string& where) {
  const PictureBox box{number(from, "left", file, where), number(from, "top", file, where),
                       number(from, "right", file, where), number(from, "bottom", file, where)};
  if (box.right < box.left || box.bottom < box.top)
    throw InputError(file.string(), where, "right lies left of left, or bottom over top", kFix);
  return box;
}

ListedDetection detection_of(const json& from, const fs::path& file, const std::string& where) {
  ListedDetection detection{number(from, "score", file, where), {}, {}};
  if (from.contains("left")) {  // a detector of the picture alone
    detection.picture = picture_of(from, file, where);
    return detection;
  }
  Box3& box = detection.box.emplace();
  box.bev = {number(from, "x", file, where), number(from, "y", file, where),
             number(from, "length", file, where), number(from, "width", file, where),
             number(from, "yaw", file, where)};
  if (from.contains("height"))
    box.bottom = number(from, "bottom", file, where), box.height = number(from, "height", file, where);
  if (const std::string problem =
          box_problem({box.bev, box.bottom, box.height > 0 ? box.height : kNominalHeight});
      !problem.empty())
    throw InputError(file.string(), where, "the box " + problem, kFix);
  if (from.contains("picture")) detection.picture = picture_of(from["picture"], file, where + ".picture");
  return detection;
}

}  // namespace

std::vector<KittiDetection> kitti_detections(std::span<const Detection> proposals, Matching matching,
                                             const Frame& frame, const std::vector<std::string>& types) {
  std::vector<KittiDetection> result;
  for (const Detection& proposal : proposals) {
    KittiDetection detection;
    detection.score = proposal.score();
    detection.type = types.at(static_cast<std::size_t>(proposal.type));
    if (!matching.in_picture()) detection.box = upright(proposal, frame.sweep);
    if (area(proposal.picture) > 0) detection.picture = proposal.picture;
    result.push_back(detection);
  }
  return result;
}

DetectionFiles::DetectionFiles(const fs::path& path) : path_(path) {
  const auto none = [&](const std::string& problem) {
    return InputError(path.string(), "", problem,
                      "give detections.json of mirage detect, or KITTI result files (ID.txt)");
  };
  if (!fs::exists(path)) throw none("No such file or folder");
  if (fs::is_directory(path)) {
    if (fs::exists(path / "detections.json")) {
      path_ = path / "detections.json";
    } else {
      texts_ = texts_of(path);
      if (texts_.empty() && fs::is_directory(path / "data")) texts_ = texts_of(path / "data");
      if (texts_.empty()) throw none("holds no detections");
      return;
    }
  } else if (path.extension() == ".txt") {
    texts_[path.stem().string()] = path;
    return;
  }
  for_each_json_row(path_, "frames", kFix, [&](std::size_t i, const json& frame) {
    if (!frame.is_object() || !frame.contains("frame") || !frame["frame"].is_string() ||
        !frame.contains("detections") || !frame["detections"].is_array())
      throw InputError(path_.string(), fmt::format("frames.{}", i),
                       "has no frame's name or no list of detections", kFix);
    const std::string id = unescape_name(frame["frame"].get<std::string>());
    std::vector<ListedDetection>& listed = frames_[id];
    listed.clear();
    for (const json& from : frame["detections"])
      listed.push_back(detection_of(from, path_, fmt::format("frame {}, detection {}", id, listed.size())));
  });
}

bool DetectionFiles::has(const std::string& id) const {
  return texts_.contains(id) || frames_.contains(id);
}

std::vector<KittiDetection> DetectionFiles::of(const Frame& frame) const {
  std::vector<KittiDetection> detections;
  if (const auto text = texts_.find(frame.id); text != texts_.end()) {
    detections = read_results(text->second, frame.calibration);
  } else if (const auto listed = frames_.find(frame.id); listed != frames_.end()) {
    for (const ListedDetection& from : listed->second) {
      KittiDetection detection;
      detection.score = from.score;
      if (from.box) detection.box = upright({*from.box, {}}, frame.sweep);
      if (from.picture) detection.picture = *from.picture;
      detections.push_back(detection);
    }
  }
  std::stable_sort(detections.begin(), detections.end(),
                   [](const auto& a, const auto& b) { return a.score > b.score; });
  return detections;
}

}  // namespace mirage
