#include "detection/detect.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <future>
#include <mutex>

#include "base/error.h"
#include "base/json_fields.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "base/schedule.h"
#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "scene/data/layouts.h"
#include "scene/data/read_frames.h"

namespace mirage {

std::vector<Detection> scored_over(std::vector<Detection> proposals, double least) {
  std::erase_if(proposals, [&](const Detection& proposal) { return !(proposal.score() > least); });
  return proposals;
}

std::vector<Detection> detect_vehicles(Detector& detector, const Frame& frame, double score_threshold) {
  const std::vector<LidarPoint> points = points_in_view(frame.sweep, frame.calibration);
  return suppress(detector.forward(view_of(frame, frame.image, points), score_threshold, false),
                  detector.capabilities().matching());
}

namespace {

/// InputError for a box that readers of the files refuse: written files must be readable.
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

constexpr const char* kFix = "write it again with mirage detect";

namespace fs = std::filesystem;
using nlohmann::json;

/// The files ID.txt of a folder, by ID.
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

/// A text that is optional in the file.
std::string optional_text(const json& from, const char* key, const std::string& otherwise,
                          const fs::path& file, const std::string& where) {
  if (!from.contains(key)) return otherwise;
  if (!from[key].is_string()) throw InputError(file.string(), where + "." + key, "is not text", kFix);
  return unescape_name(from[key].get<std::string>());
}

KittiDetection detection_of(const json& from, const fs::path& file, const std::string& where) {
  KittiDetection detection;
  detection.score = number(from, "score", file, where);
  detection.type = optional_text(from, "type", detection.type, file, where);
  if (!(detection.score >= 0 && detection.score <= 1))
    throw InputError(file.string(), where + ".score",
                     fmt::format("{:g} is not a score from 0 to 1", detection.score), kFix);
  if (from.contains("left")) {  // a detector of the picture alone
    detection.picture = picture_of(from, file, where);
    detection.camera = optional_text(from, "camera", "", file, where);
    return detection;
  }
  Box3& box = detection.box.emplace();
  box.bev = {number(from, "x", file, where), number(from, "y", file, where),
             number(from, "length", file, where), number(from, "width", file, where),
             number(from, "yaw", file, where)};
  if (from.contains("height"))
    box.bottom = number(from, "bottom", file, where), box.height = number(from, "height", file, where);
  if (from.contains("height") && box.height <= 0)
    throw InputError(file.string(), where + ".height", fmt::format("{:g} m is not a height", box.height),
                     kFix);
  if (const std::string problem =
          box_problem({box.bev, box.bottom, box.height > 0 ? box.height : kNominalHeight});
      !problem.empty())
    throw InputError(file.string(), where, "the box " + problem, kFix);
  if (from.contains("picture")) {
    detection.picture = picture_of(from["picture"], file, where + ".picture");
    detection.camera = optional_text(from["picture"], "camera", "", file, where + ".picture");
  }
  return detection;
}

constexpr int kRecalls = 41;

/// The role of a label or a detection at one level.
enum class MatchRole { counts, ignored, absent };

/// The kit reads a label's height as too low where it equals the limit.
MatchRole role_of(const Label& label, Difficulty level) {
  const DifficultyLimits& limits = limits_of(level);
  if (label.type == "Van") return MatchRole::ignored;
  if (label.type != "Car") return MatchRole::absent;
  const bool hard = label.occluded > limits.most_occluded || label.truncated > limits.most_truncated ||
                    label.bottom - label.top <= limits.least_height;
  return hard ? MatchRole::ignored : MatchRole::counts;
}

MatchRole role_of(const KittiDetection& detection, Difficulty level) {
  const double height = detection.picture ? detection.picture->bottom - detection.picture->top : 0;
  if (height < limits_of(level).least_height) return MatchRole::ignored;
  return detection.type == "Car" ? MatchRole::counts : MatchRole::absent;
}

/// A frame at one level: roles and overlaps.
struct Judgement {
  std::vector<MatchRole> labels, detections;
  std::vector<double> scores;
  std::vector<std::vector<double>> iou;      ///< of label and detection
  std::vector<std::vector<double>> covered;  ///< of DontCare region and detection: share of the detection
};

Judgement judgement(const KittiFrame& frame, Matching matching, Difficulty level) {
  Judgement result;
  std::vector<ObjectBoxes> boxes;
  for (const KittiDetection& detection : frame.detections) {
    result.detections.push_back(role_of(detection, level));
    result.scores.push_back(detection.score);
    boxes.push_back({detection.box.value_or(Box3{}), detection.picture.value_or(PictureBox{})});
  }
  for (const Label& label : frame.labels) {
    const ObjectBoxes box = boxes_of(label);
    if (label.camera != 0 || (!matching.in_picture() && !has_box(label))) continue;  // the kit has one camera
    if (label.type == "DontCare") {
      result.covered.emplace_back();
      for (const ObjectBoxes& other : boxes) {
        const double area = matching.area(other);
        result.covered.back().push_back(area > 0 ? matching.intersection(other, box) / area : 0);
      }
      continue;
    }
    const MatchRole role = role_of(label, level);
    if (role == MatchRole::absent) continue;
    result.labels.push_back(role);
    result.iou.emplace_back();
    for (const ObjectBoxes& other : boxes) result.iou.back().push_back(matching.overlap(other, box));
  }
  return result;
}

/// Scores of the hits, for the curve's thresholds: each label takes its detection of the highest score.
std::vector<double> hit_scores(const Judgement& frame, double min_iou) {
  std::vector<double> scores;
  std::vector<char> taken(frame.detections.size(), 0);
  for (std::size_t i = 0; i < frame.labels.size(); ++i) {
    std::size_t best = taken.size();
    for (std::size_t k = 0; k < taken.size(); ++k)
      if (!taken[k] && frame.detections[k] != MatchRole::absent && frame.iou[i][k] > min_iou &&
          (best == taken.size() || frame.scores[k] > frame.scores[best]))
        best = k;
    if (best == taken.size()) continue;
    taken[best] = 1;
    if (frame.labels[i] == MatchRole::counts && frame.detections[best] == MatchRole::counts)
      scores.push_back(frame.scores[best]);
  }
  return scores;
}

struct Counts {
  int hits = 0, alarms = 0;
};

/// Hits and false alarms at `score` or above: a label takes the detection of the largest overlap, a low one
/// only without another.
Counts counts_at(const Judgement& frame, double min_iou, double score) {
  Counts counts;
  const std::size_t none = frame.detections.size();
  std::vector<char> taken(none, 0);
  const auto plays = [&](std::size_t k) {
    return !taken[k] && frame.detections[k] != MatchRole::absent && frame.scores[k] >= score;
  };
  for (std::size_t i = 0; i < frame.labels.size(); ++i) {
    std::size_t best = none, low = none;
    for (std::size_t k = 0; k < none; ++k) {
      if (!plays(k) || !(frame.iou[i][k] > min_iou)) continue;
      if (frame.detections[k] == MatchRole::ignored)
        low = low == none ? k : low;
      else if (best == none || frame.iou[i][k] > frame.iou[i][best])
        best = k;
    }
    const std::size_t match = best != none ? best : low;
    if (match == none) continue;
    taken[match] = 1;
    counts.hits += frame.labels[i] == MatchRole::counts && best != none;
  }
  for (std::size_t k = 0; k < none; ++k) {
    const auto covers = [&](const std::vector<double>& shares) { return shares[k] > min_iou; };
    counts.alarms += plays(k) && frame.detections[k] == MatchRole::counts &&
                     std::none_of(frame.covered.begin(), frame.covered.end(), covers);
  }
  return counts;
}

/// The hits' scores at which recall is nearest to 0, 1/40, 2/40, …
std::vector<double> thresholds(std::vector<double> scores, int cars) {
  std::sort(scores.begin(), scores.end(), std::greater<>());
  std::vector<double> chosen;
  double recall = 0;
  for (std::size_t i = 0; i < scores.size(); ++i) {
    const double left = static_cast<double>(i + 1) / cars;
    const bool last = i + 1 == scores.size();
    const double right = last ? left : static_cast<double>(i + 2) / cars;
    if (right - recall < recall - left && !last) continue;
    chosen.push_back(scores[i]);
    recall += 1.0 / (kRecalls - 1);
  }
  return chosen;
}

}  // namespace

Frame RecordedFrames::read(const std::string& id) const {
  Frame frame = read_frame(data, id, cameras);
  mark_sought(classes_of(classes), frame.labels);
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
  run.ids = list_frames(frames.data, limit);
  run.frames.resize(run.ids.size());
  const bool tells = rank() == 0;  // the others fill the cache, and read nothing from it
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
  const auto detect_frame = [&](Detector& detector, const Frame& frame) {
    const std::vector<LidarPoint> points = RecordedFrames::points(frame);
    const auto start = Clock::now();
    std::vector<Detection> found = suppress(
        detector.forward(view_of(frame, frame.image, points), kScoreThresholdForAp, false), run.matching);
    const double took = seconds_since(start);
    const std::lock_guard lock(mutex);
    seconds += took;
    ++looked;
    return found;
  };
  parallel_for(detectors.size(), [&](std::size_t worker) {
    Detector& detector = *detectors[worker];
    for (Reading reading = take(); reading.place < order.size();) {
      throw_if_interrupted(frames.cached ? "run the same command again to resume"
                                         : "no results were written yet");
      const std::size_t i = reading.place;
      std::optional<Frame> frame;
      if (tells) frame = reading.frame.get();
      Reading ahead = take();
      const auto now = [&] {
        if (!frame) frame = reading.frame.get();
        return detect_frame(detector, *frame);
      };
      std::vector<Detection> detections = frames.cached ? frames.cached(run.ids[i], now) : now();
      check_readable(detections, run.matching, detector.name() + ", frame " + run.ids[i]);
      const std::lock_guard lock(mutex);
      if (tells) {
        if (seen) seen(i, *frame, detections);
        run.frames[i] =
            scored(std::move(detections), ground_truth(*frame, detector.region(), detector.capabilities()),
                   frame->calibration.camera.fy, run.matching);
      }
      if (progress) progress(++done, run.ids.size());
      reading = std::move(ahead);
    }
  });
  if (!tells) return run;
  if (looked == 0 && !run.ids.empty()) {  // all was cached; a network's first pass is slower than others
    const Frame frame = frames.read(run.ids.front());
    detect_frame(*detectors.front(), frame);
    seconds = 0, looked = 0;
    detect_frame(*detectors.front(), frame);
  }
  run.at50 = average_precision(run.frames, 0.5);
  run.at70 = average_precision(run.frames, 0.7);
  for (const Stratum& stratum : standard_strata())
    run.strata.push_back(
        {stratum, average_precision(run.frames, 0.5, stratum), average_precision(run.frames, 0.7, stratum)});
  run.seconds_per_frame = seconds / static_cast<double>(std::max<std::size_t>(1, looked));
  return run;
}

std::vector<KittiDetection> kitti_detections(std::span<const Detection> proposals, Matching matching,
                                             const Frame& frame, const std::vector<std::string>& types,
                                             const std::map<int, std::string>& cameras) {
  std::vector<KittiDetection> result;
  for (const Detection& proposal : proposals) {
    const auto beside = cameras.find(proposal.camera);
    const bool known = proposal.camera == 0 || beside != cameras.end();
    if (matching.in_picture() && !known) continue;
    KittiDetection detection;
    detection.score = proposal.score();
    detection.type = types.at(as_size(proposal.type));
    if (!matching.in_picture()) detection.box = upright(proposal, frame.sweep);
    if (known && area(proposal.picture) > 0) detection.picture = proposal.picture;
    if (detection.picture && beside != cameras.end()) detection.camera = beside->second;
    result.push_back(detection);
  }
  return result;
}

std::map<int, std::string> cameras_by_place(const Frame& frame, const Capabilities& can) {
  const std::vector<int> places = places_of_cameras(frame, can);
  std::map<int, std::string> cameras;
  for (std::size_t k = 1; k < places.size(); ++k)
    if (places[k] >= 0) cameras[places[k]] = frame.name_of(k);
  return cameras;
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
    if (frames_.contains(id))
      throw InputError(path_.string(), fmt::format("frames.{}", i), "lists the frame " + id + " again", kFix);
    std::vector<KittiDetection>& listed = frames_[id];
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
    detections = listed->second;
    for (KittiDetection& detection : detections)
      if (detection.box) detection.box = upright({*detection.box, {}}, frame.sweep);
  }
  std::stable_sort(detections.begin(), detections.end(),
                   [](const auto& a, const auto& b) { return a.score > b.score; });
  return detections;
}

