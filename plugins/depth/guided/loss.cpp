#include "loss.h"

namespace mirage::guided {
namespace {

namespace fn = torch::nn::functional;
using torch::Tensor;

constexpr double kHuber = 20, kSquare = 16;       // m, m: squares count e² / kSquare
constexpr double kScored = 85, kFarWeight = 0.2;  // m; what lies beyond counts little
constexpr double kGuessWeight = 0.25;             // where IP-Basic has no value
constexpr double kFarthestTruth = 140;            // m; what the network can say
constexpr double kAbsolute = 0.3, kRelative = 1, kPresenceWeight = 1;

}  // namespace

LossTerms completion_loss(const Prediction& prediction, const Features& features, const Tensor& truth) {
  const Tensor present = truth > 0;
  const Tensor target = torch::where(present, truth, 1.0).clamp_max(kFarthestTruth);
  const Tensor weight = present.to(torch::kFloat) * torch::where(target <= kScored, 1.0, kFarWeight) *
                        torch::where(features.candidates[kPrior] > 0, 1.0, kGuessWeight);
  const Tensor depth = torch::where(present, prediction.depth, 1.0);
  const Tensor huber =
      fn::huber_loss(depth, target, fn::HuberLossFuncOptions().reduction(torch::kNone).delta(kHuber)) *
      (2 / kSquare);
  const Tensor absolute = torch::abs(depth - target);
  const Tensor relative = torch::abs(torch::log(depth) - torch::log(target));
  const Tensor depth_loss =
      ((huber + kAbsolute * absolute + kRelative * relative) * weight).sum() / weight.sum().clamp_min(1);
  const Tensor known = (truth >= 0).to(torch::kFloat);
  const Tensor presence_loss =
      fn::binary_cross_entropy_with_logits(
          prediction.presence, present.to(torch::kFloat),
          fn::BinaryCrossEntropyWithLogitsFuncOptions().weight(known).reduction(torch::kSum)) /
      known.sum().clamp_min(1);
  return {depth_loss + kPresenceWeight * presence_loss, depth_loss.item<double>(),
          presence_loss.item<double>()};
}

}  // namespace mirage::guided
