// One thread for what is timed beside something else.
#pragma once

#include <nlohmann/json.hpp>
#include <vector>

#include "base/parallel.h"
#include "frames/frame_store.h"
#include "frames/hosts.h"
#include "validation/tradeoff/sensor_studies.h"

namespace mirage {

/// Bounds the threads to one for as long as it lives.
class OneThread {
 public:
  OneThread() : before_(thread_count()) { set_thread_count(1); }
  ~OneThread() { set_thread_count(before_); }
  OneThread(const OneThread&) = delete;
  OneThread& operator=(const OneThread&) = delete;

 private:
  int before_;
};

// What a speed–accuracy study is made on: an adversary and the hosts that carry it.

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

// The camera settings that the speed–accuracy study goes through.

/// One axis at a time around `baseline`: sigma, gamma, cut_off, edges (soft, hard), samples, image_scale,
/// arithmetic (float, double), and what each --quality ships (axis "quality").
std::vector<CameraVariant> axis_variants(const SimulationSettings& baseline);
/// All combinations of some σ, γ, cut-offs and samples, in float (axis "grid"). The baseline and every
/// quality are among them.
std::vector<CameraVariant> grid_variants(const SimulationSettings& baseline);

/// What a point's "settings" hold.
nlohmann::json settings_json(const CameraVariant& variant);

}  // namespace mirage