KittiFrame kitti_frame(const Frame& frame, std::span<const Detection> detections, Matching matching,
                       const std::vector<std::string>& types) {
  KittiFrame result{frame.labels, kitti_detections(detections, matching, frame, types), frame.labelled};
  for (KittiDetection& detection : result.detections)
    if (!detection.picture && detection.box) detection.picture = projected(*detection.box, frame.calibration);
  return result;
}

KittiPrecision kitti_average_precision(std::span<const KittiFrame> frames, Matching matching,
                                       Difficulty level, double min_iou) {
  KittiPrecision result;
  std::vector<Judgement> judged;
  std::vector<double> scores;
  for (const KittiFrame& frame : frames) {
    if (!frame.labelled) continue;
    judged.push_back(judgement(frame, matching, level));
    const auto& labels = judged.back().labels;
    result.cars += static_cast<int>(std::count(labels.begin(), labels.end(), MatchRole::counts));
    const std::vector<double> hits = hit_scores(judged.back(), min_iou);
    scores.insert(scores.end(), hits.begin(), hits.end());
  }
  if (result.cars == 0) return result;
  std::vector<double> precision(kRecalls, 0);
  const std::vector<double> at = thresholds(std::move(scores), result.cars);
  for (std::size_t t = 0; t < at.size() && t < precision.size(); ++t) {
    Counts sum;
    for (const Judgement& frame : judged) {
      const Counts counts = counts_at(frame, min_iou, at[t]);
      sum.hits += counts.hits, sum.alarms += counts.alarms;
    }
    if (sum.hits > 0) precision[t] = static_cast<double>(sum.hits) / (sum.hits + sum.alarms);
  }
  for (std::size_t t = precision.size(); t-- > 1;)
    precision[t - 1] = std::max(precision[t - 1], precision[t]);
  for (std::size_t t = 1; t < precision.size(); ++t)
    result.average_precision += precision[t] / (kRecalls - 1);
  return result;
}

nlohmann::json kitti_ap_json(std::span<const KittiFrame> frames, std::span<const Matching> ways) {
  constexpr std::pair<const char*, Difficulty> kLevelNames[] = {
      {"easy", Difficulty::easy}, {"moderate", Difficulty::moderate}, {"hard", Difficulty::hard}};
  nlohmann::json result = {{"iou", 0.7}};
  for (const Matching matching : ways)
    for (const auto& [name, level] : kLevelNames)
      for (const double iou : {0.7, 0.5}) {
        const KittiPrecision at = kitti_average_precision(frames, matching, level, iou);
        nlohmann::json& of = iou == 0.7 ? result : result["iou50"];
        of[matching.in_picture() ? "image" : matching.name()][name] =
            at.cars > 0 ? nlohmann::json(at.average_precision) : nlohmann::json();
        result["cars"][name] = at.cars;
      }
  return result;
}

}  // namespace mirage
