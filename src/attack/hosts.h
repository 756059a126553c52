// Host vehicles: which cars of which frames can carry the adversary, and their split.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "attack/run.h"
#include "detection/detector.h"
#include "scene/depth/learned_depth.h"
#include "scene/insertion.h"

namespace mirage {

/// A vehicle with its roof pose.
struct Host {
  HostId id;
  Rooftop rooftop;
};

/// The frames of a data set, read and prepared once, by id. Several threads may ask at once.
class FrameStore {
 public:
  /// `depth` completes the photographs' depth; without one, IpBasic.
  FrameStore(std::filesystem::path data, const LidarModel& lidar,
             std::shared_ptr<const DepthCompletion> depth = nullptr)
      : data_(std::move(data)), lidar_(lidar), depth_(std::move(depth)) {}
  /// Reads and prepares the frame at first use; only measured points inside the photograph are kept, as
  /// KITTI's detectors do.
  const PreparedFrame& get(const std::string& id);

 private:
  std::filesystem::path data_;
  LidarModel lidar_;
  std::shared_ptr<const DepthCompletion> depth_;
  std::mutex mutex_;
  std::map<std::string, std::unique_ptr<PreparedFrame>> frames_;
};

/// The LiDAR that recorded a data set: the set's own rig.toml (generated ones have it), else the rig that
/// dataset.json names, else KITTI's HDL-64E.
LidarModel lidar_of(const std::filesystem::path& data);

/// Cars of the frame that can be hosts: labelled "Car", box centre inside the detector's region, and at least
/// `min_view` of the reference adversary in view after occlusion.
std::vector<Host> find_hosts(const PreparedFrame& prepared, const RooftopFinder& finder,
                             const std::array<double, 4>& region, const SimulationSettings& simulation,
                             double min_view = 0.7);

/// Hosts of every frame of a data set.
std::vector<Host> find_all_hosts(FrameStore& store, const std::vector<std::string>& frames,
                                 const std::array<double, 4>& region, const SimulationSettings& simulation,
                                 double min_view);

/// Splits frames (not hosts) train : test = 7 : 3 at random by seed. At least one frame each when there are
/// two.
void split_frames(std::vector<std::string> frames, std::uint64_t seed, std::vector<std::string>& train,
                  std::vector<std::string>& test);

/// BEV boxes of every labelled object with a 3-D box.
std::vector<BevBox> ground_truth_boxes(const Frame& frame);

}  // namespace mirage
