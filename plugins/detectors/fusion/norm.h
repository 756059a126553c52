// Normalisation that is affine at inference: batch norm whose statistics are frozen.
//
// In the first part of a training each sample is normalised by its own statistics (batch norm of one sample),
// which are followed by a running mean; in the last part, and at inference, by that mean, which makes the
// layer a gain and a bias that fold into the convolution before it (Ioffe & Szegedy, ICML 2015, section 3.1;
// freezing them before the end as He et al. do when fine-tuning removes the difference between the two).
#pragma once

#include <vector>

#include "torch_headers.h"

namespace mirage::fusion {

struct ChannelNormImpl : torch::nn::Module {
  explicit ChannelNormImpl(int channels);
  /// Gain and bias of the frozen layer: y = gain · x + shift.
  torch::Tensor gain() const;
  torch::Tensor shift() const;
  torch::Tensor weight, bias;    ///< parameters
  torch::Tensor mean, variance;  ///< buffers
};
TORCH_MODULE(ChannelNorm);

/// While one lives, norms on this thread use the sample's statistics, which it collects.
class SampleStatistics {
 public:
  SampleStatistics();
  SampleStatistics(const SampleStatistics&) = delete;
  SampleStatistics& operator=(const SampleStatistics&) = delete;
  ~SampleStatistics();
  /// Of this thread; nullptr if norms are frozen.
  static SampleStatistics* active();

  struct Seen {
    ChannelNormImpl* norm;
    torch::Tensor mean, variance;
  };
  std::vector<Seen> seen;

 private:
  SampleStatistics* before_;
};

/// The layer in training, with the sample's statistics.
torch::Tensor normalise(ChannelNormImpl& norm, const torch::Tensor& x, SampleStatistics& statistics);
/// Moves the running means towards what a sample showed, the `samples`-th of the training: the plain mean of
/// the first fifty, a mean that forgets from then on.
void follow(const std::vector<SampleStatistics::Seen>& seen, std::int64_t samples);

}  // namespace mirage::fusion
