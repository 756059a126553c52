#include "plan.h"

#include <stdexcept>

namespace mirage::fusion {
namespace {

using torch::Tensor;
constexpr auto kChannelsLast = torch::MemoryFormat::ChannelsLast;

/// x with zeros around it, so that it covers `wanted` of a map that starts at (0, 0).
Tensor padded(const Tensor& x, const Window& outer) {
  const std::int64_t left = -outer.left, right = outer.right - x.size(3), top = -outer.top,
                     bottom = outer.bottom - x.size(2);
  if (left == 0 && right == 0 && top == 0 && bottom == 0) return x;
  return at::constant_pad_nd(x, {left, right, top, bottom}, 0).contiguous(kChannelsLast);
}

/// Called by name: LibTorch's own choice takes small inputs through a loop over groups. oneDNN has no double.
Tensor convolved(const Tensor& x, const Layer& layer, const Tensor& weight, const Tensor& bias,
                 const Tensor& weight_bf16, const Tensor& bias_bf16, std::int64_t stride,
                 std::int64_t padding) {
  if (x.scalar_type() == torch::kDouble)
    return at::conv2d(x, weight, bias, {stride, stride}, {padding, padding}, {1, 1}, layer.groups);
  if (weight_bf16.defined())
    return at::mkldnn_convolution(x.to(torch::kBFloat16), weight_bf16, bias_bf16, {padding, padding},
                                  {stride, stride}, {1, 1}, layer.groups)
        .to(torch::kFloat);
  return at::mkldnn_convolution(x, weight, bias, {padding, padding}, {stride, stride}, {1, 1}, layer.groups);
}

/// Over the whole map, with zeros around it.
Tensor convolve_whole(const Layer& layer, const Tensor& x) {
  const auto [kernel, stride, padding] = layer.reach;
  const auto own = [&](std::int64_t size) { return (size + 2 * padding - kernel) / stride + 1; };
  if (own(x.size(2)) != layer.rows || own(x.size(3)) != layer.columns)
    return convolve(layer, padded(x, read_by(layer.whole(), layer.reach)));
  return convolved(x, layer, layer.weight, layer.bias, layer.weight_bf16, layer.bias_bf16, stride, padding);
}

Tensor curved(Curve curve, const Tensor& x) {
  return curve == Curve::none ? x : curve == Curve::relu ? torch::relu(x) : torch::silu(x);
}

}  // namespace

double Layer::work() const {
  return op == Op::conv ? 2.0 * static_cast<double>(weight.numel()) : 0;
}

int Plan::add(Layer layer) {
  // Kept: maps that a layer reads beyond a window, and maps that it reads where only another of its maps
  // changed.
  const bool reads_around = layer.reach.kernel > 1 || layer.op == Layer::Op::sum ||
                            layer.op == Layer::Op::join || layer.op == Layer::Op::average_pool;
  for (const int from : layer.from) {
    Layer& before = layers_[as_size(from)];
    if (reads_around && before.op != Layer::Op::input) before.kept = true;
  }
  layers_.push_back(std::move(layer));
  return static_cast<int>(layers_.size()) - 1;
}

int Plan::input(std::int64_t channels, std::int64_t rows, std::int64_t columns, bool kept) {
  Layer layer;
  layer.channels = channels, layer.rows = rows, layer.columns = columns, layer.kept = kept;
  return add(std::move(layer));
}

Layer Plan::reading(Layer::Op op, const std::vector<int>& from) const {
  const Layer& before = (*this)[from.front()];
  Layer layer;
  layer.op = op, layer.from = from;
  layer.channels = before.channels, layer.rows = before.rows, layer.columns = before.columns;
  return layer;
}

int Plan::conv(int from, const Tensor& weight, const Tensor& bias, std::int64_t stride, std::int64_t groups,
               Curve curve) {
  const torch::NoGradGuard guard;
  Layer layer = reading(Layer::Op::conv, {from});
  layer.groups = groups, layer.curve = curve;
  layer.weight = weight.detach().contiguous(kChannelsLast), layer.bias = bias.detach();
  const std::int64_t kernel = weight.size(2);
  layer.reach = {kernel, stride, (kernel - 1) / 2};
  layer.channels = weight.size(0);
  layer.rows = (layer.rows + stride - 1) / stride, layer.columns = (layer.columns + stride - 1) / stride;
  if (stride == 1) {
    if (kernel % 2 == 0) throw std::logic_error("a plan's kernels of stride 1 have odd sizes");
    const Tensor flipped = layer.weight.flip({2, 3});
    layer.turned = (groups == 1 ? flipped.transpose(0, 1) : flipped).contiguous(kChannelsLast);
  }
  type_ = weight.scalar_type();
  if (bfloat16_ && type_ == torch::kFloat && groups == 1 && layer.channels >= kMinRounded) {
    layer.weight_bf16 = layer.weight.to(torch::kBFloat16), layer.bias_bf16 = layer.bias.to(torch::kBFloat16);
    if (stride == 1) layer.turned_bf16 = layer.turned.to(torch::kBFloat16);
  }
  return add(std::move(layer));
}

int Plan::sum(int a, int b, Curve curve) {
  Layer layer = reading(Layer::Op::sum, {a, b});
  layer.curve = curve;
  return add(std::move(layer));
}

int Plan::join(const std::vector<int>& from) {
  Layer layer = reading(Layer::Op::join, from);
  layer.channels = 0;
  for (const int part : from) layer.channels += (*this)[part].channels;
  return add(std::move(layer));
}

int Plan::upsample(int from, std::int64_t rows) {
  Layer layer = reading(Layer::Op::upsample, {from});
  layer.rows = rows, layer.columns *= 2;
  return add(std::move(layer));
}

int Plan::max_pool(int from, std::int64_t side) {
  Layer layer = reading(Layer::Op::max_pool, {from});
  layer.reach = {side, 1, side / 2};
  return add(std::move(layer));
}

int Plan::average_pool(int from) {
  Layer layer = reading(Layer::Op::average_pool, {from});
  layer.rows /= 2, layer.columns /= 2, layer.reach = {2, 2, 0};
  return add(std::move(layer));
}

double Plan::work() const {
  double all = 0;
  for (const Layer& layer : layers_) all += layer.work() * static_cast<double>(layer.places());
  return all;
}

std::size_t CleanMaps::bytes() const {
  std::size_t all = 0;
  for (const Tensor& map : maps)
    if (map.defined()) all += map.nbytes();
  return all;
}

Tensor convolve(const Layer& layer, const Tensor& x) {
  return convolved(x, layer, layer.weight, layer.bias, layer.weight_bf16, layer.bias_bf16, layer.reach.stride,
                   0);
}

Tensor convolve_turned(const Layer& layer, const Tensor& gradient) {
  return convolved(gradient, layer, layer.turned, {}, layer.turned_bf16, {}, 1, 0);
}

CleanMaps run(const Plan& plan, const std::vector<Tensor>& input) {
  const torch::NoGradGuard guard;
  const auto& layers = plan.layers();
  std::vector<int> last_reader(layers.size(), 0);
  for (std::size_t i = 0; i < layers.size(); ++i)
    for (const int from : layers[i].from) last_reader[as_size(from)] = static_cast<int>(i);
  CleanMaps clean;
  std::vector<Tensor>& maps = clean.maps;
  maps.resize(layers.size());
  for (std::size_t i = 0; i < layers.size(); ++i) {
    const Layer& layer = layers[i];
    const auto in = [&](std::size_t k) -> const Tensor& { return maps[as_size(layer.from[k])]; };
    Tensor& y = maps[i];
    switch (layer.op) {
      case Layer::Op::input:
        y = i < input.size() && input[i].defined()
                ? input[i].contiguous(kChannelsLast)
                : torch::zeros({1, layer.channels, layer.rows, layer.columns},
                               torch::TensorOptions().dtype(plan.type()).memory_format(kChannelsLast));
        break;
      case Layer::Op::conv:
        y = curved(layer.curve, convolve_whole(layer, in(0)));
        break;
      case Layer::Op::sum:
        y = curved(layer.curve, in(0) + in(1));
        break;
      case Layer::Op::join: {
        std::vector<Tensor> parts;
        for (std::size_t k = 0; k < layer.from.size(); ++k) parts.push_back(in(k));
        y = torch::cat(parts, 1);
        break;
      }
      case Layer::Op::upsample:
        y = at::upsample_nearest2d(in(0), {2 * in(0).size(2), 2 * in(0).size(3)}).narrow(2, 0, layer.rows);
        break;
      case Layer::Op::max_pool:
        y = torch::max_pool2d(in(0), layer.reach.kernel, 1, layer.reach.padding);
        break;
      case Layer::Op::average_pool:
        y = torch::avg_pool2d(in(0), 2);
        break;
    }
    y = y.contiguous(kChannelsLast);
    for (const int from : layer.from) {
      const auto f = as_size(from);
      if (last_reader[f] == static_cast<int>(i) && !layers[f].kept) maps[f] = Tensor();
    }
    if (last_reader[i] == 0 && !layer.kept) y = Tensor();
  }
  return clean;
}

}  // namespace mirage::fusion
