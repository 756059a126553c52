// Which vehicle carries the adversary.
#pragma once

#include <compare>
#include <span>
#include <string>
#include <vector>

#include "scene/frame.h"

namespace mirage {

/// One host vehicle: a label of a frame.
struct HostId {
  std::string frame;
  int label = 0;  ///< index into Frame::labels
  /// By frame, then by label.
  auto operator<=>(const HostId&) const = default;
};

/// "000008_0": frame and label, for messages, results and names of files: the frame as escape_name writes it.
std::string host_name(const HostId& id);
/// The frames that they stand in, each once, sorted.
std::vector<std::string> host_frames(std::span<const HostId> hosts);
/// The host's label. InputError if the frame has none of that number, or it is no vehicle with a box in
/// space.
const Label& label_of(const Frame& frame, const HostId& id);
/// The frame's label of that number, which shall carry an object. InputError, for `option`, where it is no
/// vehicle with a box in space: it says what it is, and which labels are vehicles.
const Label& vehicle_of(const Frame& frame, int label, const std::string& option);

}  // namespace mirage
