// Consistency between sensors as a defence: a fusion detector's proposals are cross-checked with those of
// each sensor alone. In logits, with soft(a, b) = (1 − kVoteLeak) a + kVoteLeak b:
//
//     found by the fusion     counts little more than the better of two votes, the LiDAR-only detector's
//                             proposal there and the camera network's box there: an object that no
//                             sensor sees by itself is no car. Above cap = max(lidar, camera) +
//                             kVoteMargin:  logit ← soft(cap, logit)
//     missed by the fusion    is found all the same where both votes agree on it: the LiDAR-only
//                             detector's box, with  logit = soft(min(lidar, camera), max(lidar, camera))
//
// So an object that hides a car has to fool the fusion and a sensor alone; one that fakes a car has to fool a
// sensor alone. The leak keeps apart boxes with the same vote: proposals of equal logits would leave it to
// chance which box non-maximum suppression keeps.
//
// An attacker who knows the defence has its gradient: it goes to the logits that decide. Boxes and the
// matching of proposals carry none (as IoU in the objective). Of a sensor's proposals only the best votes, so
// a step of an attack sees the next best only once the best has sunk. The idea, in other forms: cross-sensor
// checks against LiDAR spoofing (Sun et al., USENIX Security 2020).
#pragma once

#include <memory>

#include "detection/detector.h"

namespace mirage {

/// See above; a sensor without a proposal at a place votes kNoDetectionLogit (defenses.h).
inline constexpr double kVoteMargin = 2, kVoteLeak = 0.05;
/// Proposals below it are not checked, and those of the LiDAR are no candidates.
inline constexpr double kMinVotingLogit = -4;

/// `fused` finds boxes from above; `lidar` reads returns and finds them from above, too; `camera` finds boxes
/// in the picture. FieldError naming defense if they do not. Training and saving are those of `fused`.
std::unique_ptr<Detector> with_consistency(std::unique_ptr<Detector> fused, std::unique_ptr<Detector> lidar,
                                           std::unique_ptr<Detector> camera);

}  // namespace mirage
