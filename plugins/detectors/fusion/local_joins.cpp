// What stands behind the backbone in a pass over a change: late fusion and the second stage. Both look at all
// of their few hundred proposals; their gradients go to the maps that they read.
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
  first_ = {output_, backbone_->whole(clean_->backbone_plan->bev), read_, seen_.mask};
  regions_ = SecondStageImpl::chosen(first_);
  output_ = network_->second->refine(first_, typed_, regions_);
}

Tensor LocalNetwork::back_through_second(const Tensor& d_output, Gradient& gradient) {
  // Each region stands by itself: only those that the loss asks are looked at again, with a graph.
  const Tensor loud = d_output.ne(0).any(0).reshape({-1}).contiguous();
  std::vector<std::int64_t> cells;
  for (const std::int64_t cell : regions_)
    if (loud.data_ptr<bool>()[cell]) cells.push_back(cell);
  if (cells.empty()) return d_output;
  const torch::AutoGradMode on(true);
  const auto leaf = [](const Tensor& x) { return x.detach().requires_grad_(true); };
  const FirstStage first = {leaf(first_.output), leaf(first_.bev), leaf(first_.picture), leaf(first_.mask)};
  SensorTensors input = typed_;
  input.points = leaf(typed_.points);
  std::vector<Tensor> leaves = {first.output, first.bev, first.picture, first.mask, input.points};
  if (watched_count() > 0) leaves.push_back(input.masses = leaf(typed_.masses));
  const auto before = torch::autograd::grad({network_->second->refine(first, input, cells)}, leaves,
                                            {d_output}, {}, false, true);
  const torch::NoGradGuard guard;
  if (before[1].defined()) backbone_->add_gradient(clean_->backbone_plan->bev, before[1]);
  if (before[2].defined()) camera_->add_gradient(clean_->camera_plan->read, before[2]);
  if (before[3].defined()) camera_->add_gradient(clean_->camera_plan->mask, before[3]);
  if (before[4].defined() && !sweep_.fresh.empty())
    add_to_points(gradient, sweep_.fresh, before[4].index_select(0, torch::tensor(sweep_.fresh)));
  if (before.size() > 5 && before[5].defined()) gradient.masses += before[5];
  return before[0];
}

}  // namespace mirage::fusion
