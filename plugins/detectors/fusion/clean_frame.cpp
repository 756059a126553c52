#include "clean_frame.h"

#include <algorithm>
#include <cmath>

#include "painting.h"
#include "voxels.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

std::span<const float> flat(const Tensor& points) {
  return {points.data_ptr<float>(), static_cast<std::size_t>(points.numel())};
}

/// What continuous fusion adds, and from which points.
void add_fusion(const SensorTensors& input, NetworkImpl& network, CleanFrame& frame,
                std::vector<Tensor>& given) {
  const int width = static_cast<int>(frame.width), height = static_cast<int>(frame.height);
  const auto nearest = nearest_points(flat(frame.points), frame.projection, width, height);
  const Layer& map = frame.camera_plan->plan[frame.camera_plan->read];
  frame.footprints.resize(static_cast<std::size_t>(frame.points.size(0)));
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    auto& of_cell = frame.nearest[level];
    of_cell.assign(static_cast<std::size_t>(kGrids[level].rows * kGrids[level].columns), -1);
    for (std::size_t k = 0; k < nearest[level].cells.size(); ++k) {
      const std::int64_t point = nearest[level].points[k];
      of_cell[static_cast<std::size_t>(nearest[level].cells[k])] = static_cast<std::int32_t>(point);
      Footprint& footprint = frame.footprints[static_cast<std::size_t>(point)];
      if (footprint.bottom >= 0) continue;
      const auto seen = seen_at(frame.points.data_ptr<float>() + 4 * point, frame.projection, width, height);
      if (seen)
        footprint = footprint_of((seen->u + 0.5) / kImageStride - 0.5, (seen->v + 0.5) / kImageStride - 0.5,
                                 map.rows, map.columns);
    }
  }
  const auto added = network.fused(input);
  for (std::size_t level = 0; level < kGrids.size(); ++level)
    given[static_cast<std::size_t>(frame.backbone_plan->added[level])] = added[level];
}

}  // namespace

std::size_t CleanFrame::bytes() const {
  std::size_t all = camera.bytes() + backbone.bytes() + points.nbytes() +
                    footprints.size() * sizeof(Footprint) + (painted.defined() ? painted.nbytes() : 0);
  for (const auto& cells : nearest) all += cells.size() * sizeof(std::int32_t);
  return all;
}

Footprint footprint_of(double column, double row, std::int64_t rows, std::int64_t columns) {
  constexpr double kRounding = 0.01;
  const auto bound = [](double at, std::int64_t size) {
    return static_cast<std::int16_t>(std::clamp<double>(std::floor(at), 0, static_cast<double>(size - 1)));
  };
  return {bound(row - kRounding, rows), bound(column - kRounding, columns), bound(row + kRounding + 1, rows),
          bound(column + kRounding + 1, columns)};
}

const char* CleanFrames::why_whole(const Parts& parts) {
  if (parts.denoising) return "its non-local means join all places of a map";
  if (parts.depth_gate) return "its depth gate compares a return with those around it";
  if (torch::cuda::is_available()) return "it runs on a GPU";
  return "";
}

std::shared_ptr<const CleanFrame> CleanFrames::of(std::uint64_t key,
                                                  const std::function<SensorTensors()>& input) {
  std::unique_lock lock(mutex_);
  ready_.wait(lock, [&] { return !making_.contains(key); });  // another thread is at it
  const auto at = std::find_if(kept_.begin(), kept_.end(), [&](const Kept& k) { return k.first == key; });
  if (at != kept_.end()) {
    kept_.splice(kept_.begin(), kept_, at);
    return at->second;
  }
  making_.insert(key);
  lock.unlock();
  std::shared_ptr<const CleanFrame> frame;
  const auto done = [&] {
    lock.lock();
    making_.erase(key);
    ready_.notify_all();
  };
  try {
    frame = make(input());
  } catch (...) {
    done();
    throw;
  }
  done();
  const std::size_t bytes = frame->bytes();
  if (bytes > most_) return frame;
  while (bytes_ + bytes > most_) {
    bytes_ -= kept_.back().second->bytes();
    kept_.pop_back();
  }
  kept_.emplace_front(key, frame);
  bytes_ += bytes;
  return frame;
}

void CleanFrames::forget() {
  const std::scoped_lock lock(mutex_);
  kept_.clear();
  bytes_ = 0;
  camera_plans_.clear();
  backbone_.reset();
}

std::size_t CleanFrames::bytes() const {
  const std::scoped_lock lock(mutex_);
  return bytes_;
}

std::shared_ptr<const CameraPlan> CleanFrames::camera_plan(std::int64_t height, std::int64_t width) {
  const std::scoped_lock lock(mutex_);
  auto& plan = camera_plans_[{height, width}];
  const Parts& parts = network_->parts;
  if (!plan)
    plan = std::make_shared<const CameraPlan>(fusion::camera_plan(
        *network_->camera, height, width, parts.late || !parts.lidar, parts.lidar && parts.image, bfloat16_));
  return plan;
}

std::shared_ptr<const BackbonePlan> CleanFrames::backbone() {
  const std::scoped_lock lock(mutex_);
  if (!backbone_) backbone_ = std::make_shared<const BackbonePlan>(backbone_plan(*network_, bfloat16_));
  return backbone_;
}

std::shared_ptr<CleanFrame> CleanFrames::make(const SensorTensors& given_input) {
  const torch::NoGradGuard guard;
  const Parts& parts = network_->parts;
  auto frame = std::make_shared<CleanFrame>();
  SensorTensors input = in_type_of(*network_, given_input);
  frame->projection = input.projection;
  frame->points = given_input.points.contiguous();
  if (parts.camera && input.image.defined()) {
    frame->height = input.image.size(0), frame->width = input.image.size(1);
    frame->camera_plan = camera_plan(frame->height, frame->width);
    const CameraPlan& plan = *frame->camera_plan;
    std::vector<Tensor> given(plan.plan.layers().size());
    given[static_cast<std::size_t>(plan.picture)] = focused(input.image, plan.plan[plan.picture].whole());
    frame->camera = run(plan.plan, given);
    input.camera.features = frame->camera[plan.features];
    input.camera.mask = frame->camera[plan.mask];
  }
  if (!parts.lidar) return frame;
  frame->backbone_plan = backbone();
  const BackbonePlan& plan = *frame->backbone_plan;
  std::vector<Tensor> given(plan.plan.layers().size());
  Tensor voxels = soft_voxels(input.points);
  if (parts.painted) {
    frame->painted = painted_voxels(input);
    voxels = torch::cat({voxels, frame->painted}, 1);
  }
  given[static_cast<std::size_t>(plan.voxels)] = voxels;
  if (parts.image && frame->camera_plan) add_fusion(input, *network_, *frame, given);
  frame->backbone = run(plan.plan, given);
  return frame;
}

}  // namespace mirage::fusion
