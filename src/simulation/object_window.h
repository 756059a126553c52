// The picture of an inserted object as it was drawn, before the photograph saturates.
#pragma once

#include "simulation/insertion.h"

namespace mirage {

/// Value of a channel of what a camera saw at a pixel of the photograph; 0 outside its window.
double rgba_at(const CameraSight& seen, int u, int v, int c);

/// The window `rect` of `photograph` with what `simulated` drew over it, not clamped: what is over-exposed
/// keeps its radiance.
ImageF radiance_of(const Simulated& simulated, const ImageF& photograph, const PixelRect& rect);

/// Adds `difference` (rect-sized RGB, scene-linear; `rect` inside the photograph) to the picture: to the
/// object's radiance inside its window, to the photograph beside it. The picture saturates afterwards, and
/// simulate_vjp goes by that: it is the derivative of this sum for a difference held fixed.
void add_to_picture(const ImageF& difference, const PixelRect& rect, Simulated& simulated);

/// The smallest rectangle around both; one that is empty does not count.
PixelRect united(const PixelRect& a, const PixelRect& b);

}  // namespace mirage
