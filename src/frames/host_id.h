// The identity of the vehicle that carries the adversary.
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

/// "000008_0": frame (as escape_name writes it) and label, for messages, results and file names.
std::string host_name(const HostId& id);
/// The hosts' frames, each once, sorted.
std::vector<std::string> host_frames(std::span<const HostId> hosts);
/// The host's label. InputError if the frame has no such label, or if it is not a vehicle with a 3-D box.
const Label& label_of(const Frame& frame, const HostId& id);
/// The frame's label of that number, which is to carry an object. InputError for `option` if it is not a
/// vehicle with a 3-D box; it names the label's class and the labels that are vehicles.
const Label& vehicle_of(const Frame& frame, int label, const std::string& option);

}  // namespace mirage
