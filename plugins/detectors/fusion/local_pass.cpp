#include "local_pass.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <stdexcept>

namespace mirage::fusion {
namespace {

using torch::Tensor;
constexpr auto kNhwc = torch::MemoryFormat::ChannelsLast;

/// The cost of another window, in floating-point operations of a convolution and in places of other layers.
constexpr double kWindowWork = 1.5e6;
constexpr std::int64_t kWindowPlaces = 128;
constexpr std::int64_t kRasterSteps = 40;  // minimum number of a raster's steps across a map

Tensor empty(std::int64_t channels, const Window& at, torch::Dtype type) {
  return torch::empty({1, channels, at.rows(), at.columns()},
                      torch::TensorOptions().dtype(type).memory_format(kNhwc));
}

Tensor zeros(std::int64_t channels, const Window& at, torch::Dtype type) {
  return empty(channels, at, type).zero_();
}

/// Copies the common part of two channels-last maps of one channel count.
void paste(const Tensor& from, const Window& from_at, Tensor& into, const Window& into_at) {
  const Window both = intersection(from_at, into_at);
  if (both.empty()) return;
  const auto place = static_cast<std::int64_t>(into.element_size()) * into.size(1);  // bytes
  const auto* source = static_cast<const std::byte*>(from.data_ptr());
  auto* target = static_cast<std::byte*>(into.data_ptr());
  const auto offset = [&](const Window& at, std::int64_t row) {
    return ((row - at.top) * at.columns() + both.left - at.left) * place;
  };
  for (std::int64_t row = both.top; row < both.bottom; ++row)
    std::memcpy(target + offset(into_at, row), source + offset(from_at, row),
                as_size(both.columns() * place));
}

/// Channels-last whatever its sizes say: a map of one channel or one column is any order.
Tensor in_order(const Tensor& x) {
  const auto c = x.size(1), w = x.size(3);
  if (x.stride(3) == c && x.stride(2) == w * c && x.stride(1) == 1) return x;
  return x.permute({0, 2, 3, 1}).contiguous().permute({0, 3, 1, 2});
}

void add_to(Patch& patch, const Layer& layer, const Window& at, const Tensor& gradient) {
  const Window both = intersection(at, patch.at);
  if (both.empty()) return;
  if (!patch.gradient.defined()) {
    patch.gradient = zeros(layer.channels, patch.at, gradient.scalar_type());
    patch.touched = ChangedRegion(layer.rows, layer.columns);
  }
  cut(patch.gradient, patch.at, both).add_(cut(gradient, at, both));
  patch.touched.add(both);
}

/// Places of a map that are not zero.
ChangedRegion support(const Tensor& map) {
  const Tensor any = map.squeeze(0).ne(0).any(0).contiguous();
  ChangedRegion places(any.size(0), any.size(1));
  const bool* value = any.data_ptr<bool>();
  for (std::int64_t row = 0; row < any.size(0); ++row)
    for (std::int64_t column = 0; column < any.size(1); ++column)
      if (*value++) places.add(row, column);
  return places;
}

Tensor slope(const Layer& layer, const Patch& patch, const Window& at, const Tensor& gradient) {
  switch (layer.curve) {
    case Curve::none:
      return gradient;
    case Curve::relu:
      return at::threshold_backward(gradient, cut(patch.value, patch.at, at), 0);
    case Curve::silu:
      return at::silu_backward(gradient, cut(patch.before, patch.at, at));
  }
  return gradient;
}

/// Windows for the dirty places of a layer: rows together while that costs less than another window.
std::vector<Window> windows_of(const ChangedRegion& dirty, const Layer& layer) {
  const double work = layer.work();
  if (work == 0) return dirty.windows(kWindowPlaces);
  // On a raster: oneDNN compiles a convolution for every size that it meets and keeps a number of them. With
  // windows of any size nearly every one would be compiled anew, for more time than it then runs.
  std::int64_t raster = 1;
  while (2 * raster * kRasterSteps <= layer.columns) raster *= 2;
  std::vector<Window> windows;
  for (Window at : dirty.windows(
           std::clamp(static_cast<std::int64_t>(kWindowWork / work), std::int64_t{16}, kWindowPlaces * 4))) {
    at = {at.top / raster * raster, at.left / raster * raster,
          std::min((at.bottom + raster - 1) / raster * raster, layer.rows),
          std::min((at.right + raster - 1) / raster * raster, layer.columns)};
    if (!windows.empty() && windows.back().bottom > at.top)
      windows.back() = bounds(windows.back(), at);  // they come from top to bottom, and stay disjoint
    else
      windows.push_back(at);
  }
  return windows;
}

}  // namespace

Tensor cut(const Tensor& x, const Window& at, const Window& part) {
  return x.narrow(2, part.top - at.top, part.rows()).narrow(3, part.left - at.left, part.columns());
}

Tensor pad_to(const Tensor& x, const Window& at, const Window& outer) {
  const Window both = intersection(at, outer);
  if (both == outer) return cut(x, at, outer).contiguous(kNhwc);
  Tensor y = zeros(x.size(1), outer, x.scalar_type());
  if (!both.empty()) cut(y, outer, both).copy_(cut(x, at, both));
  return y;
}

LocalPass::LocalPass(const Plan& plan, const CleanMaps& clean)
    : plan_(plan), clean_(clean), nodes_(plan.layers().size()) {
  for (std::size_t i = 0; i < nodes_.size(); ++i)
    nodes_[i].dirty = ChangedRegion(plan.layers()[i].rows, plan.layers()[i].columns);
}

void LocalPass::give(int layer, ChangedRegion dirty, const std::function<Tensor(const Window&)>& value) {
  const Layer& shape = plan_[layer];
  std::vector<Patch> patches;
  for (const Window& at : shape.kept ? windows_of(dirty, shape) : needed(layer, dirty))
    patches.push_back({at, value(at)});
  nodes_[as_size(layer)] = {std::move(dirty), std::move(patches)};
}

ChangedRegion LocalPass::spread(const Layer& layer) const {
  if (layer.op == Layer::Op::upsample) return dirty(layer.from[0]).doubled(layer.rows);
  ChangedRegion all = dirty(layer.from[0]).through(layer.reach, layer.rows, layer.columns);
  for (std::size_t k = 1; k < layer.from.size(); ++k) all.add(dirty(layer.from[k]));
  // The reader of an input that is not kept has exactly the windows requested in give().
  const Layer& first = plan_[layer.from[0]];
  if (near_.rows() > 0 && (first.op != Layer::Op::input || first.kept))
    all.keep(near(layer.rows, layer.columns));
  return all;
}

ChangedRegion LocalPass::near(std::int64_t rows, std::int64_t columns) const {
  const std::int64_t s = std::max<std::int64_t>(1, near_.columns() / columns);
  return near_.through({2 * halo_ + s, s, halo_}, rows, columns);
}

void LocalPass::forward() {
  const torch::NoGradGuard guard;
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    const Layer& layer = plan_.layers()[i];
    if (layer.op == Layer::Op::input) continue;
    Node& node = nodes_[i];
    node.dirty = spread(layer);
    node.patches.clear();
    if (node.dirty.empty()) continue;
    for (const Window& at : windows(layer, node.dirty)) {
      Patch patch{at};
      compute(layer, patch);
      node.patches.push_back(std::move(patch));
    }
  }
}

