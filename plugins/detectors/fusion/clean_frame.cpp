#include "clean_frame.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/sizes.h"
#include "joins.h"
#include "sampling.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

/// Continuous fusion's terms, and the points that they come from.
void add_fusion(const SensorTensors& input, NetworkImpl& network, CleanFrame& frame,
                std::vector<Tensor>& inputs) {
  const int width = static_cast<int>(frame.width), height = static_cast<int>(frame.height);
  const auto nearest = nearest_points({frame.points.data_ptr<float>(), as_size(frame.points.numel())},
                                      frame.projection, width, height);
  const Layer& map = frame.camera_plan->plan[frame.camera_plan->fusion_layer];
  frame.footprints.resize(as_size(frame.points.size(0)));
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    auto& of_cell = frame.nearest[level];
    of_cell.assign(as_size(kGrids[level].rows * kGrids[level].columns), -1);
    for (std::size_t k = 0; k < nearest[level].cells.size(); ++k) {
      const std::int64_t point = nearest[level].points[k];
      of_cell[as_size(nearest[level].cells[k])] = static_cast<std::int32_t>(point);
      Footprint& footprint = frame.footprints[as_size(point)];
      if (footprint.bottom >= 0) continue;
      const auto seen = seen_at(frame.points.data_ptr<float>() + 4 * point, frame.projection, width, height);
      if (seen) footprint = footprint_of(*seen, kFeatureStride, map.rows, map.columns);
    }
  }
  const auto added = network.fused(input);
  for (std::size_t level = 0; level < kGrids.size(); ++level)
    inputs[as_size(frame.backbone_plan->added[level])] = added[level];
}

}  // namespace

std::size_t CleanFrame::bytes() const {
  std::size_t all =
      camera.bytes() + backbone.bytes() + points.nbytes() + footprints.size() * sizeof(Footprint);
  for (const auto& cells : nearest) all += cells.size() * sizeof(std::int32_t);
  return all;
}

Footprint footprint_of(const PixelDepth& pixel, int stride, std::int64_t rows, std::int64_t columns) {
  constexpr double kRounding = 0.01;
  const double column = (pixel.u + 0.5) / stride - 0.5, row = (pixel.v + 0.5) / stride - 0.5;
  const auto bound = [](double at, std::int64_t size) {
    return static_cast<std::int16_t>(std::clamp<double>(std::floor(at), 0, static_cast<double>(size - 1)));
  };
  return {bound(row - kRounding, rows), bound(column - kRounding, columns), bound(row + kRounding + 1, rows),
          bound(column + kRounding + 1, columns)};
}

const char* CleanActivationCache::why_whole(const Parts& parts) {
  if (parts.denoising) return "its non-local means join all places of a map";
  if (parts.depth_gate) return "its depth gate compares a return with those around it";
  if (torch::cuda::is_available()) return "it runs on a GPU";
  return "";
}

std::shared_ptr<const CleanFrame> CleanActivationCache::of(std::uint64_t key,
                                                           const std::function<SensorTensors()>& input) {
  std::unique_lock lock(mutex_);
  ready_.wait(lock, [&] { return !making_.contains(key); });  // another thread makes it
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

void CleanActivationCache::forget() {
  const std::scoped_lock lock(mutex_);
  kept_.clear();
  bytes_ = 0;
  camera_plans_.clear();
  backbone_.reset();
}

std::size_t CleanActivationCache::bytes() const {
  const std::scoped_lock lock(mutex_);
  return bytes_;
}

std::shared_ptr<const CameraPlan> CleanActivationCache::camera_plan(std::int64_t height, std::int64_t width) {
  const std::scoped_lock lock(mutex_);
  auto& plan = camera_plans_[{height, width}];
  const Parts& parts = network_->parts;
  if (!plan)
    plan = std::make_shared<const CameraPlan>(fusion::camera_plan(
        *network_->camera, height, width, parts.late || !parts.lidar, parts.lidar && parts.image, bfloat16_));
  return plan;
}

std::shared_ptr<const BackbonePlan> CleanActivationCache::backbone() {
  const std::scoped_lock lock(mutex_);
  if (!backbone_) backbone_ = std::make_shared<const BackbonePlan>(backbone_plan(*network_, bfloat16_));
  return backbone_;
}

std::shared_ptr<CleanFrame> CleanActivationCache::make(const SensorTensors& given_input) {
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
    std::vector<Tensor> inputs(plan.plan.layers().size());
    inputs[as_size(plan.picture_layer)] = focused(input.image, plan.plan[plan.picture_layer].whole());
    frame->camera = run(plan.plan, inputs);
    input.camera.features = frame->camera[plan.features_layer];
    input.camera.mask = frame->camera[plan.mask_layer];
  }
  if (!parts.lidar) return frame;
  frame->backbone_plan = backbone();
  const BackbonePlan& plan = *frame->backbone_plan;
  std::vector<Tensor> inputs(plan.plan.layers().size());
  Tensor voxels = soft_voxels(input.points);
  if (parts.painted) voxels = torch::cat({voxels, painted_voxels(input)}, 1);
  inputs[as_size(plan.voxels)] = voxels;
  if (parts.image && frame->camera_plan) add_fusion(input, *network_, *frame, inputs);
  frame->backbone = run(plan.plan, inputs);
  return frame;
}

