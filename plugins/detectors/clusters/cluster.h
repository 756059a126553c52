// Returns joined to things, and what a thing looks like.
#pragma once

#include <span>
#include <vector>

#include "geometry/seen_rectangle.h"
#include "ground.h"

namespace mirage::clusters {

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

/// Places that are no further apart than their reach, and so on from one to the next: Euclidean clusters
/// (Rusu, "Semantic 3D object maps for everyday manipulation in human living environments", 2010), seen from
/// above as in Autoware's euclidean_cluster. Numbers of clusters in the order of their first place. `reach`
/// (m): of the place; of two the smaller one counts; none over `longest`.
std::vector<int> joined(const std::vector<Vec2d>& places, const std::vector<double>& reach, double longest);

/// Everything between ankle and lorry height that stands on the ground within 80 m, in a fixed order.
std::vector<Cluster> clusters_of(std::span<const Return> returns);

}  // namespace mirage::clusters
