// The insertion's VJP over the caller's own memory, in float or in double, and what an insertion holds beyond
// float: for hosts whose arrays are not Mirage's (plugins/python), and for derivatives that are to be
// checked.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "simulation/lidar_silhouette.h"
#include "simulation/simulation.h"

namespace mirage {

/// d loss / d image and d loss / d points, read where they lie. Nothing is copied; of the image only the
/// pixels of Simulated::rect are read, of the points only the returns on the object.
template <class S>
struct Upstream {
  const S* image = nullptr;  ///< height × width × 3, row-major; null: none
  int width = 0, height = 0;
  std::span<const std::array<S, 4>> points = {};  ///< one a point of Simulated::sweep; empty: none
  const LidarSilhouette* silhouette = nullptr;    ///< of the placed adversary; null: held fixed
  std::span<const S> presence = {};               ///< one a place of it; empty: none
  /// As `image`, of each of Simulated::others, then of each of Simulated::measurements, in the measurement's
  /// shape: null where there is none, empty if there is none of any.
  std::span<const S* const> others = {};
};

/// As simulate_vjp of simulation/insertion.h, S float or double. In double, what was drawn with
/// SimulationSettings::reference keeps the upstream's precision.
template <class S>
AdversaryGradient simulate_vjp(const Simulated& simulated, const Upstream<S>& upstream);

/// The returns on the object (x, y, z in `velo`, m; reflectance) in double, in their order at the end of
/// Simulated::sweep.
std::vector<std::array<double, 4>> object_returns(const Simulated& simulated);

/// The adversary as it stands in `velo`.
const TexturedMesh& placed_adversary(const Simulated& simulated);

}  // namespace mirage
