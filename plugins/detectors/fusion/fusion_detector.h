// The detector's state: network, optimiser, and the graph of the last forward pass.
// The network lives on the GPU where LibTorch has one (CUDA), otherwise on the CPU; voxels, nearest points
// and the look-up in the picture's features are made on the CPU either way. No GPU was there to test it on.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "detection/detector_abi3.h"
#include "local_network.h"
#include "loss.h"
#include "network.h"

namespace mirage::fusion {

/// Precision of convolutions. double_: of the whole network, as a reference for the others.
enum class Precision { float_, bfloat16, double_ };

struct Options {
  Parts parts;  ///< of fresh weights; a starting network has denoising and gate beside its weights' own
  /// The weights are where a new training starts: the optimiser is fresh, and a detector with a picture may
  /// start from the weights of `lidar` (the layers that join them then come from the seed), `refined` from
  /// those of `fusion`, which it leaves as they are. `camera` may also start from a TorchScript YOLOX-nano
  /// (read_coco).
  bool start = false;
  /// Weights of a `camera` and of a `lidar` detector that a new training takes over and leaves as they are:
  /// only the layers that join them learn. Empty: none.
  std::string camera, lidar;
  bool joint = false;  ///< branches taken over learn, too, as do boxes in the picture
  bool heads = false;  ///< of a camera network whose trunk is kept, the heads learn in place of the mask
  /// Share of the start's weights in weights that are saved without their optimiser; the rest are the learned
  /// ones.
  double keep_start = 0;
  std::uint64_t seed = 0;
  /// Of every pass. In bfloat16 operands and results of convolutions are rounded, products are summed in
  /// float, and everything else is float.
  Precision precision = Precision::float_;
  double locality = 0;  ///< m; > 0: passes over a change are truncated (local_network.h)
  int threads = 1;      ///< samples of a training step at once; a forward pass uses one
  std::size_t clean_memory = std::size_t{2048} << 20;  ///< bytes of clean frames kept; 0: passes are whole
};

/// Errors leave as std::exception; the C interface turns them into one line.
class FusionDetector {
 public:
  /// `weights`: a file written by save(), or nullptr for fresh weights drawn from the seed.
  FusionDetector(const Options& options, const char* weights);
  /// Another one on the same network, for another thread; of the two only one may be trained, alone.
  std::unique_ptr<FusionDetector> shared() const {
    return std::unique_ptr<FusionDetector>(new FusionDetector(options_, network_, clean_frames_));
  }
  std::uint32_t capabilities() const;
  bool reads_image() const { return options_.parts.camera || options_.parts.image; }

  const std::vector<MirageProposal>& forward(const MirageSensorInput& input, float score_threshold,
                                             bool keep_graph);
  /// Why forward_changed would be no shorter; empty if it is.
  const char* why_whole() const;
  const std::vector<MirageProposal>& forward_changed(const MirageSensorInput& input,
                                                     const MirageChange& change, float score_threshold,
                                                     bool keep_graph);
  void backward(std::span<const float> d_logits, float* d_image, float* d_points);
  /// Places (count × 4) of possible further returns for the next forward that keeps its graph. presence():
  /// the last backward's gradient in their number, one value a place.
  void watch(const float* places, std::int64_t count);
  std::span<const float> presence() const { return presence_; }
  /// Total, score and box loss.
  std::array<float, 3> train_step(std::span<const MirageSample> samples, float learning_rate);
  void save(const std::string& file, bool with_optimiser);
  /// Its pointers are valid until the next call.
  MirageImageFeatures image_features(const MirageSensorInput& input);

 private:
  FusionDetector(const Options& options, Network network, std::shared_ptr<CleanActivationCache> clean_frames);
  void load(const std::string& file);
  void load_branch(const std::string& file, const std::string& name);
  bool learns(const std::string& parameter) const;
  /// The parameters that learn.
  std::vector<torch::Tensor> learning() const;
  bool camera_learns() const { return options_.parts.camera && !camera_frozen_; }
  bool lidar_learns() const { return options_.parts.lidar && !lidar_frozen_; }
  void start_optimiser();
  CameraOutput cached_camera_output(const SensorTensors& input, std::uint64_t key);
  LossTerms loss_of(const MirageSample& sample, const Targets& targets, std::uint64_t index, double positives,
                    double boxed);
  /// proposal(k): the boxes of the k-th logit.
  void propose(std::span<const float> logits, float score_threshold,
               const std::function<MirageProposal(std::int64_t)>& proposal);
  void propose(const torch::Tensor& output, float score_threshold);
  void propose(const CameraOutput& seen, float score_threshold);
  /// Adds the watched places to an input.
  void take_watched(SensorTensors& input, bool keep_graph);
  void keep_presence(const torch::Tensor& masses, std::int64_t count);
  void backward_changed(const torch::Tensor& d_logits, float* d_image, float* d_points);

  Options options_;
  Network network_{nullptr};
  bool camera_frozen_ = false, lidar_frozen_ = false;  ///< taken over, and left as they are
  /// Of the camera network, which was started from COCO's weights, only the mask's layers learn (or the heads
  /// alone): a few hundred pictures must not replace its knowledge of photographs.
  bool trunk_frozen_ = false;
  std::unique_ptr<torch::optim::AdamW> optimiser_;
  std::vector<torch::Tensor> start_;  ///< of learning(), before the first step; if a share of them is kept
  std::int64_t steps_ = 0, samples_seen_ = 0;
  /// Norms use the samples' statistics until the rate has fallen to a share of its peak (network.h).
  double peak_rate_ = 0;

  std::mutex camera_cache_mutex_;
  std::map<std::uint64_t, CameraOutput> camera_cache_;  ///< of a camera network that does not learn, in half
  std::size_t camera_cache_bytes_ = 0;

  std::vector<MirageProposal> proposals_;
  std::vector<std::int64_t> proposal_cells_;
  SensorTensors forward_input_;
  torch::Tensor watched_;  ///< for the next forward
  std::vector<float> presence_;
  std::size_t kept_image_values_ = 0;
  torch::Tensor kept_map_, kept_bev_;  ///< norms of the image features
  torch::Tensor kept_logits_;          ///< undefined unless the last forward kept its graph
  std::shared_ptr<CleanActivationCache> clean_frames_;
  std::unique_ptr<LocalNetwork> local_;  ///< of the last forward, if it was over a change and kept its graph
};

}  // namespace mirage::fusion
