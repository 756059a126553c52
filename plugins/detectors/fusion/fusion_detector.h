// The detector's state: network, optimiser, and the graph of the last forward pass.
// The network lives on the GPU where LibTorch has one (CUDA), otherwise on the CPU; voxels, nearest points
// and the look-up in the picture's features are made on the CPU either way. No GPU was there to test it on.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "detection/detector_abi.h"
#include "network.h"

namespace mirage::fusion {

struct Options {
  Parts parts;  ///< of fresh weights; a starting network has these beside its weights' own
  /// The weights are where a new training starts: the optimiser is fresh, and a detector with a picture may
  /// start from the weights of one without (the image branch then comes from the seed and adds nothing yet).
  bool start = false;
  std::uint64_t seed = 0;
  bool bfloat16 = false;  ///< convolutions of training passes in bfloat16
  int threads = 1;        ///< samples of a training step at once; a forward pass uses one
};

/// Errors leave as std::exception; the C interface turns them into one line.
class FusionDetector {
 public:
  /// `weights`: a file written by save(), or nullptr for fresh weights drawn from the seed.
  FusionDetector(const Options& options, const char* weights);
  bool has_image() const { return options_.parts.image; }
  /// Another one on the same network, for another thread; of the two only one may be trained, alone.
  FusionDetector shared() const { return {options_, network_}; }

  const std::vector<MirageProposal>& forward(const MirageSensorInput& input, float score_threshold,
                                             bool keep_graph);
  void backward(std::span<const float> d_logits, float* d_image, float* d_points);
  /// Total, score and box loss.
  std::array<float, 3> train_step(std::span<const MirageSample> samples, float learning_rate);
  void save(const std::string& file, bool with_optimiser);
  /// What it points to lives until the next call.
  MirageImageFeatures image_features(const MirageSensorInput& input);

 private:
  FusionDetector(const Options& options, Network network);
  void load(const std::string& file);
  void load_network(torch::serialize::InputArchive& archive, const Parts& parts);

  Options options_;
  Network network_{nullptr};
  torch::optim::AdamW optimiser_;
  std::int64_t steps_ = 0, samples_seen_ = 0;

  std::vector<MirageProposal> proposals_;
  std::vector<std::int64_t> proposal_cells_;
  SensorTensors kept_input_;
  std::size_t kept_image_values_ = 0;
  torch::Tensor kept_map_, kept_bev_;  ///< norms of the image features
  torch::Tensor kept_logits_;          ///< undefined unless the last forward kept its graph
};

}  // namespace mirage::fusion
