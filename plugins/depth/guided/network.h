// The network's input: the picture and classical guesses of the depth, at the picture's resolution.
#pragma once

#include <torch/torch.h>

#include "scene/depth/depth_abi.h"

namespace mirage::guided {

/// Classical candidates for a pixel's depth, among which the network chooses.
enum Candidate { kAbove, kBelow, kPrior, kCandidates };

constexpr int kFeatures = 3 + 2 * kCandidates;  ///< RGB, log depth of each candidate, its distance
constexpr int kStride = 16;                     ///< sides of the network's input are multiples of this

struct Features {
  torch::Tensor values;      ///< 1 × kFeatures × H' × W', padded to multiples of kStride
  torch::Tensor candidates;  ///< kCandidates × H × W inverse depth, 1/m; 0 where there is none
  /// H × W: between two returns of its column that are at most 12 pixels away. Beams are about 5 pixels
  /// apart, so at most one is lost there. Such a pixel is on a surface even if its picture looks like sky
  /// (windows and wet roads mirror it).
  torch::Tensor enclosed;
};

/// kAbove and kBelow: the nearest return upwards and downwards in the pixel's column (a return fills gaps of
/// two columns to its sides). kPrior: IP-Basic. Distances run from 0 (here) to 1 (none).
Features make_features(const MirageDepthInput& input);

// A small guided network: picture and classical candidates in, for each pixel a choice among the candidates,
// a free guess, a correction, and whether anything is there at all (sky).
//
// With inverse depths q_k of the candidates, q_free = exp(−f) and w = softmax of the scores,
//     z = exp(r) / Σ_k w_k q_k
// The ground is linear in inverse depth along a column, so weighting the returns above and below is exact
// there. An encoder–decoder without normalisation (crops and whole pictures are then treated alike), strides
// 2 to 16; the candidates carry the full resolution, the network predicts the 2×2 pixels of each of its
// cells.

/// Channels of the output at full resolution.
enum Output {
  kScore,                             ///< one for each candidate
  kFreeScore = kScore + kCandidates,  ///< of the free guess
  kFree,                              ///< f, log depth less its mean
  kCorrection,                        ///< r
  kPresence,                          ///< logit: something is there
  kOutputs
};

struct Prediction {
  torch::Tensor depth;     ///< H × W, m
  torch::Tensor presence;  ///< H × W, logit
};

/// Two convolutions and a skip (He et al., CVPR 2016), no normalisation.
struct ResidualImpl : torch::nn::Module {
  explicit ResidualImpl(int channels);
  torch::Tensor forward(const torch::Tensor& x);
  torch::nn::Conv2d first{nullptr}, second{nullptr};
};
TORCH_MODULE(Residual);

struct NetworkImpl : torch::nn::Module {
  NetworkImpl();
  Prediction forward(const Features& features);

  torch::nn::Conv2d stem{nullptr}, down4{nullptr}, down8{nullptr}, down16{nullptr};
  Residual block2{nullptr}, block4a{nullptr}, block4b{nullptr}, block8a{nullptr}, block8b{nullptr};
  Residual block16a{nullptr}, block16b{nullptr};
  torch::nn::Conv2d lateral16{nullptr}, smooth8{nullptr}, lateral8{nullptr}, smooth4{nullptr};
  torch::nn::Conv2d lateral4{nullptr}, smooth2{nullptr}, head{nullptr};
};
TORCH_MODULE(Network);

// The training loss of a picture.

struct LossTerms {
  torch::Tensor total;
  double depth = 0, presence = 0;
};

/// `truth`: H × W, m; 0 nothing there, negative not known. Depth: a Huber loss in metres (quadratic up to 20
/// m, as in RMSE; linear beyond, where a few wrong edges would dominate), plus the mean absolute and the mean
/// relative error, which keep surfaces exact. Pixels far from any return, where depth is a guess, weigh a
/// quarter. Presence: cross entropy.
LossTerms completion_loss(const Prediction& prediction, const Features& features, const torch::Tensor& truth);

}  // namespace mirage::guided
