#include "branch_plans.h"

#include "joins.h"
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

using torch::Tensor;
namespace fn = torch::nn::functional;

/// Adds the network's modules to a plan.
struct CameraBuilder {
  Plan& plan;

  int conv(int from, const torch::nn::Conv2d& layer, Curve curve) {
    return plan.conv(from, layer->weight, layer->bias, layer->options.stride()->at(0),
                     layer->options.groups(), curve);
  }
  int silu(int from, const ConvSilu& layer) { return conv(from, layer->conv, Curve::silu); }
  int depthwise(int from, const Depthwise& layer) { return silu(silu(from, layer->each), layer->across); }
  int csp(int from, const Csp& block) {
    int y = silu(from, block->through);
    for (std::size_t i = 0; i < block->narrow.size(); ++i) {
      const int z = depthwise(silu(y, block->narrow[i]), block->wide[i]);
      y = block->shortcut_ ? plan.sum(y, z, Curve::none) : z;
    }
    return silu(plan.join({y, silu(from, block->past)}), block->join);
  }
  int upsample(int from) { return plan.upsample(from, 2 * plan[from].rows); }
  int head(int from, const PictureHead& head) {
    const int start = silu(from, head->stem);
    const int box = depthwise(depthwise(start, head->box1), head->box2);
    const int class_ = depthwise(depthwise(start, head->class1), head->class2);
    return plan.join({conv(box, head->box_out, Curve::none), conv(box, head->object_out, Curve::none),
                      conv(class_, head->class_out, Curve::none)});
  }
};

}  // namespace

BackbonePlan backbone_plan(NetworkImpl& net, bool bfloat16) {
  BackbonePlan backbone{Plan(bfloat16)};
  Plan& plan = backbone.plan;
  BackboneBuilder add{plan};
  backbone.voxels =
      plan.input(kVoxelsZ + (net.parts.painted ? kPaintedChannels : 0), kVoxelsX, kVoxelsY, false);
  const auto with = [&](std::size_t level, int x) {
    if (!net.parts.image) return x;
    backbone.added[level] = plan.input(plan[x].channels, plan[x].rows, plan[x].columns, true);
    return plan.sum(x, backbone.added[level], Curve::none);
  };
  const int x1 = add.residual(with(0, add.conv(backbone.voxels, net.stem)), net.group1);
  const int x2 = add.residual(add.residual(with(1, add.conv(x1, net.down2)), net.group2a), net.group2b);
  const int x4 = add.residual(add.residual(with(2, add.conv(x2, net.down4)), net.group4a), net.group4b);
  const int x8 = add.residual(with(3, add.conv(x4, net.down8)), net.group8);
  const int up8 = plan.upsample(add.conv(x8, net.lateral8), plan[x4].rows);
  const int p4 = plan.sum(add.conv(x4, net.lateral4), up8, Curve::relu);
  const int p2 = plan.sum(add.conv(x2, net.lateral2), plan.upsample(p4, plan[x2].rows), Curve::relu);
  const int p1 = plan.sum(add.conv(x1, net.lateral1), plan.upsample(add.conv(p2, net.reduce), plan[x1].rows),
                          Curve::relu);
  const int smooth = add.conv(p1, net.smooth);
  if (net.parts.second) {
    backbone.bev = smooth;
    plan.keep(smooth);
  }
  backbone.output = plan.conv(smooth, net.head->weight, net.head->bias, 1, 1, Curve::none);
  plan.keep(backbone.output);
  return backbone;
}

CameraPlan camera_plan(CameraNetImpl& net, std::int64_t height, std::int64_t width, bool boxes, bool read,
                       bool bfloat16) {
  CameraPlan camera{Plan(bfloat16)};
  camera.height = height, camera.width = width;
  Plan& plan = camera.plan;
  CameraBuilder add{plan};
  camera.picture_layer = plan.input(12, padded_size(height) / 2, padded_size(width) / 2, false);
  const int x4 = add.csp(add.depthwise(add.silu(camera.picture_layer, net.stem), net.down4), net.group4);
  const int x8 = add.csp(add.depthwise(x4, net.down8), net.group8);
  const int x16 = add.csp(add.depthwise(x8, net.down16), net.group16);
  const int pooled = add.silu(add.depthwise(x16, net.down32), net.pool_in);
  std::vector<int> windows = {pooled};
  for (int k = 0; k < kPoolings; ++k) windows.push_back(plan.max_pool(windows.back(), kPooledSide));
  const int x32 = add.csp(add.silu(plan.join(windows), net.pool_out), net.group32);
  const int l16 = add.silu(x32, net.lateral16);
  const int l8 = add.silu(add.csp(plan.join({add.upsample(l16), x16}), net.top16), net.lateral8);
  const int p8 = add.csp(plan.join({add.upsample(l8), x8}), net.top8);
  camera.features_layer = p8;
  plan.keep(p8);
  const int fine = add.silu(x4, net.mask_fine), coarse = add.upsample(add.silu(p8, net.mask_coarse));
  camera.mask_layer =
      add.conv(add.silu(plan.sum(fine, coarse, Curve::none), net.mask_join), net.mask_out, Curve::none);
  plan.keep(camera.mask_layer);
  if (read) {
    camera.fusion_layer = plan.join({p8, plan.average_pool(camera.mask_layer)});
    plan.keep(camera.fusion_layer);
  }
  if (!boxes) return camera;
  const int p16 = add.csp(plan.join({add.depthwise(p8, net.up16), l8}), net.bottom16);
  const int p32 = add.csp(plan.join({add.depthwise(p16, net.up32), l16}), net.bottom32);
  const std::array<int, 3> scales = {p8, p16, p32};
  for (std::size_t level = 0; level < scales.size(); ++level) {
    camera.row_layers[level] = add.head(scales[level], net.heads[level]);
    plan.keep(camera.row_layers[level]);
  }
  return camera;
}

Tensor focused(const Tensor& picture, const Window& at) {
  const std::int64_t height = picture.size(0), width = picture.size(1);
  const Window map{0, 0, padded_size(height) / 2, padded_size(width) / 2}, inside = intersection(at, map);
  const Window pixels = intersection(doubled(inside), {0, 0, height, width});
  const Tensor part = picture.narrow(0, pixels.top, pixels.rows()).narrow(1, pixels.left, pixels.columns());
  const Tensor x = focus(network_picture(part, 2 * inside.rows(), 2 * inside.columns()));
  return fn::pad(x, fn::PadFuncOptions({inside.left - at.left, at.right - inside.right, inside.top - at.top,
                                        at.bottom - inside.bottom}))
      .contiguous(torch::MemoryFormat::ChannelsLast);
}

Tensor head_rows(const std::array<Tensor, 3>& maps) {
  std::vector<Tensor> rows;
  for (const Tensor& map : maps) rows.push_back(map.flatten(2).squeeze(0).t());
  return torch::cat(rows);
}

}  // namespace mirage::fusion
