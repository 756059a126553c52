// A network as a list of layers, so that the same layers can be run over whole maps and over windows of them
// (local_pass.h). On the CPU, with norms folded: nothing in it is learned. In float; in double where the
// network is (a reference for the float passes); with large convolutions in bfloat16 where asked for.
#pragma once

#include <torch/torch.h>

#include <string>
#include <vector>

#include "base/sizes.h"
#include "window.h"

namespace mirage::fusion {

enum class Curve { none, relu, silu };

struct Layer {
  enum class Op {
    input,        ///< an input
    conv,         ///< with bias and curve; beyond its input's border it reads zeros
    sum,          ///< of two maps, and a curve
    join,         ///< channels of several maps behind each other
    upsample,     ///< every place doubled along both axes
    max_pool,     ///< maximum of kernel × kernel places around each
    average_pool  ///< mean of 2 × 2 places
  };
  Op op = Op::input;
  std::vector<int> from;
  std::int64_t channels = 0, rows = 0, columns = 0;
  Reach reach;
  std::int64_t groups = 1;
  Curve curve = Curve::none;
  torch::Tensor weight, bias;
  torch::Tensor turned;  ///< of stride 1: the kernel whose convolution is the derivative in the input
  /// The same in bfloat16, where this convolution runs in it: operands are rounded, products summed in float,
  /// the result is rounded once.
  torch::Tensor weight_bf16, bias_bf16, turned_bf16;
  bool kept = false;  ///< windows of later layers read it beyond the changes: its clean map is kept

  std::int64_t places() const { return rows * columns; }
  Window whole() const { return {0, 0, rows, columns}; }
  /// Floating-point operations a place (of convolutions; 0 for the rest).
  double work() const;
};

/// Every function adds a layer and returns its number. Maps are 1 × channels × rows × columns, channels-last.
class Plan {
 public:
  /// bfloat16: of convolutions over all channels with at least kMinRounded outputs. The few outputs of heads
  /// stay float, and so do convolutions of single channels, which gain nothing.
  explicit Plan(bool bfloat16 = false) : bfloat16_(bfloat16) {}
  static constexpr std::int64_t kMinRounded = 16;
  /// `kept`: run() keeps the map that it is given. An input that is not kept must be given, in a local pass,
  /// with a margin around the changes.
  int input(std::int64_t channels, std::int64_t rows, std::int64_t columns, bool kept);
  /// weight: out × in/groups × k × k, groups 1 or one a channel. Padding (k − 1) / 2 as all of the network's
  /// convolutions have it; an input of odd size counts as padded to a multiple of the stride.
  int conv(int from, const torch::Tensor& weight, const torch::Tensor& bias, std::int64_t stride,
           std::int64_t groups, Curve curve);
  int sum(int a, int b, Curve curve);
  int join(const std::vector<int>& from);
  int upsample(int from, std::int64_t rows);  ///< cut to `rows`
  int max_pool(int from, std::int64_t side);
  int average_pool(int from);
  /// Its clean map is kept.
  void keep(int layer) { layers_[as_size(layer)].kept = true; }

  const std::vector<Layer>& layers() const { return layers_; }
  const Layer& operator[](int layer) const { return layers_[as_size(layer)]; }
  double work() const;                         ///< of a pass over whole maps
  torch::Dtype type() const { return type_; }  ///< of its maps: that of its weights

 private:
  /// A layer whose map is as large as the first of those that it reads.
  Layer reading(Layer::Op op, const std::vector<int>& from) const;
  int add(Layer layer);
  bool bfloat16_;
  torch::Dtype type_ = torch::kFloat;
  std::vector<Layer> layers_;
};

/// The maps of a pass over whole maps that windows need: undefined where a layer is not kept.
struct CleanMaps {
  std::vector<torch::Tensor> maps;
  std::size_t bytes() const;
  const torch::Tensor& operator[](int layer) const { return maps[as_size(layer)]; }
};

/// The plan over whole maps. `input`: by layer number, undefined elsewhere; an input layer without a map is
/// zero.
CleanMaps run(const Plan& plan, const std::vector<torch::Tensor>& input);

/// A layer's convolution, without padding: x covers all inputs of the outputs.
torch::Tensor convolve(const Layer& layer, const torch::Tensor& x);
/// Of a layer of stride 1: the derivative of its convolution in the input, without padding.
torch::Tensor convolve_turned(const Layer& layer, const torch::Tensor& gradient);

}  // namespace mirage::fusion
