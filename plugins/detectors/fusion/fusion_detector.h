// The detector's state: network, optimiser, and the graph of the last forward pass.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "detection/detector_abi.h"
#include "network.h"

namespace mirage::fusion {

struct Options {
  bool with_image = true;
  std::uint64_t seed = 0;
  int threads = 1;  ///< samples of a training step at once; a forward pass uses one
};

/// Errors leave as std::exception; the C interface turns them into one line.
class FusionDetector {
 public:
  /// `weights`: a file written by save(), or nullptr for fresh weights drawn from the seed.
  FusionDetector(const Options& options, const char* weights);

  const std::vector<MirageProposal>& forward(const MirageSensorInput& input, float score_threshold,
                                             bool keep_graph);
  void backward(std::span<const float> d_logits, float* d_image, float* d_points);
  /// Total, score and box loss.
  std::array<float, 3> train_step(std::span<const MirageSample> samples, float learning_rate);
  void save(const std::string& file, bool with_optimiser);

 private:
  void load(const std::string& file);
  void require_parameter_gradients(bool required);

  Options options_;
  Network network_{nullptr};
  torch::optim::AdamW optimiser_;
  std::int64_t steps_ = 0, samples_seen_ = 0;

  std::vector<MirageProposal> proposals_;
  std::vector<std::int64_t> proposal_cells_;
  SensorTensors kept_input_;
  std::size_t kept_image_values_ = 0;
  torch::Tensor kept_logits_;  ///< undefined unless the last forward kept its graph
};

}  // namespace mirage::fusion
