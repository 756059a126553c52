// Lens and sensor on the pixels of an inserted object. A recorded photograph has been through both; what is
// drawn into it has not.
#pragma once

#include "sensors/camera_effects.h"

namespace mirage {

/// `rgba`: a window of the picture with the object over `photograph` (the same window, RGB), not saturated,
/// and its silhouette S; the object ends kBlurReach pixels before the window does, but for the picture's
/// own edges. Colour and silhouette of the object are blurred, and the photograph shows as far as the blurred
/// silhouette lets it; then comes noise, as far as the object covers a pixel (the photograph has its own). It
/// depends on the draw and the pixel's place in the picture, (u0 + u, v0 + v). The result is what
/// expose_object_vjp needs: `rgba` before the noise; empty without noise.
Image<double> expose_object(const CameraEffects& effects, const ImageF& photograph, int u0, int v0,
                            Image<double>& rgba);

/// d loss / d rgba before, of d loss / d rgba after, in place; `softened` as it came.
void expose_object_vjp(const CameraEffects& effects, const ImageF& photograph, int u0, int v0,
                       const Image<double>& softened, Image<double>& d_rgba);

}  // namespace mirage