std::vector<Window> LocalPass::windows(const Layer& layer, const ChangedRegion& dirty) const {
  const bool twice = layer.op == Layer::Op::upsample;
  if (!twice && !(layer.op == Layer::Op::conv && layer.reach.kernel == 1 && layer.reach.stride == 1))
    return windows_of(dirty, layer);
  // Pointwise: in the input's own windows no surroundings are needed, and nothing is kept for them.
  std::vector<Window> same;
  for (const Patch& patch : nodes_[as_size(layer.from[0])].patches) {
    Window at = patch.at;
    if (twice) at = {2 * at.top, 2 * at.left, std::min(2 * at.bottom, layer.rows), 2 * at.right};
    if (!at.empty()) same.push_back(at);
  }
  return same;
}

void LocalPass::compute(const Layer& layer, Patch& patch) {
  const Window& at = patch.at;
  Tensor y;
  switch (layer.op) {
    case Layer::Op::input:
      return;
    case Layer::Op::conv:
      y = in_order(convolve(layer, window(layer.from[0], read_by(at, layer.reach))));
      work_ += layer.work() * static_cast<double>(at.area());
      break;
    case Layer::Op::sum:
      y = window(layer.from[0], at) + window(layer.from[1], at);
      break;
    case Layer::Op::join: {
      std::vector<Tensor> parts;
      for (const int from : layer.from) parts.push_back(window(from, at));
      y = in_order(torch::cat(parts, 1));
      break;
    }
    case Layer::Op::upsample: {
      const Window half = halved(at), grown = doubled(half);
      const Tensor x = window(layer.from[0], half);
      y = pad_to(at::upsample_nearest2d(x, {grown.rows(), grown.columns()}), grown, at);
      break;
    }
    case Layer::Op::max_pool: {
      const Tensor x =
          window(layer.from[0], read_by(at, layer.reach), -std::numeric_limits<float>::infinity());
      std::tie(y, patch.highest) = at::max_pool2d_with_indices(x, layer.reach.kernel, 1);
      break;
    }
    case Layer::Op::average_pool:
      y = torch::avg_pool2d(window(layer.from[0], read_by(at, layer.reach)), 2);
      break;
  }
  y = in_order(y);
  if (layer.curve == Curve::relu) {
    y.relu_();
  } else if (layer.curve == Curve::silu) {
    patch.before = y;
    y = torch::silu(y);
  }
  patch.value = y;
}

