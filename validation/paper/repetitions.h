// The same experiments again from other seeds: each attack is learned anew, on another split of the frames,
// and judged beside the first one.
#pragma once

#include <string>

#include "validation/paper/cases.h"

namespace mirage::paper {

/// The name of an attack's or evaluation's repetition; number 0 is the case itself.
std::string repetition(const std::string& name, int number);
bool is_repetition(const std::string& name);

/// Appends settings.seeds − 1 repetitions of every attack and evaluation, a whole seed after the other.
void repeat(Experiments& experiments, const ReproduceSettings& settings);

}  // namespace mirage::paper
