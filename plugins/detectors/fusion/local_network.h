// A pass of the network over an object's changes of a frame, forward and backward: the result of the whole
// pass, up to the rounding of sums.
//
// The caller gives the picture's changes; those of the sweep are found (clean_frame.h). From there on windows
// grow through the camera network (branch_plans.h), through the look-up of features by returns, and through
// the backbone (branch_plans.h). Discrete choices (which return feeds a cell, which boxes are joined) are
// made anew.
#pragma once

#include <memory>
#include <optional>
#include <span>

#include "clean_frame.h"

namespace mirage::fusion {

class LocalNetwork {
 public:
  /// input: image H × W × 3 (where the network reads one) and points, float. `changed`: pixels outside are
  /// those of the clean frame. locality > 0: the pass ends that many metres around the changes of the sweep,
  /// and as many at the object's range in the picture; values beyond stay clean (an approximation).
  LocalNetwork(Network network, std::shared_ptr<const CleanFrame> clean, const SensorTensors& input,
               const Window& changed, double locality = 0);
  LocalNetwork(const LocalNetwork&) = delete;
  LocalNetwork& operator=(const LocalNetwork&) = delete;

  /// As NetworkImpl::forward: kOutputs × 140 × 160. Of a network with a backbone.
  torch::Tensor output() const { return output_; }
  /// The camera network's output; boxes and logits where asked for.
  const CameraOutput& seen() const { return seen_; }

  /// Of the picture (0: none) and of the sweep.
  std::pair<std::int64_t, std::int64_t> input_size() const {
    return {input_.image.defined() ? input_.image.size(1) : 0, input_.points.size(0)};
  }
  std::int64_t logit_count() const {
    return output_.defined() ? output_.size(1) * output_.size(2) : seen_.logits.size(0);
  }

  struct Gradient {
    torch::Tensor image;               ///< of the changed pixels; undefined: none
    Window pixels;                     ///< the extent of `image`
    std::vector<std::int64_t> points;  ///< that are not in the clean sweep
    torch::Tensor of_points;           ///< one row each, as long as the points' rows
    torch::Tensor masses;              ///< d loss / d mass of each watched point; undefined: none
  };
  /// d loss / d logit, one a proposal cell or one a picture box → d loss / d changed inputs.
  Gradient backward(const torch::Tensor& d_loss);

  /// Floating-point operations of convolutions so far, and of a whole pass forward.
  double work() const;
  double whole_work() const;

 private:
  double pixels_a_metre() const;
  std::int64_t watched_count() const { return input_.watched.defined() ? input_.watched.size(0) : 0; }
  void confine();
  void compare_inputs();
  void add_features();
  void give_voxels();
  void add_painted(ChangedRegion& dirty) const;
  void join();
  void check_again();
  torch::Tensor second_stage_vjp(const torch::Tensor& d_output, Gradient& gradient);
  void rows_vjp(const torch::Tensor& d_logits);
  void features_vjp(Gradient& gradient);
  void voxels_vjp(Gradient& gradient);
  void masses_vjp(const Window& touched, const torch::Tensor& d_voxels, Gradient& gradient);
  void picture_vjp(Gradient& gradient);
  void add_to_points(Gradient& gradient, std::span<const std::int64_t> points, const torch::Tensor& rows);

  Network network_;
  std::shared_ptr<const CleanFrame> clean_;
  SensorTensors input_;
  SensorTensors
      typed_;  ///< the same in the type of the network's weights; discrete choices are made in float
  Window changed_;
  double locality_;
  bool confined_ = false;  ///< whether the bird's-eye view is
  SweepChange sweep_;
  std::optional<LocalPass> camera_, backbone_;
  std::array<std::vector<ChangedCell>, kGrids.size()> cells_;
  CameraOutput seen_;
  torch::Tensor rows_;         ///< of the heads
  torch::Tensor read_;         ///< the map that fusion reads
  torch::Tensor before_join_;  ///< the backbone's output and the boxes' logits, leaves of joined_
  torch::Tensor logits_before_join_, joined_;
  FirstStage first_;                   ///< the second stage's input
  std::vector<std::int64_t> regions_;  ///< the second stage's cells
  torch::Tensor output_;
};

}  // namespace mirage::fusion
