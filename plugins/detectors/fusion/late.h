// Late fusion: the LiDAR's proposals joined with the camera's boxes (after Pang et al., CLOCs, IROS 2020).
#pragma once

#include "nearest.h"
#include "torch_headers.h"

namespace mirage::fusion {

struct SensorTensors;

struct LateJoinImpl : torch::nn::Module {
  LateJoinImpl();
  /// `output`: kOutputs × 140 × 160 of the backbone. The result has another logit where the backbone's is
  /// above −4 (of the 400 highest): that of a small network which looks at every pair of the proposal and one
  /// of the 200 best picture boxes that overlap it in the picture (IoU, the box's logit, the proposal's
  /// logit, distance), of which the highest counts; a proposal that overlaps none is paired with nothing.
  /// Lower logits stay. The proposal's box in the picture is that of a car's box on the lowest return nearby.
  /// Differentiable in both logits; which pairs there are and their IoU carry no gradient.
  torch::Tensor forward(const torch::Tensor& output, const SensorTensors& input);
  torch::nn::Linear first{nullptr}, second{nullptr}, third{nullptr}, last{nullptr};
};
TORCH_MODULE(LateJoin);

}  // namespace mirage::fusion
