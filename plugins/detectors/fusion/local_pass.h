// A plan over the windows that a change of its input reaches, given the maps of the unchanged input (Krypton,
// Nakandala et al., SIGMOD 2019, does this forward; the backward pass here is Mirage's own).
//
// Forward: a layer's dirty places are those that read a dirty place of its inputs. They are covered by
// windows, and each is computed from its inputs' windows, with the surroundings taken from the clean maps.
// Nothing is left out: the result is that of the whole pass up to the rounding of sums.
//
// Backward: a gradient lives on a touched part of the windows, which grows from the places where the loss has
// one. Gradients on clean places are dropped, because no change leads there. So the change limits the early
// layers, and the loss the late ones.
#pragma once

#include <functional>

#include "base/sizes.h"
#include "plan.h"

namespace mirage::fusion {

/// The part `part` of x, which covers `at`; a view.
torch::Tensor cut(const torch::Tensor& x, const Window& at, const Window& part);
/// The part `outer` of x, which covers `at`; zeros outside. Channels-last in memory.
torch::Tensor pad_to(const torch::Tensor& x, const Window& at, const Window& outer);

/// A window of a layer's map.
struct Patch {
  Window at;
  torch::Tensor value = {};     ///< 1 × channels × rows × columns, channels-last
  torch::Tensor before = {};    ///< of a conv with SiLU: the curve's input
  torch::Tensor highest = {};   ///< of a pool: where the maxima lie
  ChangedRegion touched = {};   ///< places of the map outside of which `gradient` is zero
  torch::Tensor gradient = {};  ///< over `at`; undefined: none
};

class LocalPass {
 public:
  /// Both must outlive it.
  LocalPass(const Plan& plan, const CleanMaps& clean);

  /// The changes of an input, and value(window), its map there, channels-last. Windows cover `dirty`. For an
  /// input that is not kept they are those that its one reader reads: they may overlap, and go beyond the map
  /// (where it is zero).
  void give(int layer, ChangedRegion dirty, const std::function<torch::Tensor(const Window&)>& value);
  /// Makes the pass an approximation: from here on, changes further than `halo` places from `changed` (both
  /// in an input's map) are ignored. Maps of other sizes count in steps of a power of two.
  void confine(ChangedRegion changed, std::int64_t halo) { near_ = std::move(changed), halo_ = halo; }
  /// The near places of a map of rows × columns. Only after confine().
  ChangedRegion near(std::int64_t rows, std::int64_t columns) const;
  void forward();

  const ChangedRegion& dirty(int layer) const { return nodes_[as_size(layer)].dirty; }
  std::vector<Patch>& patches(int layer) { return nodes_[as_size(layer)].patches; }
  /// The layer's map as it is now. Of a kept layer.
  torch::Tensor whole(int layer) const;
  /// A window of that map, `fill` beyond it. Of a kept layer, or within a patch.
  torch::Tensor window(int layer, const Window& at, float fill = 0) const;

  /// Adds to the gradient of a layer: gradient covers `at`, of which the dirty part counts.
  void add_gradient(int layer, const Window& at, const torch::Tensor& gradient);
  /// The same of a whole map (1 × channels × rows × columns), from the places where it is not zero.
  void add_gradient(int layer, const torch::Tensor& map);
  /// A window of all places of a layer that have a gradient.
  Window touched(int layer) const;
  /// The gradient of a layer over a window; zero where there is none.
  torch::Tensor gradient(int layer, const Window& at) const;
  /// Propagates the added gradients to the inputs.
  void backward();

  /// Floating-point operations of convolutions so far.
  double work() const { return work_; }

 private:
  struct Node {
    ChangedRegion dirty;
    std::vector<Patch> patches;
  };
  ChangedRegion spread(const Layer& layer) const;
  std::vector<Window> needed(int layer, const ChangedRegion& changed) const;
  std::vector<Window> windows(const Layer& layer, const ChangedRegion& dirty) const;
  void compute(const Layer& layer, Patch& patch);
  void back(const Layer& layer, const Patch& patch, const Window& at);
  void conv_vjp(const Layer& layer, const Window& at, const torch::Tensor& gradient);
  void pool_vjp(const Layer& layer, const Patch& patch);

  const Plan& plan_;
  const CleanMaps& clean_;
  std::vector<Node> nodes_;
  ChangedRegion near_;  ///< no rows: everything may change
  std::int64_t halo_ = 0;
  double work_ = 0;
};

}  // namespace mirage::fusion
