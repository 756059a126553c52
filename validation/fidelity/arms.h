// What the verdict rests on at one vehicle: the detector before the object as the attack learned it, before
// the same object drawn in three kinds of light and met by two kinds of returns, and before controls that
// take a sensor's view of the object away.
#pragma once

#include <functional>

#include "validation/fidelity/host_validation.h"
#include "validation/fidelity/vehicle_result.h"

namespace mirage {

/// What the detector makes of a picture of the frame and a sweep.
using LookAt = std::function<OutcomeResult(const ImageF& image, const Sweep& sweep)>;

/// Arms and controls of a vehicle.
///   arms: the first is learned × learned, `learned` itself. Then light "raster" (the plain model), "visible"
///     (with visibility, edges as the scene's) or "cycles" (`full`), by returns "ideal" (thin noiseless rays)
///     or "realistic" (all effects of realistic_returns).
///   controls, by channel, against that first arm.
///     image, "noise": the object's pixels replaced by noise, uniform in each pixel and channel;
///     image, "photograph": the picture as recorded, the object unseen;
///     lidar, "no returns": the sweep as recorded, the object unmet.
/// `attacked`: simulate() with the scene's settings. `learned`: with the run's own, which may have other
/// light, edges and sensors' effects.
ArmsResult look_at_arms(const HostScene& scene, const Simulated& attacked, const Simulated& learned,
                        const FullLight& full, const LookAt& look);

/// `photograph` with noise in the place of what `simulated` drew, as far as its silhouette covers each pixel.
ImageF noise_in_place(const Simulated& simulated, const ImageF& photograph, std::uint64_t seed);

}  // namespace mirage
