// Run files of before version 0.2.
#pragma once

#include <nlohmann/json.hpp>

namespace mirage {

/// `run` (run.json, or the identity in a checkpoint) with every setting that files of before version 0.2 left
/// out, at what it was then: the one place that says what its absence means. Today's files name them all.
nlohmann::json with_unnamed_settings(nlohmann::json run);

}  // namespace mirage
