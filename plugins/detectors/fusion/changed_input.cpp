// The detector's passes over an input that is mostly a clean one (local_network.h).
#include <algorithm>
#include <stdexcept>

#include "../../torch_threads.h"
#include "fusion_detector.h"
#include "sensor_input.h"

namespace mirage::fusion {

using torch::Tensor;
const char* FusionDetector::why_whole() const {
  return options_.clean_memory == 0 ? "no memory was given to it for clean frames"
                                    : CleanFrames::why_whole(options_.parts);
}

const std::vector<MirageProposal>& FusionDetector::forward_changed(const MirageSensorInput& input,
                                                                   const MirageChange& change,
                                                                   float score_threshold, bool keep_graph) {
  const bool picture = input.image && input.width > 0 && input.height > 0;
  const bool same_picture =
      !reads_image() ||
      (picture == (change.clean->image != nullptr) &&
       (!picture || (input.width == change.clean->width && input.height == change.clean->height)));
  if (*why_whole() != '\0' || !same_picture || (!options_.parts.lidar && !picture))
    return forward(input, score_threshold, keep_graph);
  kept_logits_ = Tensor();
  local_.reset();
  kept_input_ = {};
  kept_image_values_ = input.image ? std::size_t{3} * input.width * input.height : 0;
  set_torch_threads(1);
  SensorTensors now = view_input(input, reads_image());
  take_watched(now, keep_graph);
  auto local = std::make_unique<LocalNetwork>(
      network_, clean_frames_->of(change.key, [&] { return copy_input(*change.clean, reads_image()); }), now,
      Window{change.top, change.left, change.bottom, change.right}, options_.locality);
  if (options_.parts.lidar)
    propose(local->output(), score_threshold);
  else
    propose(local->seen(), score_threshold);
  if (keep_graph) local_ = std::move(local);
  return proposals_;
}

void FusionDetector::backward_changed(const Tensor& d_logits, float* d_image, float* d_points) {
  const LocalNetwork::Gradient gradient = local_->backward(d_logits);
  const auto [width, points] = local_->input_size();
  if (gradient.masses.defined()) keep_presence(gradient.masses, gradient.masses.size(0));
  if (d_image) std::fill_n(d_image, kept_image_values_, 0.f);
  if (d_image && gradient.image.defined()) {
    const Window& at = gradient.pixels;
    const Tensor image = gradient.image.to(torch::kFloat).contiguous();
    const float* row = image.data_ptr<float>();
    for (std::int64_t v = at.top; v < at.bottom; ++v, row += 3 * at.columns())
      std::copy_n(row, 3 * at.columns(), d_image + 3 * (v * width + at.left));
  }
  if (!d_points) return;
  std::fill_n(d_points, 4 * points, 0.f);
  const Tensor of_points = gradient.of_points.to(torch::kFloat);
  const float* row = of_points.data_ptr<float>();
  for (const std::int64_t point : gradient.points) {
    std::copy_n(row, 4, d_points + 4 * point);
    row += 4;
  }
}

}  // namespace mirage::fusion
