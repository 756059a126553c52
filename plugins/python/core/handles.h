// What the module's Python objects hold.
#pragma once

#include <array>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <tuple>

#include "cli/options.h"
#include "simulation/insertion.h"

namespace mirage::python {

/// A frame of a data set with what was prepared of it, by the settings that it depends on. Several threads
/// may ask.
class FrameHandle {
 public:
  /// `rig`: which recorded it, as data_rig.h takes it. InputError as read_frame's.
  FrameHandle(const std::filesystem::path& data, const std::string& id, const std::string& rig);
  /// Of no data set; an empty `rig` is assumed to be KITTI's. InputError as rig_file's.
  FrameHandle(Frame frame, const std::string& rig);

  const Frame& frame() const { return frame_; }
  /// With the depth, the sun and the sought classes of `settings`. Warns, and InputError, as check_data; of
  /// arrays as check_sweep.
  std::shared_ptr<const PreparedFrame> prepared(const cli::InsertionOptions& settings);
  /// A label's vehicle with its roof as `settings` find it. InputError naming the label if it is none.
  Carrier carrier(const cli::InsertionOptions& settings, int label);
  /// What returns of the data set's sweeps have (scene/data/data_rig.h).
  const std::string& recorded_effects() const { return recorded_; }

 private:
  /// Of arrays: whether the unit recorded the sweep, of which it has this index. InputError if it did not and
  /// is only assumed, a warning if it was named.
  void check_sweep(const SweepIndex& index) const;

  std::filesystem::path data_;  ///< empty: of none
  std::string rig_;
  bool rig_is_assumed_ = false;  ///< of arrays
  LidarModel lidar_;
  std::string recorded_;
  Frame frame_;
  std::mutex mutex_;
  /// By depth, sun and classes.
  std::map<std::array<std::string, 3>, std::shared_ptr<const PreparedFrame>> prepared_;
  /// By finder, classes and label.
  std::map<std::tuple<std::string, std::string, int>, Carrier> carriers_;
};

/// A vehicle that can carry a mesh.
struct HostHandle {
  std::shared_ptr<FrameHandle> frame;
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
