// Errors of a dense depth, as KITTI's depth benchmark defines them (Uhrig et al., 3DV 2017): of each picture,
// then the mean over pictures.
#pragma once

#include <cstddef>
#include <cstdint>

#include "base/image.h"

namespace mirage {

/// Errors of one depth picture as KITTI's benchmark has them.
struct DepthErrors {
  double rmse = 0, mae = 0;    ///< mm
  double irmse = 0, imae = 0;  ///< of 1 / depth, 1/km
  std::size_t pixels = 0;      ///< scored; the errors are 0 when none was
};

/// Over the pixels with 0 < truth ≤ farthest (m) where `where` (same size, or empty: everywhere) is not 0. A
/// `dense` of kFarDepth is scored as the number it is: choose `where`, or fill first.
DepthErrors depth_errors(const ImageF& truth, const ImageF& dense, double farthest,
                         const Image<std::uint8_t>& where = {});

/// Mean over pictures; those without a scored pixel do not count. `pixels` is the sum.
class MeanDepthErrors {
 public:
  /// A frame's; one without scored pixels does not count.
  void add(const DepthErrors& errors);
  /// Mean over the frames.
  DepthErrors mean() const;

 private:
  DepthErrors sum_;
  int pictures_ = 0;
};

/// What the benchmark does to pixels without a value (kFarDepth) before it scores: in each row a gap takes
/// the nearer of its two ends, the row's ends repeat their nearest value, then columns repeat theirs. Nothing
/// at all stays kFarDepth.
ImageF fill_as_benchmark(const ImageF& dense);

}  // namespace mirage
