// What a speed–accuracy study is made on: an adversary and the hosts that carry it.
#pragma once

#include <vector>

#include "frames/frame_store.h"
#include "frames/hosts.h"
#include "validation/tradeoff/settings.h"

namespace mirage {

struct Subjects {
  TexturedMesh adversary;
  std::vector<HostId> hosts;  ///< by distance
};

/// The run's adversary and hosts; without a run (null) a random mesh, and cars of settings.source.data that
/// leave it in view. settings.hosts at most, evenly over their distances. InputError if no car can be used.
Subjects choose_subjects(const TradeoffSettings& settings, const Run* run, FrameStore& store);

/// `count` of the list, evenly over it; 0: all.
template <class T>
std::vector<T> evenly(const std::vector<T>& list, std::size_t count) {
  if (count == 0 || count >= list.size()) return list;
  std::vector<T> spread;
  for (std::size_t i = 0; i < count; ++i)
    spread.push_back(list[count == 1 ? list.size() / 2 : i * (list.size() - 1) / (count - 1)]);
  return spread;
}

}  // namespace mirage
