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
#include "scene/sun.h"

namespace mirage {

/// A vehicle with its roof pose.
struct Host {
  HostId id;
  Rooftop rooftop;
};

/// The frames of a data set with the roofs of their vehicles, read and prepared once, by id. Several threads
/// may ask at once.
class FrameStore {
 public:
  /// `depth` completes the photographs' depth; without one, IpBasic. `finder` finds the roofs; without one,
  /// BoxRooftopFinder.
  FrameStore(std::filesystem::path data, const LidarModel& lidar,
             std::shared_ptr<const DepthCompletion> depth = nullptr,
             std::shared_ptr<const RooftopFinder> finder = nullptr);
  /// As the commands name them: `--depth`, `--rooftop` and `--sun`, and the LiDAR of the data set.
  FrameStore(const std::filesystem::path& data, const std::string& depth, const std::string& rooftop,
             const std::string& sun = kDefaultSun);
  /// Reads and prepares the frame at first use; only measured points inside the photograph are kept, as
  /// KITTI's detectors do.
  const PreparedFrame& get(const std::string& id) { return at(id).prepared; }
  /// The roof of a vehicle. It is found in the whole sweep: one that the photograph cuts off is seen whole.
  /// InputError if the frame has no such label.
  const Rooftop& rooftop(const HostId& host);

 private:
  struct Entry {
    PreparedFrame prepared;
    std::vector<Rooftop> rooftops;  ///< of the labels, in their order
  };
  const Entry& at(const std::string& id);

  std::filesystem::path data_;
  LidarModel lidar_;
  std::shared_ptr<const DepthCompletion> depth_;
  std::shared_ptr<const RooftopFinder> finder_;
  SunChoice sun_;
  std::mutex mutex_;
  std::map<std::string, std::unique_ptr<Entry>> frames_;
};

/// The LiDAR that recorded a data set: the set's own rig.toml (generated ones have it), else the rig that
/// dataset.json names, else KITTI's HDL-64E.
LidarModel lidar_of(const std::filesystem::path& data);

/// Cars of the frame that can be hosts: labelled "Car", box centre inside the detector's region, and at least
/// `min_view` of the reference adversary in view after occlusion.
std::vector<Host> find_hosts(FrameStore& store, const std::string& frame, const std::array<double, 4>& region,
                             const SimulationSettings& simulation, double min_view = 0.7);

/// Hosts of every frame of a data set.
std::vector<Host> find_all_hosts(FrameStore& store, const std::vector<std::string>& frames,
                                 const std::array<double, 4>& region, const SimulationSettings& simulation,
                                 double min_view);

/// On what the hosts of a run stand.
struct RooftopCount {
  int fitted = 0, from_box = 0;
  void add(const Rooftop& rooftop) { ++(rooftop.from_box ? from_box : fitted); }
};
nlohmann::json to_json(const RooftopCount& count);

/// "000008_0": frame and label.
std::string host_name(const HostId& id);
/// The host's label. InputError if the frame has none of that number.
const Label& label_of(const Frame& frame, const HostId& id);

/// Splits frames (not hosts) train : test = 7 : 3 at random by seed. At least one frame each when there are
/// two.
void split_frames(std::vector<std::string> frames, std::uint64_t seed, std::vector<std::string>& train,
                  std::vector<std::string>& test);

/// BEV boxes of every labelled object with a 3-D box.
std::vector<BevBox> ground_truth_boxes(const Frame& frame);

}  // namespace mirage
