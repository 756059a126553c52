// Consistency between sensors as a defence: what a fusion detector says of a place is held against what each
// sensor says of it alone. In logits, with soft(a, b) = (1 − kWitnessLeak) a + kWitnessLeak b:
//
//     found by the fusion     counts little more than the better of two witnesses, the LiDAR-only detector's
//                             proposal there and the camera network's box there: what no sensor sees by
//                             itself is no car. Above cap = max(lidar, camera) + kWitnessMargin:  logit ←
//                             soft(cap, logit)
//     missed by the fusion    is found all the same where both witnesses agree on it: the LiDAR-only
//                             detector's box, with  logit = soft(min(lidar, camera), max(lidar, camera))
//
// So an object that hides a car has to fool the fusion and a sensor alone, and one that makes a car up has to
// be one to a sensor alone. The leak keeps apart what one witness speaks for: proposals of equal logits would
// leave it to chance which box non-maximum suppression keeps.
//
// An attacker who knows the defence has its gradient: it goes to the logits that decide. Which proposals
// belong together, and boxes, carry none (as IoU in the objective). Of several proposals of a witness the
// best alone speaks, so a step of an attack sees the next best only once the best has sunk.
// The idea, in other forms: cross-sensor checks against LiDAR spoofing (Sun et al., USENIX Security 2020).
#pragma once

#include <memory>

#include "detection/detector.h"

namespace mirage {

/// See above; a witness that says nothing of a place counts as kSilentLogit (defenses.h).
inline constexpr double kWitnessMargin = 2, kWitnessLeak = 0.05;
/// Below it a proposal is held against nobody, and LiDAR's are no candidates.
inline constexpr double kFaintLogit = -4;

/// `fused` finds boxes from above; `lidar` reads returns and finds them from above, too; `camera` finds boxes
/// in the picture. FieldError naming defense if they do not. Training and saving are those of `fused`.
std::unique_ptr<Detector> with_witnesses(std::unique_ptr<Detector> fused, std::unique_ptr<Detector> lidar,
                                         std::unique_ptr<Detector> camera);

}  // namespace mirage
