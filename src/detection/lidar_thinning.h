// Training samples with fewer returns than were recorded, so that a detector has to look at its picture too.
#pragma once

#include <cstdint>

#include "detection/compact_frame.h"

namespace mirage {

/// In a `share` of the samples, half and half: only every 2nd, 4th or 8th beam of the unit stays, or 30 % of
/// the cars and of what looks like one lose 70 to 100 % of the returns that are more than 0.2 m over the
/// ground. Picture and truth stay as they are. Depends on (seed, index) and the frame alone.
void thin_lidar(CompactFrame& frame, const LidarModel& lidar, double share, std::uint64_t seed,
                std::uint64_t index);

}  // namespace mirage
