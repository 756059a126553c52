// Which labels are vehicles and people, in the eyes of an attack's objective and of its evaluation.
#pragma once

#include <vector>

#include "scene/frame.h"

namespace mirage {

/// A box on it is no false positive. DontCare regions are none, nor is "Misc": what looks like a car and is
/// none (the generator's hedges and stacks of goods) is background to a detector, under attack too.
bool is_road_user(const Label& label);

/// BEV boxes of every labelled road user.
std::vector<BevBox> ground_truth_boxes(const Frame& frame);

}  // namespace mirage
