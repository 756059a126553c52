// The experiments of Tu et al. (CoRL 2021) and our own, as a list: which commands of mirage each table needs.
// experiments.toml has the rows and what the paper printed, and between which detectors the matrices are.
#pragma once

#include "validation/paper/cases.h"

namespace mirage::paper {

/// Fewer frames and iterations, as far as they are still at their defaults, and some rows of many alike:
/// every kind of experiment runs in minutes, and its figures say nothing.
void make_quick(ReproduceSettings& settings);

/// What `settings.what` asks for. InputError for another word.
Experiments experiments(const ReproduceSettings& settings);

}  // namespace mirage::paper
