// The back-end's state: network and optimiser.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>

#include "network.h"

namespace mirage::guided {

struct Options {
  std::uint64_t seed = 0;
  int threads = 1;  ///< samples of a training step at once; completing one picture uses one
};

/// Errors leave as std::exception; the C interface turns them into one line.
class GuidedCompletion {
 public:
  /// `weights`: a file written by save(), or nullptr for fresh weights drawn from the seed.
  GuidedCompletion(const Options& options, const char* weights);

  void complete(const MirageDepthInput& input, float* dense);
  /// Total, depth and presence loss.
  std::array<float, 3> train_step(std::span<const MirageDepthSample> samples, float learning_rate);
  /// Without the optimiser, weights are kept in half precision.
  void save(const std::string& file, bool with_optimiser);

 private:
  void load(const std::string& file);

  Options options_;
  Network network_{nullptr};
  torch::optim::AdamW optimiser_;
};

}  // namespace mirage::guided
