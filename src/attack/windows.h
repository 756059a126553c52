// Windows of one vehicle: the hosts of a step with --objective gap, in order of time (objective.h,
// window_loss). A window is kShortestWindow to kLongestWindow long; its frames are those in which the vehicle
// is among the hosts that are given, at the times at which they were taken.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "frames/hosts.h"

namespace mirage {

/// In seconds.
inline constexpr double kShortestWindow = 0.5, kLongestWindow = 2;

/// A host of the vehicle that is followed: its index among the hosts, and when its frame was taken.
struct HostAt {
  std::size_t host = 0;
  double time = 0;
};

/// The hosts of each vehicle by rising time: a vehicle is an identity in a sequence of the data set.
/// FieldError naming objective if none of them is followed through kShortestWindow.
std::vector<std::vector<HostAt>> followed(const std::filesystem::path& data, std::span<const Host> hosts);

/// Each iteration has a window of one vehicle. A pass meets every vehicle once, in random order; a window's
/// length is drawn uniformly, its first frame among those with another in reach, and it ends with the last
/// frame within its length. Known by (tracks, batch, seed) alone.
class WindowOrder {
 public:
  /// Tracks in which no two frames are a window apart are left out; one at least has them. `batch` ≥ 2.
  WindowOrder(std::vector<std::vector<HostAt>> tracks, int batch, std::uint64_t seed);
  /// The window's hosts by rising time: `batch` of them, evenly spread, or all where there are fewer.
  std::vector<std::size_t> batch(long iteration) const;

 private:
  std::size_t batch_;
  std::uint64_t seed_;
  std::vector<std::vector<HostAt>> tracks_;
};

}  // namespace mirage
