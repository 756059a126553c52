// What is costly in a frame, kept on disk (base/disk_cache.h) by content: completed depth, roofs with their
// fitted vehicles, how much of the reference adversary each host shows, and what a detector finds, as
// recorded and with an object in it. Keys are what they are made of (base/provenance.h): a result from the
// cache is the one that would be computed, to the bit.
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
  bool from_box = true;  ///< Carrier's

  /// Why the vehicle is no host; LeftOut::no where it may be one.
  LeftOut left_out() const { return share < 0 ? static_cast<LeftOut>(std::lround(-share)) : LeftOut::no; }
};

/// What a detector finds in a frame with an object in it.
struct AttackedDetections {
  std::vector<Detection> detections;
  std::optional<PictureBox> object;  ///< its outline in the picture, where that is asked for
};

/// What some work with a detector on one frame found, in an order of its own.
struct FrameAnswers {
  ViewAnswers found = {};
  std::vector<double> numbers = {};
};

/// The entries of one data set's frames. `frame` is DataSet::hash(). Several threads may ask.
class FrameCache {
 public:
  /// Keeps nothing.
  FrameCache();
  /// `depth`, `rooftop`: depth_identity() and rooftop_identity() of what the store asks, with its LiDAR.
  FrameCache(std::unique_ptr<DiskCache> disk, const std::string& depth, const std::string& rooftop,
             const LidarModel& lidar);

  /// Whether anything is kept on disk.
  bool on() const { return disk_ && disk_->on(); }
  /// Each gives what is kept, or else computes and keeps it.
  ImageF depth(const std::string& frame, int width, int height, const std::function<ImageF()>& compute);
  /// One for each of the frame's labels, in their order.
  std::vector<Carrier> carriers(const std::string& frame, const std::vector<Label>& labels,
                                const std::function<std::vector<Carrier>()>& compute);
  /// How well each host of the frame is seen in `region` (m, `velo`) with the object at `place` under these
  /// settings.
  std::vector<HostView> views(const std::string& frame, const PlaceChoice& place,
                              const std::array<double, 4>& region, const SimulationSettings& simulation,
                              const std::function<std::vector<HostView>()>& compute);
  /// The clean frame's proposals of a detector (detector_identity()) with a score over the threshold.
  std::vector<Detection> detections(const std::string& frame, const std::string& detector,
                                    double score_threshold,
                                    const std::function<std::vector<Detection>()>& compute);
  /// Of work on one frame that `provenance` tells whole; `kind`: the work's name.
  FrameAnswers answers(const char* kind, const Provenance& provenance,
                       const std::function<FrameAnswers()>& compute);
  /// Of an insertion that `provenance` tells whole: prepared(), the object, how it is drawn, and the
  /// detector.
  AttackedDetections attacked(const Provenance& provenance,
                              const std::function<AttackedDetections()>& compute);
  /// What a prepared frame is made of: the frame, its depth and its roofs.
  Provenance prepared(const std::string& frame) const;

 private:
  Provenance with_roofs(const std::string& frame) const;
  std::unique_ptr<DiskCache> disk_;
  std::string depth_, rooftop_, lidar_;
};

/// InputError, naming the command, where there are several processes (base/ranks.h) and they cannot share
/// their work through this cache: it is off, or the detector's answers may not be kept (detector_identity()
/// is empty).
void require_shared(const FrameCache& cache, const std::string& command, const std::string& detector);

/// Hash of every number of the model that says where rays go.
std::string lidar_identity(const LidarModel& lidar);
/// "box", or the name and content of the shape model.
std::string rooftop_identity(const std::string& rooftop);

}  // namespace mirage
