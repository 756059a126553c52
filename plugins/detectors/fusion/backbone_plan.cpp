#include "backbone_plan.h"

#include "painting.h"
#include "region.h"

namespace mirage::fusion {
namespace {

/// Adds the network's modules to a plan.
struct BackboneBuilder {
  Plan& plan;

  int conv(int from, const ConvNorm& layer) {
    const torch::NoGradGuard guard;
    const torch::Tensor gain = layer->channel_norm->gain();
    return plan.conv(from, layer->conv->weight * gain.view({-1, 1, 1, 1}), layer->channel_norm->shift(),
                     layer->conv->options.stride()->at(0), 1, layer->relu_ ? Curve::relu : Curve::none);
  }
  int residual(int from, const Residual& block) {
    return plan.sum(from, conv(conv(from, block->first), block->second), Curve::relu);
  }
};

}  // namespace

BackbonePlan backbone_plan(NetworkImpl& net, bool bfloat16) {
  BackbonePlan backbone{Plan(bfloat16)};
  Plan& plan = backbone.plan;
  BackboneBuilder add{plan};
  backbone.voxels =
      plan.given(kVoxelsZ + (net.parts.painted ? kPaintedChannels : 0), kVoxelsX, kVoxelsY, false);
  const auto with = [&](std::size_t level, int x) {
    if (!net.parts.image) return x;
    backbone.added[level] = plan.given(plan[x].channels, plan[x].rows, plan[x].columns, true);
    return plan.sum(x, backbone.added[level], Curve::none);
  };
  const int x1 = add.residual(with(0, add.conv(backbone.voxels, net.stem)), net.group1);
  const int x2 = add.residual(add.residual(with(1, add.conv(x1, net.down2)), net.group2a), net.group2b);
  const int x4 = add.residual(add.residual(with(2, add.conv(x2, net.down4)), net.group4a), net.group4b);
  const int x8 = add.residual(with(3, add.conv(x4, net.down8)), net.group8);
  const int up8 = plan.twice(add.conv(x8, net.lateral8), plan[x4].rows);
  const int p4 = plan.sum(add.conv(x4, net.lateral4), up8, Curve::relu);
  const int p2 = plan.sum(add.conv(x2, net.lateral2), plan.twice(p4, plan[x2].rows), Curve::relu);
  const int p1 =
      plan.sum(add.conv(x1, net.lateral1), plan.twice(add.conv(p2, net.reduce), plan[x1].rows), Curve::relu);
  const int smooth = add.conv(p1, net.smooth);
  if (net.parts.second) {
    backbone.bev = smooth;
    plan.keep(smooth);
  }
  backbone.output = plan.conv(smooth, net.head->weight, net.head->bias, 1, 1, Curve::none);
  plan.keep(backbone.output);
  return backbone;
}

}  // namespace mirage::fusion
