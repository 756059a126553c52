// The gate of detection/reliance.h for the detector and the data that a command works with, kept on disk by
// content.
#pragma once

#include <filesystem>
#include <string>

#include "attack/detector_pool.h"
#include "detection/reliance.h"

namespace mirage {

/// measure_reliance() on at most kAuditFrames of the data set's frames, spread evenly, or what is kept of it
/// in DiskCache::from_environment() for the same detector, frames and program. `identity`:
/// detector_identity() of the pool's options; empty: not cached. Shows progress unless `quiet`.
Reliance cached_reliance(const DetectorPool& detectors, const std::string& identity,
                         const std::filesystem::path& data, bool quiet = true);

}  // namespace mirage
