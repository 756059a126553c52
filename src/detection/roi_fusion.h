// Region-of-interest fusion: the things that a detector finds, cross-checked with a picture network's boxes.
//
// After Autoware's roi_cluster_fusion: each thing is projected into the first camera's picture, and matched
// with the network's box that it overlaps most, if by enough. In logits, q the network's:
//
//     a Car that has one               logit + max(q, kUnseenLogit)
//     a Car in view that has none      logit + kUnseenLogit
//     another thing that has one       its probability times 1 − sigmoid(q); where the detector calls it no
//                                      car at all, it is also a Car, with min(logit, q): a van, or a car
//                                      beside a hedge
//     a thing out of view              stays as it is
#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "detection/detector.h"

namespace mirage {

/// The logit of a car that a picture network does not see: the network misses an eighth.
inline constexpr double kUnseenLogit = -2;

/// The detector's word for a picture network's weights file: "onnx", "camera" (*.weights) or "torchscript".
std::string picture_network(const std::filesystem::path& weights);

/// `things` finds boxes with heights, Car among their classes; `picture` finds boxes in the picture.
/// FieldError naming weights if it does not. No gradient.
std::unique_ptr<Detector> with_picture(std::unique_ptr<Detector> things, std::unique_ptr<Detector> picture);

}  // namespace mirage
