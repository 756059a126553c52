// The training loss of a picture.
#pragma once

#include "network.h"

namespace mirage::guided {

struct LossTerms {
  torch::Tensor total;
  double depth = 0, presence = 0;
};

/// `truth`: H × W, m; 0 nothing there, negative not known. Depth: a Huber loss in metres (squares up to 20 m,
/// which is what RMSE asks for; slopes beyond, where a few wrong edges would rule), plus the mean absolute
/// and the mean relative error, which keep surfaces exact. Pixels far from any return, where depth is a
/// guess, weigh a quarter. Presence: cross entropy.
LossTerms completion_loss(const Prediction& prediction, const Features& features, const torch::Tensor& truth);

}  // namespace mirage::guided
