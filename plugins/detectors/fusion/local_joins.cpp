// What stands behind the backbone in a pass over a change: late fusion and the second stage. Both look at a
// few hundred proposals and are computed whole; their gradients go to the maps that they read.
#include "local_network.h"

namespace mirage::fusion {

using torch::Tensor;

void LocalNetwork::join() {
  const torch::AutoGradMode on(true);
  before_join_ = output_.detach().requires_grad_(true);
  logits_before_join_ = seen_.logits.detach().requires_grad_(true);
  SensorTensors input = typed_;
  input.camera = seen_;
  input.camera.logits = logits_before_join_;
  joined_ = network_->join(before_join_, input);
  output_ = joined_.detach();
}

void LocalNetwork::look_again() {
  const torch::AutoGradMode on(true);
  const auto leaf = [](const Tensor& x) { return x.detach().requires_grad_(true); };
  first_ = {leaf(output_), leaf(backbone_->whole(clean_->backbone_plan->bev)), leaf(read_), leaf(seen_.mask)};
  second_input_ = typed_;
  second_input_.points = leaf(typed_.points);
  if (watched_count() > 0) second_input_.masses = leaf(typed_.masses);
  looked_at_ = network_->second(first_, second_input_);
  output_ = looked_at_.detach();
}

Tensor LocalNetwork::back_through_second(const Tensor& d_output, Gradient& gradient) {
  std::vector<Tensor> leaves = {first_.output, first_.bev, first_.picture, first_.mask, second_input_.points};
  if (watched_count() > 0) leaves.push_back(second_input_.masses);
  const auto before = torch::autograd::grad({looked_at_}, leaves, {d_output}, true, false, true);
  if (before[1].defined()) backbone_->add_gradient(clean_->backbone_plan->bev, before[1]);
  if (before[2].defined()) camera_->add_gradient(clean_->camera_plan->read, before[2]);
  if (before[3].defined()) camera_->add_gradient(clean_->camera_plan->mask, before[3]);
  if (before[4].defined() && !sweep_.fresh.empty())
    add_to_points(gradient, sweep_.fresh, before[4].index_select(0, torch::tensor(sweep_.fresh)));
  if (before.size() > 5 && before[5].defined()) gradient.masses += before[5];
  return before[0];
}

}  // namespace mirage::fusion
