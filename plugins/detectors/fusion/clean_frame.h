// Cached feature maps of a frame as recorded: for the same frame with an object only windows are then
// computed (local_network.h).
#pragma once

#include <condition_variable>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <span>

#include "branch_plans.h"

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
  /// Of a network with continuous fusion, by grid: the point that feeds a cell, −1: none.
  std::array<std::vector<std::int32_t>, kGrids.size()> nearest;
  std::vector<Footprint> footprints;  ///< of points in the map that fusion reads
  std::size_t bytes() const;
};

/// The most recently used clean frames of one network. Instances that share the network share it;
/// thread-safe.
class CleanActivationCache {
 public:
  /// `most`: bytes kept; bfloat16: convolutions, as plan.h says. A larger single frame is made and used, but
  /// not kept.
  CleanActivationCache(Network network, std::size_t most, bool bfloat16 = false)
      : network_(std::move(network)), most_(most), bfloat16_(bfloat16) {}

  /// Empty if the network's passes can be local, otherwise why they cannot.
  static const char* why_whole(const Parts& parts);
  /// The clean frame of the input that `key` identifies; input() is called if it is not cached.
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
  mutable std::mutex mutex_;  // of the members below
  using Kept = std::pair<std::uint64_t, std::shared_ptr<const CleanFrame>>;
  std::list<Kept> kept_;  ///< the one used last is first
  std::set<std::uint64_t> making_;
  std::condition_variable ready_;
  std::size_t bytes_ = 0;
  std::map<std::pair<std::int64_t, std::int64_t>, std::shared_ptr<const CameraPlan>> camera_plans_;
  std::shared_ptr<const BackbonePlan> backbone_;
};

/// The places that a look-up at a pixel may read, in a map of rows × columns with one place for each stride ×
/// stride pixels; slightly enlarged, against rounding.
Footprint footprint_of(const PixelDepth& pixel, int stride, std::int64_t rows, std::int64_t columns);

// How a sweep differs from the one that was recorded.

struct SweepChange {
  std::vector<std::int64_t> now;      ///< by point of the clean sweep: its number in this one, −1: gone
  std::vector<std::int64_t> removed;  ///< of the clean sweep
  std::vector<std::int64_t> added;    ///< of this one
  std::vector<const float*> moved;    ///< all of these, in the tensors' memory
};

/// Both N × 4, float, contiguous. Points that stay are those found again in order, bit for bit: if some are
/// removed and others appended, as by an insertion, only these differ.
SweepChange sweep_change(const torch::Tensor& clean, const torch::Tensor& points);

/// Whether a look-up may read a dirty place.
bool touches(const Footprint& footprint, const ChangedRegion& read);

/// A cell of a grid whose image feature changed, and the point that it now comes from (−1: none).
struct ChangedCell {
  std::int64_t cell, point;
};
/// By grid. `read`: the changed region of the map that fusion reads.
std::array<std::vector<ChangedCell>, kGrids.size()> changed_cells(const CleanFrame& clean,
                                                                  const torch::Tensor& points,
                                                                  const SweepChange& change,
                                                                  const ChangedRegion& read);

}  // namespace mirage::fusion
