// One training sample a thread, in every plugin that trains. Include after the LibTorch headers.
#pragma once

#include <algorithm>
#include <array>
#include <exception>
#include <thread>
#include <vector>

#include "torch_threads.h"

namespace mirage {

struct SampleResult {
  std::array<float, 3> loss{};
  std::vector<at::Tensor> gradients;
};

/// work(i) for every sample, each on one thread.
template <class Work>
void for_each_sample(std::size_t count, int threads, const Work& work) {
  const std::size_t workers = std::min(count, static_cast<std::size_t>(std::max(1, threads)));
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

}  // namespace mirage
