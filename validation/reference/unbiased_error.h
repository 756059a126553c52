// The error of a picture against the limit of Cycles' renders, estimated from noisy renders.
//
// Let R1, R2 be two independent renders of expectation r, and A1, A2 two of the picture in question, of
// expectation a (one without noise is both of its halves). With A and R the means of the halves, at each
// pixel and channel,
//     plain    = (A − R)²                                what is usually reported
//     floor    = (A1 − A2)²/4 + (R1 − R2)²/4             expectation: variance of A plus variance of R
//     unbiased = plain − floor
//              = ½ [(A1 − R1)(A2 − R2) + (A1 − R2)(A2 − R1)]        expectation: (a − r)²
//     drawn    = plain − (R1 − R2)²/4                    expectation over R1, R2: (A − r)²
// `unbiased` is the error of the drawing method with infinitely many samples; `drawn` is that of this very
// picture, its own noise included. Both may come out negative where the error is below the noise; roots keep
// the sign (signed_root), so that a mean over many is not biased upwards.
//
// Nothing may be clamped before: the mean of clamped renders is not the clamped mean, and over-exposure
// counts.
#pragma once

#include "base/fields.h"
#include "base/image.h"
#include "base/intervals.h"

namespace mirage {

/// A picture as two independent renders with half of the samples each, scene-linear and not clamped.
struct Halves {
  ImageF first, second;  ///< second empty: no noise
  /// The picture: their mean.
  ImageF mean() const;
};

/// √|x| with the sign of x.
double signed_root(double x);
/// The same for a mean square and the ends of its interval.
Interval signed_root(const Interval& square);

/// Squared errors over a region as shares of the object's mean radiance, squared.
struct ErrorSquares {
  double plain = 0, floor = 0, drawn = 0, unbiased = 0;
};
template <class Visitor, FieldsOf<ErrorSquares> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "plain", s.plain, "floor", s.floor, "drawn", s.drawn, "unbiased", s.unbiased);
}
struct SquaredError : ErrorSquares {
  /// signed_root(unbiased) with the 95 % interval over tiles of 8×8 pixels (base/intervals.h; a single tile:
  /// as far as the noise): what the noise of these renders leaves open on this one picture.
  Interval interval;
};
/// The squares, and all of them as roots.
template <class Visitor, FieldsOf<SquaredError> S>
void visit_fields(Visitor& visit, S& s) {
  visit.group({.name = "squared"}, as_base<ErrorSquares>(s));
  visit.derived("error_plain", signed_root(s.plain));
  visit.derived("floor", signed_root(s.floor));
  visit.derived("error_drawn", signed_root(s.drawn));
  visit.derived("error_unbiased", signed_root(s.unbiased));
  visit.group({.name = "interval"}, s.interval);
}

/// Sums over the pixels of `region` (1 channel, > 0.5 counts) and all channels, divided by `pixels` ×
/// channels × mean². `pixels`: the object's number of pixels, so that errors beside the object add to the
/// error and do not dilute it. All 0 if `pixels` or `mean` is. Failure for images of different size.
SquaredError squared_error(const Halves& drawn, const Halves& reference, const ImageF& region, double pixels,
                           double mean);

}  // namespace mirage
