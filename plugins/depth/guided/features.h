// What the network sees: the picture and classical guesses of the depth, at the picture's resolution.
#pragma once

#include "scene/depth/depth_abi.h"
#include "torch_headers.h"

namespace mirage::guided {

/// Classical candidates for a pixel's depth, among which the network chooses.
enum Candidate { kAbove, kBelow, kPrior, kCandidates };

constexpr int kFeatures = 3 + 2 * kCandidates;  ///< RGB, log depth of each candidate, its distance
constexpr int kStride = 16;                     ///< sides of the network's input are multiples of this

struct Features {
  torch::Tensor values;      ///< 1 × kFeatures × H' × W', padded to multiples of kStride
  torch::Tensor candidates;  ///< kCandidates × H × W inverse depth, 1/m; 0 where there is none
  /// H × W: between two returns of its column that are at most 12 pixels away. Beams lie about 5 apart and
  /// one may be lost: there is something, whatever the picture looks like (windows and wet roads mirror the
  /// sky).
  torch::Tensor enclosed;
};

/// kAbove and kBelow: the nearest return upwards and downwards in the pixel's column (a return fills gaps of
/// two columns to its sides). kPrior: IP-Basic. Distances run from 0 (here) to 1 (none).
Features make_features(const MirageDepthInput& input);

}  // namespace mirage::guided
