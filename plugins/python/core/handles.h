// What the module's Python objects hold.
#pragma once

#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "cli/options.h"
#include "simulation/insertion.h"

namespace mirage::python {

/// A frame of a data set with what was prepared of it, by the settings that it depends on. Several threads
/// may ask.
class FrameHandle {
 public:
  /// `rig`: which recorded it, as data_rig.h takes it. InputError as read_frame's.
  FrameHandle(const std::filesystem::path& data, const std::string& id, const std::string& rig);
  /// Of no data set. InputError as rig_file's.
  FrameHandle(Frame frame, const std::string& rig);

  const Frame& frame() const { return frame_; }
  /// With the photograph's depth by `depth` and the sun where `sun` says. Warns, and InputError, as
  /// check_data.
  std::shared_ptr<const PreparedFrame> prepared(const std::string& depth, const std::string& sun);
  /// A label's vehicle with its roof. InputError naming the label if it is none.
  Carrier carrier(const std::string& finder, int label);
  /// What returns of the data set's sweeps have (scene/data/data_rig.h).
  const std::string& recorded_effects() const { return recorded_; }

 private:
  std::filesystem::path data_;  ///< empty: of none
  std::string rig_;
  LidarModel lidar_;
  std::string recorded_;
  Frame frame_;
  std::mutex mutex_;
  std::map<std::pair<std::string, std::string>, std::shared_ptr<const PreparedFrame>> prepared_;
  std::map<std::pair<std::string, int>, Carrier> carriers_;
};

/// A vehicle that can carry a mesh.
struct HostHandle {
  int index = 0;  ///< of its label
  Label label;
  double share_in_view = 0;  ///< of the reference adversary on its roof, after occlusion
};

/// An insertion and what it came from.
struct ResultHandle {
  std::shared_ptr<FrameHandle> frame;
  std::shared_ptr<const PreparedFrame> prepared;
  Simulated simulated;
  int resolution = 1;  ///< of the mesh's atlas
  bool in_double = false;
};

}  // namespace mirage::python
