// Running a detector over a data set and scoring it.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "detection/average_precision.h"
#include "detection/detector.h"
#include "scene/data/data_set.h"
#include "scene/data/kitti_rows.h"

namespace mirage {

/// Detections below this score are ignored (the paper's "relevant" proposals start here too).
inline constexpr double kScoreThreshold = 0.1;
/// For AP the curve's tail matters: detections down to this score.
inline constexpr double kScoreThresholdForAp = 0.02;
/// The score down to which audit.h follows a car's logit.
inline constexpr double kFaintScore = 1e-4;

/// The proposals with a score over `least`.
std::vector<Detection> scored_over(std::vector<Detection> proposals, double least);

/// Points in view → proposals → suppression as the detector is judged (Capabilities::matching).
/// Sorted by falling score.
std::vector<Detection> detect_vehicles(Detector& detector, const Frame& frame,
                                       double score_threshold = kScoreThreshold);

/// AP over the vehicles of one stratum.
struct ScoredStratum {
  Stratum stratum;
  PrecisionRecall at50, at70;
};

/// A detector on a data set: detections and scores.
struct DetectionRun {
  std::vector<std::string> ids;
  std::vector<ScoredFrame> frames;
  PrecisionRecall at50, at70;
  std::vector<ScoredStratum> strata;  ///< standard_strata()
  double seconds_per_frame = 0;       ///< of the detector alone, where its answers were not kept
  Matching matching;                  ///< how it was judged
};

/// A detector's view of one frame, changed or not, as a key for caching its answers.
struct ShownView {
  std::vector<std::string> frames;  ///< whose data are shown, the frame itself first
  nlohmann::json change;            ///< how they are changed
};
/// A detector's answers to a view, in lists that the caller defines.
using ViewAnswers = std::vector<std::vector<Detection>>;

/// Frames of a data set as recorded, without an object, and how they are read.
struct RecordedFrames {
  RecordedFrames(std::filesystem::path of, std::string sought = kCars)
      : data(std::move(of)), classes(std::move(sought)) {}
  std::filesystem::path data;
  std::string classes;               ///< the sought classes
  Cameras cameras = Cameras::first;  ///< which are read
  /// Adds the data of sensors that are neither cameras nor LiDARs; empty: there are none.
  std::function<void(Frame&)> add_measurements = {};
  /// The detector's detections in a frame as recorded, down to kScoreThresholdForAp: the cached ones, or
  /// those of the given function, which are then cached (frames/frame_store.h). Empty: no cache.
  std::function<std::vector<Detection>(const std::string& id, const std::function<std::vector<Detection>()>&)>
      cached = {};
  /// The same for answers to other views of the frames.
  std::function<ViewAnswers(const ShownView& view, const std::function<ViewAnswers()>&)> cached_views = {};

  /// The whole frame, with its sought labels marked.
  Frame read(const std::string& id) const;
  /// The detector's part of the frame's sweep: all of it with several cameras, otherwise the points in view.
  static std::vector<LidarPoint> points(const Frame& frame);
};

/// Runs the detector on each frame of `data` (or on the first `limit`); the next frame is read meanwhile when
/// there is more than one thread. `detectors`: instances of it, at least one; each works on a thread of its
/// own. `progress(done, total)` and `seen(frame's place, frame, detections)` may be empty; one call at a
/// time. Throws Interrupted between frames. A call of all ranks (base/ranks.h), which share the frames
/// through RecordedFrames::cached; all but the first get the frames' ids alone.
DetectionRun detect_data_set(
    std::span<Detector* const> detectors, const RecordedFrames& frames, std::size_t limit = 0,
    const std::function<void(std::size_t, std::size_t)>& progress = {},
    const std::function<void(std::size_t, const Frame&, const std::vector<Detection>&)>& seen = {});

// Detections on disk, written by `mirage detect` or by other people's detectors.

/// Proposals in the format of KITTI's results: upright() in the whole sweep; without a box in space if judged
/// in the picture. `types`: the names of their classes (Capabilities::types). `cameras`: cameras_by_place();
/// boxes in pictures of other cameras are left out, except the first's.
std::vector<KittiDetection> kitti_detections(std::span<const Detection> proposals, Matching matching,
                                             const Frame& frame,
                                             const std::vector<std::string>& types = {kCars},
                                             const std::map<int, std::string>& cameras = {});

/// The names of the frame's cameras beside the first that a detector of these capabilities reads, by
/// ObjectBoxes::camera.
std::map<int, std::string> cameras_by_place(const Frame& frame, const Capabilities& can);

/// The detections of a data set's frames.
class DetectionFiles {
 public:
  /// `path`: detections.json of mirage detect (or its folder), a folder of KITTI result files ID.txt (or one
  /// that holds them as data/ID.txt), or one such file. InputError if it is none of these, or if
  /// detections.json is invalid.
  explicit DetectionFiles(const std::filesystem::path& path);

  /// Whether the files cover the frame, also if it has no detections.
  bool has(const std::string& id) const;
  /// The frame's detections by falling score; empty if the files do not cover it. InputError naming file and
  /// field for invalid content.
  std::vector<KittiDetection> of(const Frame& frame) const;
  /// The path as given to the constructor.
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  std::map<std::string, std::filesystem::path> texts_;  ///< by frame
  /// Of detections.json, by frame; boxes have no height if the file has none.
  std::map<std::string, std::vector<KittiDetection>> frames_;
};

// Average precision by the rules of KITTI's development kit (Geiger et al., CVPR 2012; evaluate_object with
// the 40 recalls of 2019), so that a figure can stand beside the benchmark's. average_precision.h has
// Mirage's own rules, which are milder:
//
//                        here, as in the kit                      average_precision.h
//   boxes to be found    Car of the level, wherever it stands     the same; bev: inside the searched region
//   ignored              Vans, harder cars                        bev: the same; picture: trucks, trams, too
//   a false alarm on     only where IoU exceeds the limit;        IoU reaches the limit, or half of the
//   these is forgiven    DontCare, picture alone: the covered     detection lies inside
//                        share of the detection exceeds it
//   low detections       under the level's height neither hit     bev: as a car's at that distance; picture:
//                        nor false alarm                          hits count
//   the curve            41 scores, at hits 1/40 of recall apart  every score
//
// With fewer cars of a level than 41 the kit leaves the end of the curve at zero: of 25 cars it gives at most
// 60 %.

/// One frame as the kit's files have it: every detection has a box in the picture, of no area if the camera
/// does not see it.
struct KittiFrame {
  std::vector<Label> labels;
  std::vector<KittiDetection> detections;
  bool labelled = true;  ///< false: its detections are neither hits nor false alarms
};
/// A frame with the detector's boxes in the picture, or its upright boxes projected (kitti_detections).
KittiFrame kitti_frame(const Frame& frame, std::span<const Detection> detections, Matching matching,
                       const std::vector<std::string>& types = {kCars});

/// AP of a level, and the number of its cars.
struct KittiPrecision {
  double average_precision = 0;  ///< in [0, 1]; 0 without cars
  int cars = 0;
};
/// At overlaps above `min_iou`: from above, the kit's "ground", or in the picture, its "image".
KittiPrecision kitti_average_precision(std::span<const KittiFrame> frames, Matching matching,
                                       Difficulty level, double min_iou);

/// result.json's "kitti_ap": {iou: 0.7, cars: {easy, moderate, hard}, and for each way "bev" or "image"
/// {easy, moderate, hard}; iou50: the same at 0.5}. A level without cars is null.
nlohmann::json kitti_ap_json(std::span<const KittiFrame> frames, std::span<const Matching> ways);

}  // namespace mirage
