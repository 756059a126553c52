// How a sweep differs from the one that was recorded.
#pragma once

#include <span>

#include "clean_frame.h"

namespace mirage::fusion {

struct SweepChange {
  std::vector<std::int64_t> now;    ///< by point of the clean sweep: its number in this one, −1: gone
  std::vector<std::int64_t> gone;   ///< of the clean sweep
  std::vector<std::int64_t> fresh;  ///< of this one
  bool empty() const { return gone.empty() && fresh.empty(); }
};

/// Both N × 4, float, contiguous. Points that stay are those found again in their order, to the bit: with
/// some taken out and others put in behind, as an insertion does, these are all that differ.
SweepChange sweep_change(const torch::Tensor& clean, const torch::Tensor& points);

/// Whether a look-up may read a dirty place.
bool touches(const Footprint& footprint, const Dirty& read);

/// A cell of a grid whose image feature is another than before, and the point that it now takes it from (−1:
/// none).
struct ChangedCell {
  std::int64_t cell, point;
};
/// By grid. `read`: where the map that fusion reads differs.
std::array<std::vector<ChangedCell>, kGrids.size()> changed_cells(const CleanFrame& clean,
                                                                  const torch::Tensor& points,
                                                                  const SweepChange& change,
                                                                  const Dirty& read);

}  // namespace mirage::fusion
