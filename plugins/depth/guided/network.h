// A small guided network: picture and classical candidates in, for each pixel a choice among the candidates,
// a free guess, a correction, and whether anything is there at all (sky).
//
// With inverse depths q_k of the candidates, q_free = exp(−f) and w = softmax of the scores,
//     z = exp(r) / Σ_k w_k q_k
// The ground is linear in inverse depth along a column, so weighting the returns above and below is exact
// there. An encoder–decoder without normalisation (crops and whole pictures are then treated alike), strides
// 2 to 16; the candidates carry the full resolution, the network predicts the 2×2 pixels of each of its
// cells.
#pragma once

#include "features.h"

namespace mirage::guided {

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

}  // namespace mirage::guided
