// The height of the ground all round the unit, read off one sweep.
//
// Himmelsbach, von Hundelshausen and Wünsche, "Fast segmentation of 3D point clouds for ground vehicles", IV
// 2010, and Autoware's ray_ground_filter: the sweep is cut into sectors of azimuth, the lowest return of each
// bin of distance is a candidate, and from the unit outward a candidate is ground that continues the slope of
// the ground before it. What a solid stops has no ground behind it, and the slope leads over its shadow. Then
// every bin takes the median of the neighbouring sectors, so that one that went wrong is outvoted.
//
// detection/body_evidence.h knows the road too, as one plane ahead and the lowest return of each square
// metre: that bounds heights of a car's body to a decimetre or two on a level road, and says nothing of a
// hill or of what lies behind the unit.
#pragma once

#include <array>
#include <span>
#include <vector>

namespace mirage::clusters {

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

}  // namespace mirage::clusters
