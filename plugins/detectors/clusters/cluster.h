// Clusters of returns, and their measurements.
#pragma once

#include <span>
#include <vector>

#include "geometry/box.h"

namespace mirage::clusters {

// The height of the ground all round the unit, read off one sweep.
//
// Himmelsbach, von Hundelshausen and Wünsche, "Fast segmentation of 3D point clouds for ground vehicles", IV
// 2010, and Autoware's ray_ground_filter: the sweep is cut into sectors of azimuth, the lowest return of each
// bin of distance is a candidate, and from the unit outward a candidate is ground that continues the slope of
// the ground before it. A solid object has no ground behind it, and the slope leads over its shadow. Then
// every bin takes the median of the neighbouring sectors, so that a wrong one is outvoted.
//
// detection/defenses.h knows the road too, as one plane ahead and the lowest return of each square metre:
// that is right to a decimetre or two on a level road, and knows neither hills nor the ground behind the
// unit.

/// A finite return beside the unit: place in the ego frame (m).
struct Return {
  float x = 0, y = 0, z = 0;
};

class Ground {
 public:
  explicit Ground(std::span<const Return> returns);
  /// z (m, ego).
  double height(double x, double y) const;

 private:
  static constexpr std::size_t kSectors = 180, kBins = 180;
  static constexpr double kBin = 0.5;  // m
  static std::size_t sector_of(double x, double y);

  /// Of each sector and bin, at the bin's middle.
  std::vector<double> heights_;
};

/// A thing that stands on the ground, as the sweep shows it.
struct Cluster {
  SeenRectangle seen;  ///< from above
  double ground = 0;   ///< z (m, ego) of the ground under it
  double height = 0;   ///< m over the ground, of its highest return
  int returns = 0;
  /// Rays through the lower half of its outline that went on behind it: twigs and grass let rays through.
  int passed = 0;
  /// Returns a square radian (azimuth times slope) around it, at any range: how finely the unit looks there.
  double density = 0;
};

/// Euclidean clusters: chains of places that are no further apart than their reach (Rusu, "Semantic 3D object
/// maps for everyday manipulation in human living environments", 2010), seen from above as in Autoware's
/// euclidean_cluster. Each place's cluster, numbered in the order of first places. `reach` (m): of each
/// place; the smaller of two counts; none over `longest`.
std::vector<int> cluster_numbers(const std::vector<Vec2d>& places, const std::vector<double>& reach,
                                 double longest);

/// Everything between ankle and lorry height that stands on the ground within 80 m, in a fixed order.
std::vector<Cluster> clusters_of(std::span<const Return> returns);

}  // namespace mirage::clusters
