// Light and camera of a generated frame.
#pragma once

#include <cstdint>

#include "base/image.h"
#include "sensors/ray_camera.h"

namespace mirage::generator {

/// Sun, sky and exposure of frame `index` of a seed, the same for every look: sun 14 to 60 degrees up
/// anywhere around; a quarter of the frames overcast (sun 7 to 44 % as strong, sky nearly even), the rest
/// clear or with clouds; exposure 0.85 to 1.5, so that skies and white cars clip now and then as in street
/// pictures.
SceneLight make_light(std::uint64_t seed, std::uint64_t index);

/// What lens and sensor do to the rendered picture: a blur of 0.5 to 0.85 pixels (sigma), then shot noise of
/// 2e-5 to 1.2e-4 of the signal (variance) and read noise of 0.5e-3 to 2e-3 (sigma), scene-linear.
/// Lens and sensor are those of `index`, the noise is drawn by `moment`.
void expose(ImageF& image, std::uint64_t seed, std::uint64_t index, std::uint64_t moment);

}  // namespace mirage::generator
