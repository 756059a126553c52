// A detector that the user exported from PyTorch. src/guide/attack.md says what it must look like.
#pragma once

#include <torch/script.h>

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "detection/detector_abi3.h"

namespace mirage::torchscript {

/// Throws BadFile for everything that the model does wrong; the C interface turns it into one line.
class TorchScriptDetector {
 public:
  /// Loads the model, checks its signature and runs it once, with gradients, on a made-up scene.
  TorchScriptDetector(const std::string& file, int threads);

  const std::array<float, 4>& region() const { return region_; }
  /// MIRAGE_READS_… | MIRAGE_FINDS_…, by the model's signature.
  std::uint32_t capabilities() const;
  const std::vector<MirageProposal>& forward(const MirageSensorInput& input, float score_threshold,
                                             bool keep_graph);
  void backward(std::span<const float> d_logits, float* d_image, float* d_points);

 private:
  struct Outputs {
    torch::Tensor boxes, logits;  ///< M×5 (in the picture M×4) and M, float32
  };
  Outputs run(const torch::Tensor& projection);
  void check_signature();
  void read_region();
  void probe();

  torch::jit::Module module_;
  int threads_;
  bool picture_ = false;  ///< forward takes the image alone and finds boxes in it
  std::array<float, 4> region_ = {0, 70, -40, 40};
  std::vector<MirageProposal> proposals_;
  std::vector<std::int64_t> places_;  ///< of the proposals among the model's logits
  torch::Tensor image_, points_, logits_;
};

}  // namespace mirage::torchscript
