// What the second stage is taught.
#pragma once

#include <span>

#include "detection/detector_abi3.h"
#include "loss.h"
#include "second_stage.h"

namespace mirage::fusion {

/// Score: cross entropy with a target that rises from 0 at an IoU of 0.3 between the region's new box and the
/// label that its old one overlaps most to 1 at 0.8, so that of a car's proposals the best box comes first
/// (Jiang et al., IoU-Net, ECCV 2018). Box: smooth L1 of the change, in kChangeUnits, where the old box's IoU
/// is 0.5 or more. Both are means over the regions that count; those within an ignored box, and on no label
/// by 0.3, do not.
LossTerms region_loss(const Regions& regions, std::span<const MirageBox> boxes,
                      std::span<const MirageBox> ignored);

}  // namespace mirage::fusion
