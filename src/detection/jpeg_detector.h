// JPEG as a defence (Dziugaite et al., 2016): a detector sees the picture compressed and decompressed.
//
// Forward it is plain libjpeg-turbo. Backward it is straight-through: the gradient with respect to the
// compressed picture is taken for that of the picture itself (BPDA; Athalye et al., ICML 2018), because the
// derivative of rounding is zero almost everywhere and would hide the defence from its attacker.
#pragma once

#include <memory>
#include <string>

#include "detection/detector.h"

namespace mirage {

/// A JPEG file of scene-linear RGB: 8-bit sRGB, baseline, 4:2:0 chroma, `quality` 1–100. Failure if the
/// library fails.
std::string encode_jpeg(const ImageF& linear, int quality);

/// Through 8-bit sRGB and baseline JPEG with 4:2:0 chroma at `quality` (1–100), back to scene-linear. Failure
/// if the library fails.
ImageF jpeg_round_trip(const ImageF& linear, int quality);

/// `inner` behind JPEG: its forward, image features and training see the compressed picture.
std::unique_ptr<Detector> behind_jpeg(std::unique_ptr<Detector> inner, int quality);

}  // namespace mirage
