// What a pass of the network turns on for its time: bfloat16, and gradients of the parameters.
#pragma once

#include <ATen/autocast_mode.h>

#include <vector>

#include "torch_headers.h"

namespace mirage::fusion {

/// While one lives, and if asked: this thread's convolutions and linear layers run in bfloat16; everything
/// else, and all weights, stay float.
class Bfloat16 {
 public:
  explicit Bfloat16(bool asked) : asked_(asked) {
    if (!asked_) return;
    at::autocast::set_autocast_cpu_dtype(at::kBFloat16);
    at::autocast::set_cpu_enabled(true);
  }
  Bfloat16(const Bfloat16&) = delete;
  Bfloat16& operator=(const Bfloat16&) = delete;
  ~Bfloat16() {
    if (!asked_) return;
    at::autocast::clear_cache();  // its copies of the weights, which the optimiser is about to change
    at::autocast::set_cpu_enabled(false);
  }

 private:
  bool asked_;
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