bool touches(const Footprint& footprint, const ChangedRegion& read) {
  for (std::int64_t row = footprint.top; row <= footprint.bottom; ++row) {
    const ChangedRegion::Span& span = read.row(row);
    if (!span.empty() && footprint.left < span.high && footprint.right >= span.low) return true;
  }
  return false;
}

SweepChange sweep_change(const Tensor& clean, const Tensor& points) {
  constexpr std::size_t bytes = 4 * sizeof(float);
  const float *a = clean.data_ptr<float>(), *b = points.data_ptr<float>();
  const std::int64_t from = clean.size(0), to = points.size(0);
  SweepChange change;
  change.now.assign(as_size(from), -1);
  std::int64_t next = 0;  // of the clean sweep: all before it are settled
  for (std::int64_t i = 0; i < to; ++i) {
    std::int64_t at = next;
    while (at < from && std::memcmp(a + 4 * at, b + 4 * i, bytes) != 0) ++at;
    if (at == from) {
      change.added.push_back(i);
      continue;
    }
    for (; next < at; ++next) change.removed.push_back(next);
    change.now[as_size(at)] = i;
    next = at + 1;
  }
  for (; next < from; ++next) change.removed.push_back(next);
  for (const std::int64_t i : change.removed) change.moved.push_back(a + 4 * i);
  for (const std::int64_t i : change.added) change.moved.push_back(b + 4 * i);
  return change;
}

std::array<std::vector<ChangedCell>, kGrids.size()> changed_cells(const CleanFrame& clean,
                                                                  const Tensor& points,
                                                                  const SweepChange& change,
                                                                  const ChangedRegion& read) {
  const int width = static_cast<int>(clean.width), height = static_cast<int>(clean.height);
  const float* now = points.data_ptr<float>();
  std::vector<const float*> moved = change.moved;  // where they matter
  std::erase_if(moved, [&](const float* p) { return !feeds_cells(p, clean.projection, width, height); });
  // Points that may feed a cell near these.
  std::vector<std::int64_t> candidates;
  if (!moved.empty()) {
    const auto order = [](int axis) {
      return [axis](const float* p, const float* q) { return p[axis] < q[axis]; };
    };
    const auto [x0, x1] = std::minmax_element(moved.begin(), moved.end(), order(0));
    const auto [y0, y1] = std::minmax_element(moved.begin(), moved.end(), order(1));
    double far = 0;  // a cell within a point's reach has its own points within the same reach
    for (const Grid& grid : kGrids) far = std::max(far, 2 * grid.reach + grid.cell);
    for (std::int64_t i = 0; i < points.size(0); ++i) {
      const float* p = now + 4 * i;
      if (p[0] >= (*x0)[0] - far && p[0] <= (*x1)[0] + far && p[1] >= (*y0)[1] - far &&
          p[1] <= (*y1)[1] + far && feeds_cells(p, clean.projection, width, height))
        candidates.push_back(i);
    }
  }
  std::array<std::vector<ChangedCell>, kGrids.size()> changed;
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    const Grid& grid = kGrids[level];
    ChangedRegion reached(grid.rows, grid.columns);
    for (const float* p : moved) reached.add(cells_reached(grid, p[0], p[1]));
    std::vector<std::uint8_t> settled(clean.nearest[level].size(), 0);
    for (const Window& cells : reached.windows(256)) {
      const auto best = nearest_in(grid, {now, as_size(points.numel())}, candidates, cells);
      std::size_t k = 0;
      for (std::int64_t row = cells.top; row < cells.bottom; ++row)
        for (std::int64_t column = cells.left; column < cells.right; ++column, ++k) {
          const std::int64_t cell = row * grid.columns + column;
          if (row >= reached.rows() || column < reached.row(row).low || column >= reached.row(row).high)
            continue;  // not all of its points are candidates
          const std::int32_t was = clean.nearest[level][as_size(cell)];
          const std::int64_t same = was < 0 ? -1 : change.now[as_size(was)];
          if (best[k] == same && !(was >= 0 && same < 0)) continue;
          settled[as_size(cell)] = 1;
          changed[level].push_back({cell, best[k]});
        }
    }
    if (read.empty()) continue;
    for (std::size_t cell = 0; cell < settled.size(); ++cell) {
      const std::int32_t point = clean.nearest[level][cell];
      if (settled[cell] || point < 0 || !touches(clean.footprints[as_size(point)], read)) continue;
      changed[level].push_back({static_cast<std::int64_t>(cell), change.now[as_size(point)]});
    }
  }
  return changed;
}

}  // namespace mirage::fusion
