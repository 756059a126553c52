// Thread counts of LibTorch and of the BLAS under it.
#pragma once

#include <ATen/Parallel.h>
#include <torch/nn/utils/clip_grad.h>
#include <torch/optim/optimizer.h>
#include <torch/types.h>
#include <torch/utils.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <exception>
#include <stdexcept>
#include <thread>
#include <vector>

#include "base/sizes.h"

extern "C" {
/// OpenBLAS's function, if that is the BLAS in use; otherwise null.
void openblas_set_num_threads(int) __attribute__((weak));
}

namespace mirage {

/// Sets the count for LibTorch in the calling thread, and for OpenBLAS in the whole process. With one, they
/// work in the caller's thread. More threads spin while they wait, which costs a multiple of the work on a
/// busy machine, and make sums depend on their number.
inline void set_torch_threads(int count) {
  static std::atomic<int> blas = 0;
  at::set_num_threads(count);
  if (openblas_set_num_threads && blas.exchange(count) != count) openblas_set_num_threads(count);
}

// One training sample a thread, in every plugin that trains.

struct SampleResult {
  std::array<float, 3> loss{};
  std::vector<at::Tensor> gradients;
};

/// work(i) for every sample, each on one thread.
template <class Work>
void for_each_sample(std::size_t count, int threads, const Work& work) {
  const std::size_t workers = std::min(count, as_size(std::max(1, threads)));
  std::vector<std::exception_ptr> problems(workers);
  const auto loop = [&](std::size_t first) {
    try {
      set_torch_threads(1);
      torch::AutoGradMode mode(true);
      for (std::size_t i = first; i < count; i += workers) work(i);
    } catch (...) {
      problems[first] = std::current_exception();
    }
  };
  std::vector<std::jthread> others;
  for (std::size_t w = 1; w < workers; ++w) others.emplace_back(loop, w);
  loop(0);
  others.clear();
  for (const auto& problem : problems)
    if (problem) std::rethrow_exception(problem);
}

/// One step by the sum of the samples' gradients over `divisor`. Returns the loss terms, summed alike. An
/// undefined gradient is 0. The sum's norm is at most max_gradient. Summed in the samples' order, so that the
/// number of threads changes nothing. std::runtime_error if the total is not finite.
inline std::array<float, 3> take_step(torch::optim::Optimizer& optimiser,
                                      const std::vector<at::Tensor>& parameters,
                                      const std::vector<SampleResult>& results, float divisor,
                                      double max_gradient, double learning_rate) {
  std::array<float, 3> loss{};
  for (const at::Tensor& parameter : parameters) parameter.mutable_grad() = torch::zeros_like(parameter);
  for (const SampleResult& result : results) {
    for (std::size_t t = 0; t < loss.size(); ++t) loss[t] += result.loss[t] / divisor;
    for (std::size_t k = 0; k < parameters.size(); ++k)
      if (result.gradients[k].defined()) parameters[k].mutable_grad().add_(result.gradients[k], 1 / divisor);
  }
  if (!std::isfinite(loss[0]))
    throw std::runtime_error("the training loss is not finite; lower the learning rate");
  torch::nn::utils::clip_grad_norm_(parameters, max_gradient);
  for (auto& group : optimiser.param_groups()) group.options().set_lr(learning_rate);
  optimiser.step();
  return loss;
}

}  // namespace mirage