Tensor LocalPass::window(int layer, const Window& at, float fill) const {
  const Node& node = nodes_[as_size(layer)];
  for (const Patch& patch : node.patches) {
    if (patch.at == at) return patch.value;
    if (holds(patch.at, at)) return pad_to(patch.value, patch.at, at);
  }
  const Layer& shape = plan_[layer];
  const Tensor& clean = clean_[layer];
  if (!clean.defined()) throw std::logic_error("a window reads what no pass has kept");
  Tensor y = empty(shape.channels, at, plan_.type());
  if (!holds(shape.whole(), at)) y.fill_(fill);
  paste(clean, shape.whole(), y, at);
  for (const Patch& patch : node.patches) paste(patch.value, patch.at, y, at);
  return y;
}

Tensor LocalPass::whole(int layer) const {
  return window(layer, plan_[layer].whole());
}

void LocalPass::add_gradient(int layer, const Window& at, const Tensor& gradient) {
  for (Patch& patch : patches(layer)) add_to(patch, plan_[layer], at, gradient);
}

void LocalPass::add_gradient(int layer, const Tensor& map) {
  for (const Window& at : support(map).windows(kWindowPlaces))
    add_gradient(layer, at, cut(map, plan_[layer].whole(), at));
}

Window LocalPass::touched(int layer) const {
  Window all;
  for (const Patch& patch : nodes_[as_size(layer)].patches)
    for (const Window& at : patch.touched.windows(plan_[layer].places())) all = bounds(all, at);
  return all;
}

Tensor LocalPass::gradient(int layer, const Window& at) const {
  Tensor all = zeros(plan_[layer].channels, at, plan_.type());
  for (const Patch& patch : nodes_[as_size(layer)].patches)
    if (patch.gradient.defined()) paste(patch.gradient, patch.at, all, at);
  return all;
}

std::vector<Window> LocalPass::needed(int layer, const ChangedRegion& changed) const {
  for (const Layer& reader : plan_.layers()) {
    if (std::find(reader.from.begin(), reader.from.end(), layer) == reader.from.end()) continue;
    std::vector<Window> windows =
        windows_of(changed.through(reader.reach, reader.rows, reader.columns), reader);
    for (Window& window : windows) window = read_by(window, reader.reach);
    return windows;
  }
  return {};
}

