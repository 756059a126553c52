// Bodies and shadows as a defence: what a detector says is held against what the sweep says of solid bodies
// without any network (body_evidence.h). In logits:
//
//     a body stands there      its proposals, and the body's own box, are raised by kBodyLift up to
//     kBodyLogit;
//                              beyond, with the slope kBodySlope: the better of two stays the better
//     rays go through there    a proposal above kThroughLogit sinks to it, but for the same slope: five rays
//     or
//                              more, and more than are stopped
//
// An object on a roof changes neither bodies nor the rays below it, so all that an attacker who knows the
// defence can do is to push a car's logit further, by kBodyLift; the gradient that says how is there.
#pragma once

#include <memory>

#include "detection/detector.h"

namespace mirage {

/// A score of 0.38: such a body counts as found where 0.3 is asked for, and comes behind what the detector
/// finds by itself, since every other body of a car's size is none (look-alikes, vans, what stands in
/// gardens).
inline constexpr double kBodyLogit = -0.5;
inline constexpr double kBodyLift = 4, kBodySlope = 0.05, kThroughLogit = -2;
inline constexpr int kThroughRays = 5;

/// FieldError naming defense if `detector` finds no boxes from above or reads no returns. Training and saving
/// are those of `detector`.
std::unique_ptr<Detector> with_shadows(std::unique_ptr<Detector> detector);

}  // namespace mirage
