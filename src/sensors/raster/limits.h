// Ranges of the soft rasteriser's settings that files and options may ask for.
#pragma once

namespace mirage {

/// NDC². At the largest a face reaches half the picture's longer side, and every pixel sees nearly every
/// face.
inline constexpr double kSmallestSigma = 1e-12, kLargestSigma = 0.1;
/// A share of the depth range; at the largest all faces weigh alike.
inline constexpr double kLargestGamma = 1e3;

}  // namespace mirage
