// Hosts in frames that nobody has labelled: what the detector finds there without the object.
#pragma once

#include <filesystem>

#include "attack/attack_settings.h"
#include "attack/detector_pool.h"

namespace mirage {

/// Lets the detector look at each unlabelled frame of settings.data, and takes what it finds with a score
/// over that of an evaluation (evaluation.h) for the frame's cars: bird's-eye boxes with bottom and height
/// from the sweep (detection/upright.h), as labels that are neither truncated nor occluded but by the
/// picture's frame. They go to OUT/labelled, a data set (scene/data/layouts.h, open_given_labels) whose
/// folder is returned: what reads it meets these labels. Frames with labels keep theirs. FieldError where
/// every frame has labels, and for a detector of the picture alone, whose boxes stand nowhere; Interrupted
/// between frames.
std::filesystem::path label_by_detections(const AttackSettings& settings, const DetectorPool& detectors);

}  // namespace mirage
