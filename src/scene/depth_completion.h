// Dense depth of the photograph from a sparse sweep: one interface, several back-ends.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "base/image.h"
#include "scene/frame.h"

namespace mirage {

/// Depth of pixels with no information (sky, unfilled): everything is in front of it.
inline constexpr float kFarDepth = 1e6f;

/// Projects the sweep into the image: planar depth (camera z, m) of the nearest return a pixel, 0 where none.
/// Returns that are not finite or nearer than 0.1 m are skipped.
ImageF sparse_depth(const Sweep& sweep, const Calibration& calibration);

/// A back-end. The same input gives the same output, and several threads may call one object at once.
class DepthCompletion {
 public:
  virtual ~DepthCompletion() = default;
  /// The word that chooses it (--depth), with what differs from its defaults.
  virtual std::string name() const = 0;
  /// `image`: H×W×3 scene-linear RGB (back-ends that do not look at it take an empty one); `sparse`: H×W
  /// planar depth, m; what is not a positive finite number is no return. Gives H×W planar depth, m; kFarDepth
  /// where there is none. Never NaN or Inf.
  virtual ImageF complete(const ImageF& image, const ImageF& sparse) const = 0;
};

/// IP-Basic's choices (Ku, Harakeh, Waslander, "In Defense of Classical Image Processing", CRV 2018).
struct IpBasicOptions {
  /// False: the paper's method. True: the authors' later variant, which dilates near, middle and far returns
  /// (limits 15 and 30 m) with kernels of 7, 5 and 3 pixels.
  bool multi_scale = false;
  /// What smooths the filled picture.
  enum class Blur { gaussian, bilateral };
  Blur blur = Blur::gaussian;
  /// Repeats each column's topmost value up to the image's upper border, sky or not.
  bool extrapolate = false;
};

/// Inverted depth, dilation, closing of small and large holes, median and a last blur. Returns beyond 100 m
/// are left out. Looks at the sweep only.
class IpBasic : public DepthCompletion {
 public:
  /// Completes by these options.
  explicit IpBasic(const IpBasicOptions& options = {}) : options_(options) {}
  /// "ip-basic", and "-multiscale", "-bilateral", "-extrapolated" for what differs from the default.
  std::string name() const override;
  ImageF complete(const ImageF& image, const ImageF& sparse) const override;

 private:
  IpBasicOptions options_;
};

/// IpBasic with its defaults.
ImageF complete_depth(const ImageF& sparse);

// Errors of a dense depth, as KITTI's depth benchmark defines them (Uhrig et al., 3DV 2017): of each picture,
// then the mean over pictures.

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
