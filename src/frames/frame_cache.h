// Disk cache (base/disk_cache.h) of a frame's costly results: completed depth, roofs with their fitted
// vehicles, the visible share of the reference adversary at each host, and a detector's answers with and
// without an object. Keys hash everything a result depends on (base/provenance.h): a cached result is bit for
// bit the computed one.
#pragma once

#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "base/disk_cache.h"
#include "base/provenance.h"
#include "detection/detect.h"
#include "detection/detector.h"
#include "simulation/insertion.h"

namespace mirage {

/// Share in view of the reference adversary that is placed at a label's vehicle.
struct HostView {
  int label = 0;
  double share = 0;      ///< below 0: −left_out()
  bool from_box = true;  ///< Carrier::from_box

  /// Why the vehicle is not a host; LeftOut::no if it may be one.
  LeftOut left_out() const { return share < 0 ? static_cast<LeftOut>(std::lround(-share)) : LeftOut::no; }
};

/// A detector's answers to a frame with an object in it.
struct AttackedDetections {
  std::vector<Detection> detections;
  std::optional<PictureBox> object;  ///< its outline in the picture, if requested
};

/// Results of some work with a detector on one frame; the work defines their order.
struct FrameAnswers {
  ViewAnswers found = {};
  std::vector<double> numbers = {};
};

/// The cache entries of one data set's frames. `frame` is DataSet::hash(). Thread-safe.
class FrameCache {
 public:
  /// Caches nothing.
  FrameCache();
  /// `depth`, `rooftop`: depth_identity() and rooftop_identity() of the store's back-ends; `lidar`: its unit.
  FrameCache(std::unique_ptr<DiskCache> disk, const std::string& depth, const std::string& rooftop,
             const LidarModel& lidar);

  /// Whether results are cached on disk.
  bool on() const { return disk_ && disk_->on(); }
  /// Each function returns the cached result, or computes and caches it.
  ImageF depth(const std::string& frame, int width, int height, const std::function<ImageF()>& compute);
  /// One for each of the frame's labels, in their order.
  std::vector<Carrier> carriers(const std::string& frame, const std::vector<Label>& labels,
                                const std::function<std::vector<Carrier>()>& compute);
  /// Visible share of each host of the frame in `region` (m, `velo`), for the object at `place` under these
  /// settings.
  std::vector<HostView> views(const std::string& frame, const PlaceChoice& place,
                              const std::array<double, 4>& region, const SimulationSettings& simulation,
                              const std::function<std::vector<HostView>()>& compute);
  /// The clean frame's proposals of a detector (detector_identity()) with a score over the threshold.
  std::vector<Detection> detections(const std::string& frame, const std::string& detector,
                                    double score_threshold,
                                    const std::function<std::vector<Detection>()>& compute);
  /// Results of work on one frame; `provenance` holds all that they depend on. `kind`: the work's name.
  FrameAnswers answers(const char* kind, const Provenance& provenance,
                       const std::function<FrameAnswers()>& compute);
  /// Answers to an insertion; `provenance` holds all that they depend on: prepared(), object, drawing and
  /// detector.
  AttackedDetections attacked(const Provenance& provenance,
                              const std::function<AttackedDetections()>& compute);
  /// Provenance of a prepared frame: the frame, its depth and its roofs.
  Provenance prepared(const std::string& frame) const;

 private:
  Provenance with_roofs(const std::string& frame) const;
  std::unique_ptr<DiskCache> disk_;
  std::string depth_, rooftop_, lidar_;
};

/// InputError, naming the command, if several processes (base/ranks.h) cannot share their work through this
/// cache: it is off, or the detector's answers must not be cached (detector_identity() is empty).
void require_shared(const FrameCache& cache, const std::string& command, const std::string& detector);

/// Hash of every number of the model that determines its rays.
std::string lidar_identity(const LidarModel& lidar);
/// "box", or the name and content of the shape model.
std::string rooftop_identity(const std::string& rooftop);

}  // namespace mirage
