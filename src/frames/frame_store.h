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
/// a car that is left out (HostView::left_out). `carriers`: one for each label, in their order.
std::vector<HostView> host_views(const PreparedFrame& prepared, const std::vector<Carrier>& carriers,
                                 const PlaceChoice& place, const std::array<double, 4>& region,
                                 const SimulationSettings& simulation);

// The frames of a data set, streamed: read and prepared on request, held while memory allows.

/// Hashes of a data set's frames on disk, each computed once. Thread-safe.
class FrameContents {
 public:
  /// `sensors`: sensors_identity() of the frames' sensor plugins.
  FrameContents(std::filesystem::path data, Cameras cameras = Cameras::first, std::string sensors = "")
      : data_(std::move(data)), cameras_(cameras), sensors_(std::move(sensors)) {}
  /// Hash of DataSet::hash() of the frame, its recorded light and its sensor plugins.
  std::string of(const std::string& id) const;

 private:
  std::filesystem::path data_;
  Cameras cameras_;
  std::string sensors_;
  mutable std::mutex mutex_;  // of what follows
  mutable std::map<std::string, std::string> known_;
};

/// Frames, and the placement of an object at each of their vehicles, by id. Thread-safe. The most recently
/// used frames stay in memory; others are read again, with their costly parts from the disk cache.
class FrameStore {
 public:
  /// Bytes of frames held, besides those in use.
  static constexpr std::size_t kMemoryLimit = 1ull << 30;

  /// `depth` completes the photographs' depth; IpBasic if null. `finder` finds the roofs; BoxRoofFinder if
  /// null. Nothing is cached on disk: neither has an identity to make a key from.
  FrameStore(std::filesystem::path data, const LidarModel& lidar,
             std::shared_ptr<const DepthCompletion> depth = nullptr,
             std::shared_ptr<const RoofFinder> finder = nullptr);
  /// With the data set's LiDAR and DiskCache::from_environment(). Warnings and errors as check_data's.
  explicit FrameStore(const FrameSource& source);
  FrameStore(const FrameStore&) = delete;
  FrameStore& operator=(const FrameStore&) = delete;

  /// The frame, to be held on to while it is used; only measured points inside the photograph are kept, as
  /// KITTI's detectors do, but all of them with all cameras (FrameSource::cameras).
  std::shared_ptr<const PreparedFrame> get(const std::string& id);
  /// The object's placement at a host (FrameSource::placement). The host's roof is found in the whole sweep:
  /// a vehicle that the photograph cuts off is seen whole. InputError if the frame has no such label.
  Placement placement(const HostId& host);
  /// The placement that --place chose.
  const PlaceChoice& place() const { return place_; }
  /// Provenance of an insertion at a host without the object and the drawing: the prepared frame, its light
  /// and the placement.
  Provenance provenance(const HostId& host) const;
  /// Share in view of the reference adversary, placed at each car inside `region`.
  std::vector<HostView> views(const std::string& id, const std::array<double, 4>& region,
                              const SimulationSettings& simulation);

  /// Reads these frames ahead on a background thread; they are held until the next call.
  void prefetch(std::vector<std::string> ids);
  /// Limit on the bytes of frames held; the least recently used frames go first.
  void set_memory_limit(std::size_t bytes);
  /// Bytes of frames held now.
  std::size_t memory() const;
  /// Frames read and prepared so far, again or for the first time.
  std::size_t reads() const;

  /// The disk cache of these frames.
  FrameCache& cache() { return cache_; }
  /// FrameContents::of the frame.
  std::string content(const std::string& id) const { return contents_->of(id); }

 private:
  struct Entry {
    PreparedFrame prepared;
    std::vector<Carrier> carriers;  ///< one for each label, in their order
    std::size_t bytes = 0;
  };
  using RecentFrames = std::list<std::pair<std::string, std::shared_ptr<const Entry>>>;
  struct Slot {
    std::mutex reading;                           ///< one thread reads a frame, others wait
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
  RecentFrames recent_;  ///< the most recently used first
  std::size_t bytes_ = 0, limit_ = kMemoryLimit;
  mutable std::size_t reads_ = 0;

  std::mutex ahead_mutex_;  // of what follows
  std::condition_variable_any ahead_changed_;
  std::vector<std::string> prefetch_ids_;
  std::vector<std::shared_ptr<const Entry>> ahead_;
  std::jthread ahead_thread_;  ///< last: it is joined before the other members go
};

/// The source's frames as a detector reads them without an object: its cameras, classes and sensors.
RecordedFrames recorded_frames(const FrameSource& source);
/// The same, with a detector's answers cached on disk if both identities allow it. `detector`: its
/// detector_identity(). `command`: for the error of require_shared.
RecordedFrames recorded_frames(const FrameSource& source, const std::string& detector,
                               const std::string& command);

// Clean detections, kept on disk.

/// The detections of a recorded frame: from the cache, otherwise from compute(frame). `detector`:
/// detector_identity(); empty: not cached.
std::vector<Detection> cached_detections(FrameStore& store, const std::string& frame,
                                         const std::string& detector, double score_threshold,
                                         const std::function<std::vector<Detection>(const Frame&)>& compute);

}  // namespace mirage
