// In which order an attack meets its hosts: at random, and such that a detector that keeps what it made of a
// frame (detection/detector.h, clean_memory_mb) meets all hosts of a frame while it still has it.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "frames/hosts.h"

namespace mirage {

/// Frames that are open at a time, of all lanes together: what the largest shipped detector keeps in 2 GiB
/// (110 MB a frame). A constant, because the order decides what is learned and memory must not.
inline constexpr std::size_t kOpenFrames = 16;

/// Place k of every batch belongs to a lane, k mod lanes(); a lane has frames of its own. Where every place
/// is a lane, so has each of several processes (a process has certain places, attack/rank_steps.h): no two of
/// them make the same frame's clean activations. A lane is an endless sequence of passes over its hosts. In a
/// pass its frames are opened in random order, some at a time; the next host is drawn among all that are left
/// of the open ones, and a frame of which none is left makes room for the next. A batch meets no host twice
/// where there are enough. Known by (hosts, batch, seed) alone.
class HostOrder {
 public:
  /// As many lanes as the batch has places, fewer where frames could not be dealt so that the hosts of no
  /// lane outnumber those of another by more than a quarter: hosts are to be met equally often. `batch` ≥ 1;
  /// `hosts` not empty.
  HostOrder(std::span<const Host> hosts, int batch, std::uint64_t seed);

  /// Indices into the hosts for iteration `iteration`, `batch` of them.
  std::vector<std::size_t> batch(long iteration) const;
  std::size_t lanes() const { return lanes_.size(); }

 private:
  /// Frames, each a list of hosts.
  using Lane = std::vector<std::vector<std::size_t>>;
  /// Of a batch, the lane's.
  std::size_t places(std::size_t lane) const;
  /// The hosts of a lane in the order of pass `pass`, as drawn.
  std::vector<std::size_t> drawn_order(std::size_t lane, long pass) const;
  /// The same; those of its first batch were not met in it by the end of the pass before, if the lane has
  /// three times as many hosts as that takes.
  std::vector<std::size_t> order(std::size_t lane, long pass) const;

  int batch_;
  std::uint64_t seed_;
  std::vector<Lane> lanes_;
};

}  // namespace mirage
