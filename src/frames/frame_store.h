// How much of a mesh that is placed at each car of a frame is in view.
#pragma once

#include <array>
#include <condition_variable>
#include <cstddef>
#include <filesystem>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "detection/detect.h"
#include "frames/frame_cache.h"
#include "frames/host_id.h"
#include "scene/depth_completion.h"
#include "scene/frame_source.h"
#include "scene/recorded_light.h"
#include "simulation/insertion.h"
#include "simulation/sensor_plugin.h"

namespace mirage {

/// Share in view of the reference adversary, which fills the volume of `place`, at each car of the frame
/// inside `region` (x_min, x_max, y_min, y_max; m, `velo`), in the camera that shows most of it; below 0 for
/// a car that is left out (HostView::left_out). `carriers`: of the labels, in their order.
std::vector<HostView> host_views(const PreparedFrame& prepared, const std::vector<Carrier>& carriers,
                                 const PlaceChoice& place, const std::array<double, 4>& region,
                                 const SimulationSettings& simulation);

// The frames of a data set, streamed: read and prepared when they are asked for, held while there is room.

/// Hashes of a data set's frames as they are on disk, each made once. Several threads may ask.
class FrameContents {
 public:
  /// `sensors`: sensors_identity() of what measures the frames besides.
  FrameContents(std::filesystem::path data, Cameras cameras = Cameras::first, std::string sensors = "")
      : data_(std::move(data)), cameras_(cameras), sensors_(std::move(sensors)) {}
  /// DataSet::hash() of the frame, its recorded light, and what measures it besides.
  std::string of(const std::string& id) const;

 private:
  std::filesystem::path data_;
  Cameras cameras_;
  std::string sensors_;
  mutable std::mutex mutex_;  // of what follows
  mutable std::map<std::string, std::string> known_;
};

/// Frames with where an object stands at their vehicles, by id. Several threads may ask at once. What was
/// used last stays in memory; the rest is read again, and what is costly in preparing it comes from the disk
/// cache.
class FrameStore {
 public:
  /// Bytes of frames held, besides those in use.
  static constexpr std::size_t kMemoryLimit = 1ull << 30;

  /// `depth` completes the photographs' depth; without one, IpBasic. `finder` finds the roofs; without one,
  /// BoxRoofFinder. Nothing is cached on disk: what these are can't be told.
  FrameStore(std::filesystem::path data, const LidarModel& lidar,
             std::shared_ptr<const DepthCompletion> depth = nullptr,
             std::shared_ptr<const RoofFinder> finder = nullptr);
  /// With the LiDAR of the data set and DiskCache::from_environment(). Warns, and InputError, as check_data.
  explicit FrameStore(const FrameSource& source);
  FrameStore(const FrameStore&) = delete;
  FrameStore& operator=(const FrameStore&) = delete;

  /// The frame, to be held on to while it is used; only measured points inside the photograph are kept, as
  /// KITTI's detectors do, but all of them with all cameras (FrameSource::cameras).
  std::shared_ptr<const PreparedFrame> get(const std::string& id);
  /// Where the object stands for a host: FrameSource::placement. The host's roof is found in the whole sweep:
  /// a vehicle that the photograph cuts off is seen whole. InputError if the frame has no such label.
  Placement placement(const HostId& host);
  /// As --place took it.
  const PlaceChoice& place() const { return place_; }
  /// What an insertion at a host is made of, but for the object and how it is drawn: the prepared frame, its
  /// light and the place.
  Provenance provenance(const HostId& host) const;
  /// Share in view of the reference adversary, placed at each car inside `region`.
  std::vector<HostView> views(const std::string& id, const std::array<double, 4>& region,
                              const SimulationSettings& simulation);

  /// Reads these on a thread of its own, so that get() need not wait; they are held until the next call.
  void prefetch(std::vector<std::string> ids);
  /// Bytes of frames to hold at most; those not used for longest go.
  void set_memory_limit(std::size_t bytes);
  /// Bytes of frames held now.
  std::size_t memory() const;
  /// Frames read and prepared so far, again or for the first time.
  std::size_t reads() const;

  /// What is kept on disk of these frames.
  FrameCache& cache() { return cache_; }
  /// FrameContents of the frame.
  std::string content(const std::string& id) const { return contents_->of(id); }

 private:
  struct Entry {
    PreparedFrame prepared;
    std::vector<Carrier> carriers;  ///< of the labels, in their order
    std::size_t bytes = 0;
  };
  using RecentFrames = std::list<std::pair<std::string, std::shared_ptr<const Entry>>>;
  struct Slot {
    std::mutex reading;                           ///< one reads a frame, others wait for it
    std::weak_ptr<const Entry> entry;             ///< alive while held or in use
    std::optional<RecentFrames::iterator> place;  ///< while held
  };

  std::shared_ptr<const Entry> at(const std::string& id);
  /// The frame if it is in memory; it moves to the head. Under mutex_.
  std::shared_ptr<const Entry> in_memory(const std::string& id, Slot& slot);
  void hold(const std::string& id, Slot& slot, std::shared_ptr<const Entry> entry);
  void drop_oldest();
  std::shared_ptr<const Entry> read(const std::string& id) const;
  void read_ahead(const std::stop_token& stop);

  std::filesystem::path data_;
  LidarModel lidar_;
  std::shared_ptr<const DepthCompletion> depth_;
  std::shared_ptr<const RoofFinder> finder_;
  SunChoice sun_;
  PlaceChoice place_;
  Cameras cameras_ = Cameras::first;
  std::string classes_ = kCars;
  std::vector<std::shared_ptr<const PluginSensor>> sensors_;
  std::unique_ptr<const FrameContents> contents_;
  mutable FrameCache cache_;

  mutable std::mutex mutex_;  // of what follows
  std::map<std::string, std::shared_ptr<Slot>> slots_;
  RecentFrames recent_;  ///< the one used last is first
  std::size_t bytes_ = 0, limit_ = kMemoryLimit;
  mutable std::size_t reads_ = 0;

  std::mutex ahead_mutex_;  // of what follows
  std::condition_variable_any ahead_changed_;
  std::vector<std::string> prefetch_ids_;
  std::vector<std::shared_ptr<const Entry>> ahead_;
  std::jthread ahead_thread_;  ///< last: its end waits for it, and it knows the rest
};

/// Those of the source as a detector reads them without an object: its cameras, classes and sensors.
RecordedFrames recorded_frames(const FrameSource& source);
/// The same, with the answers of a detector, by its detector_identity(), kept on disk where both can be.
/// `command`: for the error of require_shared.
RecordedFrames recorded_frames(const FrameSource& source, const std::string& detector,
                               const std::string& command);

// Clean detections, kept on disk.

/// The detections of a frame as recorded: the kept ones, or else compute(frame)'s. `detector`:
/// detector_identity(); empty: not cached.
std::vector<Detection> cached_detections(FrameStore& store, const std::string& frame,
                                         const std::string& detector, double score_threshold,
                                         const std::function<std::vector<Detection>(const Frame&)>& compute);

}  // namespace mirage
