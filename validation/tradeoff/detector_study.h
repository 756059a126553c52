// The detector's side of the speed–accuracy study: one attack step of a host (simulation, detector,
// objective, and back) with the detector's passes made in several ways.
#pragma once

#include <vector>

#include "attack/observation.h"
#include "detection/detector.h"
#include "geometry/mesh.h"
#include "validation/tradeoff/points.h"

namespace mirage {

/// Axes: "passes" (over the whole frame; over what the object changes, which is the default and the
/// baseline), "precision" (bfloat16 where the processor multiplies it), and "locality" (1, 2, 4, 8 m of
/// surroundings).
/// Errors: "gradient_cosine" and "gradient_norm" of the adversary's gradient (vertices and texels) against
/// that of whole passes in double, "gradient" = 1 − the cosine, and "gradient_cosine_least", the worst
/// host's; means over hosts whose reference is not zero. Times: CPU time of one thread, clean frames kept,
/// medians of `repeats` in alternation with the baseline. Empty if every reference is zero. InputError,
/// FieldError as load_detector has them.
std::vector<TradeoffPoint> detector_points(const DetectorOptions& options, const std::vector<StepHost>& hosts,
                                           const TexturedMesh& adversary, int repeats);

}  // namespace mirage
