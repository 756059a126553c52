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

/// Projects the sweep into the image: planar depth (camera z, m) of the nearest return a pixel, 0 if none.
/// Returns that are not finite or nearer than 0.1 m are skipped.
ImageF sparse_depth(const Sweep& sweep, const Calibration& calibration);

/// A back-end. It is deterministic and thread-safe.
class DepthCompletion {
 public:
  virtual ~DepthCompletion() = default;
  /// Its word for --depth, with suffixes for options that differ from the defaults.
  virtual std::string name() const = 0;
  /// `image`: H×W×3 scene-linear RGB (may be empty for back-ends that ignore it); `sparse`: H×W planar depth,
  /// m; a value that is not positive and finite is no return. Returns H×W planar depth, m; kFarDepth where
  /// unknown; never NaN or Inf.
  virtual ImageF complete(const ImageF& image, const ImageF& sparse) const = 0;
};

/// IP-Basic's options (Ku, Harakeh, Waslander, "In Defense of Classical Image Processing", CRV 2018).
struct IpBasicOptions {
  /// False: the paper's method. True: the authors' later variant, which dilates near, middle and far returns
  /// (limits 15 and 30 m) with kernels of 7, 5 and 3 pixels.
  bool multi_scale = false;
  /// The filter that smooths the filled picture.
  enum class Blur { gaussian, bilateral };
  Blur blur = Blur::gaussian;
  /// Repeats each column's topmost value up to the image's upper border, sky or not.
  bool extrapolate = false;
};

/// Inverted depth, dilation, closing of small and large holes, median and a last blur. Ignores returns beyond
/// 100 m and the picture.
class IpBasic : public DepthCompletion {
 public:
  /// Completes with these options.
  explicit IpBasic(const IpBasicOptions& options = {}) : options_(options) {}
  /// "ip-basic", with "-multiscale", "-bilateral", "-extrapolated" for options that differ from the defaults.
  std::string name() const override;
  ImageF complete(const ImageF& image, const ImageF& sparse) const override;

 private:
  IpBasicOptions options_;
};

/// IpBasic with its defaults.
ImageF complete_depth(const ImageF& sparse);

// Errors of a dense depth, as KITTI's depth benchmark defines them (Uhrig et al., 3DV 2017): for each
// picture, then averaged over pictures.

/// Errors of one depth picture as in KITTI's benchmark.
struct DepthErrors {
  double rmse = 0, mae = 0;    ///< mm
  double irmse = 0, imae = 0;  ///< of 1 / depth, 1/km
  std::size_t pixels = 0;      ///< scored pixels; without any, the errors are 0
};

/// Errors over the pixels with 0 < truth ≤ farthest (m) at which `where` (same size, or empty: everywhere) is
/// not 0. Scores kFarDepth in `dense` as a number: exclude it by `where`, or fill it first.
DepthErrors depth_errors(const ImageF& truth, const ImageF& dense, double farthest,
                         const Image<std::uint8_t>& where = {});

/// Mean errors over pictures with a scored pixel; `pixels` is the sum.
class MeanDepthErrors {
 public:
  /// Adds a picture's errors; one without scored pixels does not count.
  void add(const DepthErrors& errors);
  /// Mean over the frames.
  DepthErrors mean() const;

 private:
  DepthErrors sum_;
  int pictures_ = 0;
};

/// Fills pixels without a value (kFarDepth) as the benchmark does before scoring: in each row a gap takes the
/// nearer of its two ends, the row's ends repeat their nearest value, then columns repeat theirs. A picture
/// without any value stays kFarDepth.
ImageF fill_as_benchmark(const ImageF& dense);

}  // namespace mirage