void LocalPass::backward() {
  const torch::NoGradGuard guard;
  for (std::size_t i = nodes_.size(); i-- > 0;) {
    const Layer& layer = plan_.layers()[i];
    if (layer.op == Layer::Op::input) continue;
    for (const Patch& patch : nodes_[i].patches) {
      if (patch.touched.empty()) continue;
      if (layer.op == Layer::Op::max_pool) {
        pool_vjp(layer, patch);
        continue;
      }
      for (const Window& touched : windows_of(patch.touched, layer))
        back(layer, patch, intersection(touched, patch.at));
    }
  }
}

void LocalPass::back(const Layer& layer, const Patch& patch, const Window& at) {
  const Tensor gradient = slope(layer, patch, at, cut(patch.gradient, patch.at, at));
  switch (layer.op) {
    case Layer::Op::input:
    case Layer::Op::max_pool:
      return;
    case Layer::Op::conv:
      return conv_vjp(layer, at, gradient);
    case Layer::Op::sum:
      for (const int from : layer.from) add_gradient(from, at, gradient);
      return;
    case Layer::Op::join: {
      std::int64_t channel = 0;
      for (const int from : layer.from) {
        const std::int64_t count = plan_[from].channels;
        add_gradient(from, at, gradient.narrow(1, channel, count));
        channel += count;
      }
      return;
    }
    case Layer::Op::upsample: {
      const Window half = halved(at);
      add_gradient(layer.from[0], half, torch::avg_pool2d(pad_to(gradient, at, doubled(half)), 2) * 4);
      return;
    }
    case Layer::Op::average_pool:
      add_gradient(layer.from[0], read_by(at, layer.reach),
                   at::upsample_nearest2d(gradient, {2 * at.rows(), 2 * at.columns()}) / 4);
      return;
  }
}

void LocalPass::conv_vjp(const Layer& layer, const Window& at, const Tensor& gradient) {
  const int from = layer.from[0];
  // By the input's patches: gradients between them are dropped before they are computed.
  for (Patch& before : patches(from)) {
    const Window read = intersection(at, reached_by(before.at, layer.reach, layer.rows, layer.columns));
    if (read.empty()) continue;
    const Window all = read_by(read, layer.reach);
    if (layer.reach.stride == 1) {
      const Window outer = intersection(all, before.at);
      const Window needed{outer.top + layer.reach.padding - layer.reach.kernel + 1,
                          outer.left + layer.reach.padding - layer.reach.kernel + 1,
                          outer.bottom + layer.reach.padding, outer.right + layer.reach.padding};
      const Tensor y = pad_to(gradient, at, needed);
      add_to(before, plan_[from], outer, convolve_turned(layer, y));
      work_ += layer.work() * static_cast<double>(outer.area());
      continue;
    }
    const std::int64_t s = layer.reach.stride;
    const Tensor& weight = layer.weight_bf16.defined() ? layer.weight_bf16 : layer.weight;
    const auto [d_input, d_weight, d_bias] =
        at::convolution_backward(cut(gradient, at, read).contiguous(kNhwc).to(weight.scalar_type()),
                                 empty(plan_[from].channels, all, weight.scalar_type()), weight, {}, {s, s},
                                 {0, 0}, {1, 1}, false, {0, 0}, layer.groups, {true, false, false});
    work_ += layer.work() * static_cast<double>(read.area());
    add_to(before, plan_[from], all, d_input.to(plan_.type()));
  }
}

void LocalPass::pool_vjp(const Layer& layer, const Patch& patch) {
  const Window all = read_by(patch.at, layer.reach);
  const Tensor d_input = at::max_pool2d_with_indices_backward(
      patch.gradient, empty(layer.channels, all, plan_.type()), {layer.reach.kernel, layer.reach.kernel},
      {1, 1}, {0, 0}, {1, 1}, false, patch.highest);
  add_gradient(layer.from[0], all, d_input);
}

}  // namespace mirage::fusion
