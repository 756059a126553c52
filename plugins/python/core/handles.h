// The state of the module's Python objects.
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

/// A frame of a data set with its prepared frames, by the settings that they depend on. Thread-safe.
class FrameHandle {
 public:
  /// `rig`: the recording rig, as in data_rig.h. InputError as read_frame's.
  FrameHandle(const std::filesystem::path& data, const std::string& id, const std::string& rig);
  /// A frame of no data set; an empty `rig` is assumed to be KITTI's. InputError as rig_file's.
  FrameHandle(Frame frame, const std::string& rig);

  const Frame& frame() const { return frame_; }
  /// The frame prepared with the depth, the sun and the sought classes of `settings`. Warnings and InputError
  /// as check_data's, for arrays as check_sweep's.
  std::shared_ptr<const PreparedFrame> prepared(const cli::InsertionOptions& settings);
  /// A label's vehicle with its roof as `settings` find it. InputError naming the label if it is not one.
  Carrier carrier(const cli::InsertionOptions& settings, int label);
  /// The recorded effects in the data set's returns (scene/data/data_rig.h).
  const std::string& recorded_effects() const { return recorded_; }

 private:
  /// For arrays: checks by the sweep's index that the unit recorded it. InputError if it did not and the rig
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

/// An insertion and its inputs.
struct ResultHandle {
  std::shared_ptr<FrameHandle> frame;
  std::shared_ptr<const PreparedFrame> prepared;
  Simulated simulated;
  int resolution = 1;  ///< of the mesh's atlas
  bool in_double = false;
};

}  // namespace mirage::python
