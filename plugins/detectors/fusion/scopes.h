// Scopes for a pass of the network: bfloat16, and gradients of the parameters.
#pragma once

#include <ATen/autocast_mode.h>
#include <torch/torch.h>
#include <torch/version.h>

#include <vector>

namespace mirage::fusion {

/// While one lives, and if asked: this thread's convolutions and linear layers run in bfloat16; everything
/// else, and all weights, stay float.
class Bfloat16 {
 public:
  explicit Bfloat16(bool enabled) : enabled_(enabled) {
    if (!enabled_) return;
    set_bfloat16(true);
  }
  Bfloat16(const Bfloat16&) = delete;
  Bfloat16& operator=(const Bfloat16&) = delete;
  ~Bfloat16() {
    if (!enabled_) return;
    at::autocast::clear_cache();  // its copies of the weights, which the optimiser is about to change
    set_bfloat16(false);
  }

 private:
  static void set_bfloat16(bool on) {
#if TORCH_VERSION_MAJOR * 100 + TORCH_VERSION_MINOR >= 204
    at::autocast::set_autocast_dtype(at::kCPU, at::kBFloat16);
    at::autocast::set_autocast_enabled(at::kCPU, on);
#else
    at::autocast::set_autocast_cpu_dtype(at::kBFloat16);
    at::autocast::set_cpu_enabled(on);
#endif
  }

  bool enabled_;
};

/// While it lives, the parameters take part in the graph.
class ParameterGradients {
 public:
  explicit ParameterGradients(std::vector<torch::Tensor> parameters) : parameters_(std::move(parameters)) {
    for (torch::Tensor& parameter : parameters_) parameter.requires_grad_(true);
  }
  ParameterGradients(const ParameterGradients&) = delete;
  ParameterGradients& operator=(const ParameterGradients&) = delete;
  ~ParameterGradients() {
    for (torch::Tensor& parameter : parameters_) parameter.requires_grad_(false);
  }

 private:
  std::vector<torch::Tensor> parameters_;
};

}  // namespace mirage::fusion
