// How far two pictures are apart. Images of equal size; `mask` (1 channel, > 0.5 counts) may be empty: all
// pixels.
#pragma once

#include "base/fields.h"
#include "base/image.h"

namespace mirage {

/// Mean over pixels and channels of |a − b|. 0 for an empty mask.
double mean_absolute_error(const ImageF& a, const ImageF& b, const ImageF& mask = {});
/// Mean over pixels and channels of |value|: mean_absolute_error from black.
double mean_of(const ImageF& image, const ImageF& mask = {});
/// mean_absolute_error over the mean |value| of `from` there; 0 where that is black.
double relative_error(const ImageF& from, const ImageF& to, const ImageF& mask = {});
/// Largest |a − b| over pixels and channels.
double max_absolute_error(const ImageF& a, const ImageF& b, const ImageF& mask = {});
/// Intersection over union of two 1-channel masks (> 0.5). 1 when both are empty.
double mask_iou(const ImageF& a, const ImageF& b);
/// Peak signal-to-noise ratio (dB) for values in [0, 1]. Infinite for equal images.
double psnr(const ImageF& a, const ImageF& b, const ImageF& mask = {});

/// Structural similarity (Wang, Bovik, Sheikh, Simoncelli, IEEE TIP 2004) of 1-channel images in [0, 1]:
/// 11×11 Gaussian window with σ = 1.5, K1 = 0.01, K2 = 0.03, population covariance; mean over the mask's
/// pixels. Windows are mirrored at the border.
double ssim(const ImageF& a, const ImageF& b, const ImageF& mask = {});

/// FLIP for low dynamic range (Andersson et al., HPG 2020): sRGB-encoded images in [0, 1], 3 channels, as
/// seen at 67 pixels a degree (0.7 m before a 0.7 m wide 4K display). Mean over the mask's pixels of the
/// error of each, in [0, 1].
double flip(const ImageF& reference, const ImageF& test, const ImageF& mask = {});

/// Luminance (Rec. 709 weights) of a 3-channel image.
ImageF grey(const ImageF& rgb);
/// Scene-linear → sRGB-encoded, clamped to [0, 1].
ImageF encoded(const ImageF& linear);

/// How far two pictures are apart: mean |Δ| of scene-linear radiance, the same over the mean radiance, PSNR
/// of scene-linear values (infinite where equal), SSIM and FLIP of the sRGB-encoded ones.
struct Change {
  double mae = 0, relative = 0, psnr = 0, ssim = 1, flip = 0;
};
template <class Visitor, FieldsOf<Change> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "mae", s.mae, "relative", s.relative);
  visit({.name = "psnr", .endless = true}, s.psnr);
  visit_named(visit, "ssim", s.ssim, "flip", s.flip);
}
/// `from` is the reference, whose mean radiance `relative` divides by. `mask` may be empty: all pixels.
Change change(const ImageF& from, const ImageF& to, const ImageF& mask);

}  // namespace mirage
