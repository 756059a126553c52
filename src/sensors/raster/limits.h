// Ranges of the soft rasteriser's settings in files and options, and their help texts.
#pragma once

namespace mirage {

/// NDC². At the largest σ a face reaches half the picture's longer side, and every pixel sees nearly every
/// face.
inline constexpr double kMinSigma = 1e-12, kMaxSigma = 0.1;
/// NDC². Edges blend over 1e-6 px: a hard rasteriser, for comparisons with another renderer (1e-12 blends
/// over 2e-3 px, which is visible in a mean); too hard for gradients.
inline constexpr double kHardSigma = 1e-18;
/// A share of the depth range; at the largest γ all faces have equal weight.
inline constexpr double kMaxGamma = 1e3;

/// The help of σ's option.
inline constexpr const char* kSigmaHelp = "soft rasteriser's σ: softness of edges, NDC² of the longer side";
/// The help of γ's option.
inline constexpr const char* kGammaHelp = "soft rasteriser's γ: softness of depth, share of the depth range";

}  // namespace mirage
