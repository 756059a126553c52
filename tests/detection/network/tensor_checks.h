// Shared by the tests of the networks: derivatives by central differences, and a small world of tensors.
#pragma once

#include <torch/torch.h>

#include <functional>
#include <vector>

#include "base/random.h"
#include "network.h"
#include "support/gradient_check.h"

namespace mirage::test {

using fusion::SensorTensors;
using torch::Tensor;

inline std::vector<double> values_of(const Tensor& tensor) {
  const Tensor flat = tensor.detach().to(torch::kDouble).contiguous().view({-1});
  return {flat.data_ptr<double>(), flat.data_ptr<double>() + flat.numel()};
}

inline Tensor tensor_of(const std::vector<double>& values, torch::IntArrayRef shape) {
  return torch::tensor(values, torch::kDouble).view(shape);
}

/// d (Σ weights · f(x)) / dx by autograd against central differences, for components with pick(i).
inline void check(const Tensor& x, const std::function<Tensor(const Tensor&)>& scalar, double step = 1e-6,
                  double tolerance = 1e-6, const std::function<bool(std::size_t)>& pick = {}) {
  const Tensor leaf = x.detach().clone().requires_grad_(true);
  const Tensor gradient = torch::autograd::grad({scalar(leaf)}, {leaf})[0];
  const torch::NoGradGuard guard;
  check_gradient(
      [&](const std::vector<double>& values) { return scalar(tensor_of(values, x.sizes())).item<double>(); },
      values_of(x), values_of(gradient), step, tolerance, 1e-3, pick);
}

/// A few returns and a small picture.
struct Street {
  std::vector<float> points;
  SensorTensors input;
  Street(int width = 80, int height = 48) {
    RandomStream random(4, "street of tensors");
    for (int i = 0; i < 60; ++i)
      for (double value : {random.uniform(6, 60), random.uniform(-8, 8), random.uniform(-1.7, 0.3), 0.2})
        points.push_back(static_cast<float>(value));
    const double f = 40, u = width / 2.0, v = height / 2.0;
    input.projection = {u, -f, 0, 0, v, 0, -f, 0, 1, 0, 0, 0};
    const std::vector<double> exact(points.begin(), points.end());
    input.points = tensor_of(exact, {-1, 4});
    torch::manual_seed(5);
    input.image = torch::rand({height, width, 3}, torch::kDouble);
  }
};

}  // namespace mirage::test
