// What a network makes of a frame as it was recorded, kept so that the same frame with an object in it needs
// windows only (local_network.h).
#pragma once

#include <condition_variable>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <set>

#include "backbone_plan.h"
#include "camera_plan.h"

namespace mirage::fusion {

/// A rectangle of places that a bilinear look-up may read.
struct Footprint {
  std::int16_t top = 0, left = 0, bottom = -1, right = -1;  ///< inclusive
};

struct CleanFrame {
  std::int64_t height = 0, width = 0;
  Projection projection{};
  torch::Tensor points;  ///< N × 4, float
  std::shared_ptr<const CameraPlan> camera_plan;
  std::shared_ptr<const BackbonePlan> backbone_plan;
  CleanMaps camera, backbone;
  torch::Tensor painted;  ///< of a network that paints
  /// Of a network with continuous fusion, by grid: the point that feeds a cell, −1: none.
  std::array<std::vector<std::int32_t>, kGrids.size()> nearest;
  std::vector<Footprint> footprints;  ///< of points in the map that fusion reads
  std::size_t bytes() const;
};

/// The clean frames of one network, those used last. Instances that share the network share it; several
/// threads may ask at once.
class CleanFrames {
 public:
  /// `most`: bytes kept; bfloat16: convolutions, as plan.h says. A frame alone may be larger: it is made and
  /// used, and not kept.
  CleanFrames(Network network, std::size_t most, bool bfloat16 = false)
      : network_(std::move(network)), most_(most), bfloat16_(bfloat16) {}

  /// Empty if the network's passes can be local, else why they cannot.
  static const char* why_whole(const Parts& parts);
  /// Of the input that `key` stands for; `input` is asked for it where it is not kept.
  std::shared_ptr<const CleanFrame> of(std::uint64_t key, const std::function<SensorTensors()>& input);
  /// The network has changed.
  void forget();
  std::size_t bytes() const;

 private:
  std::shared_ptr<CleanFrame> make(const SensorTensors& input);
  std::shared_ptr<const CameraPlan> camera_plan(std::int64_t height, std::int64_t width);
  std::shared_ptr<const BackbonePlan> backbone();

  Network network_;
  std::size_t most_;
  bool bfloat16_;
  mutable std::mutex mutex_;  // of what follows
  using Kept = std::pair<std::uint64_t, std::shared_ptr<const CleanFrame>>;
  std::list<Kept> kept_;  ///< the one used last is first
  std::set<std::uint64_t> making_;
  std::condition_variable ready_;
  std::size_t bytes_ = 0;
  std::map<std::pair<std::int64_t, std::int64_t>, std::shared_ptr<const CameraPlan>> camera_plans_;
  std::shared_ptr<const BackbonePlan> backbone_;
};

/// Where a point's look-up in a map of rows × columns may read; a bit more, against rounding.
Footprint footprint_of(double column, double row, std::int64_t rows, std::int64_t columns);

}  // namespace mirage::fusion
