#include "local_network.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/sizes.h"
#include "joins.h"
#include "region.h"
#include "sampling.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

/// Voxel columns that a window may cover beyond those needed: as costly as another pass over the sweep.
constexpr std::int64_t kApart = 4096;

Window whole_picture(const Tensor& image) {
  return {0, 0, image.size(0), image.size(1)};
}

}  // namespace

LocalNetwork::LocalNetwork(Network network, std::shared_ptr<const CleanFrame> clean,
                           const SensorTensors& input, const Window& changed, double locality)
    : network_(std::move(network)),
      clean_(std::move(clean)),
      input_(input),
      changed_(changed),
      locality_(locality) {
  const torch::NoGradGuard guard;
  typed_ = in_type_of(*network_, input_);
  sweep_ = sweep_change(clean_->points, input_.points);
  if (clean_->camera_plan) compare_inputs();
  if (!clean_->backbone_plan) return;
  backbone_.emplace(clean_->backbone_plan->plan, clean_->backbone);
  if (locality_ > 0) confine();
  if (network_->parts.image && clean_->camera_plan) add_features();
  give_voxels();
  backbone_->forward();
  output_ = backbone_->whole(clean_->backbone_plan->output).squeeze(0);
  if (network_->parts.late && clean_->camera_plan) join();
  if (network_->parts.second && clean_->camera_plan) check_again();
}

double LocalNetwork::pixels_a_metre() const {
  constexpr double kNoReturn = 10;  // m: the range of an object without returns
  const Projection& m = clean_->projection;
  const double mixed = m[0] * m[8] + m[1] * m[9] + m[2] * m[10];
  double focal = 0, depth = 0;
  for (std::size_t c = 0; c < 3; ++c) focal += std::pow(m[c] - mixed * m[8 + c], 2);
  for (const std::int64_t i : sweep_.added) {
    const float* p = input_.points.data_ptr<float>() + 4 * i;
    depth += (m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11]) / static_cast<double>(sweep_.added.size());
  }
  return std::sqrt(focal) / (sweep_.added.empty() ? kNoReturn : std::max(depth, 1.0));
}

void LocalNetwork::confine() {
  ChangedRegion moved(kVoxelsX, kVoxelsY);
  for (const float* point : sweep_.moved) add_voxels_of(point, moved);
  if (moved.empty()) return;  // only the picture changed: no limit in the bird's-eye view
  backbone_->confine(std::move(moved), static_cast<std::int64_t>(std::ceil(locality_ / kVoxel)));
  confined_ = true;
}

void LocalNetwork::compare_inputs() {
  const CameraPlan& plan = *clean_->camera_plan;
  camera_.emplace(plan.plan, clean_->camera);
  const Layer& picture = plan.plan[plan.picture_layer];
  changed_ = intersection(changed_, whole_picture(input_.image));
  ChangedRegion dirty(picture.rows, picture.columns);
  if (!changed_.empty()) dirty.add(halved(changed_));
  if (locality_ > 0)
    camera_->confine(dirty, static_cast<std::int64_t>(std::ceil(locality_ * pixels_a_metre() / 2)));
  camera_->give(plan.picture_layer, std::move(dirty),
                [&](const Window& at) { return focused(typed_.image, at); });
  camera_->forward();
  if (network_->parts.lidar) seen_.mask = camera_->whole(plan.mask_layer);
  if (plan.row_layers[0] < 0) return;
  rows_ = head_rows({camera_->whole(plan.row_layers[0]), camera_->whole(plan.row_layers[1]),
                     camera_->whole(plan.row_layers[2])});
  decode_rows(rows_, plan.height, plan.width, seen_);
}

void LocalNetwork::add_features() {
  const CameraPlan& camera = *clean_->camera_plan;
  cells_ = changed_cells(*clean_, input_.points, sweep_, camera_->dirty(camera.fusion_layer));
  read_ = camera_->whole(camera.fusion_layer);
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    const Grid& grid = kGrids[level];
    const int number = clean_->backbone_plan->added[level];
    if (confined_) {
      const ChangedRegion near = backbone_->near(grid.rows, grid.columns);
      std::erase_if(cells_[level], [&](const ChangedCell& changed) {
        const ChangedRegion::Span& span = near.row(changed.cell / grid.columns);
        const std::int64_t column = changed.cell % grid.columns;
        return column < span.low || column >= span.high;
      });
    }
    std::vector<std::int64_t> cells, points;
    ChangedRegion dirty(grid.rows, grid.columns);
    for (const auto& [cell, point] : cells_[level]) {
      dirty.add(cell / grid.columns, cell % grid.columns);
      if (point >= 0) cells.push_back(cell), points.push_back(point);
    }
    Tensor rows;
    if (!cells.empty()) {
      const Tensor at = typed_.points.narrow(1, 0, 3).index_select(0, torch::tensor(points));
      const Tensor read = features_at(read_, at, input_.projection, kFeatureStride);
      rows =
          network_->fuse[level]->rows(read, at - centres_of(cells, grid).to(at.scalar_type())).contiguous();
    }
    const Layer& layer = clean_->backbone_plan->plan[number];
    const std::size_t bytes = as_size(layer.channels) * as_size(read_.element_size());  // a cell's
    std::vector<const std::byte*> row_of(as_size(grid.rows * grid.columns), nullptr);
    const std::vector<std::byte> nothing(bytes);
    for (const ChangedCell& changed : cells_[level]) row_of[as_size(changed.cell)] = nothing.data();
    for (std::size_t k = 0; k < cells.size(); ++k)
      row_of[as_size(cells[k])] = static_cast<const std::byte*>(rows.data_ptr()) + k * bytes;
    backbone_->give(number, std::move(dirty), [&](const Window& at) {
      const Tensor map = backbone_->window(number, at);
      auto* value = static_cast<std::byte*>(map.data_ptr());
      for (std::int64_t row = at.top; row < at.bottom; ++row)
        for (std::int64_t column = at.left; column < at.right; ++column, value += bytes)
          if (const std::byte* from = row_of[as_size(row * grid.columns + column)])
            std::memcpy(value, from, bytes);
      return map;
    });
  }
}

void LocalNetwork::give_voxels() {
  const BackbonePlan& plan = *clean_->backbone_plan;
  ChangedRegion dirty(kVoxelsX, kVoxelsY);
  for (const float* point : sweep_.moved) add_voxels_of(point, dirty);
  // At watched places the value is unchanged, but the slope is needed.
  for (std::int64_t i = 0; i < watched_count(); ++i)
    add_voxels_of(input_.watched.data_ptr<float>() + 4 * i, dirty);
  Tensor painted;
  if (network_->parts.painted) {
    typed_.camera = seen_;
    painted = painted_voxels(typed_);
    if (camera_) add_painted(dirty);
  }
  if (confined_) dirty.keep(backbone_->near(kVoxelsX, kVoxelsY));
  backbone_->give(plan.voxels, std::move(dirty), [&](const Window& at) {
    Tensor voxels = soft_voxels(typed_.points, at);
    if (painted.defined()) voxels = torch::cat({voxels, pad_to(painted, kGridWindow, at)}, 1);
    return voxels.contiguous(torch::MemoryFormat::ChannelsLast);
  });
}

void LocalNetwork::add_painted(ChangedRegion& dirty) const {
  // By the mask's places that a return reads, not by value: an unchanged value still has a slope.
  const ChangedRegion& mask = camera_->dirty(clean_->camera_plan->mask_layer);
  const auto add_columns = [&](const float* p) {
    const auto row = static_cast<std::int64_t>((p[0] - kXMin) / kVoxel - 0.5),
               column = static_cast<std::int64_t>((p[1] - kYMin) / kVoxel - 0.5);
    dirty.add(Window{row, column, row + 2, column + 2});
  };
  const float* p = input_.points.data_ptr<float>();
  for (std::int64_t i = 0; i < input_.points.size(0); ++i, p += 4) {
    const double x = (p[0] - kXMin) / kVoxel - 0.5, y = (p[1] - kYMin) / kVoxel - 0.5;
    if (!(x > 0 && x < kVoxelsX - 1 && y > 0 && y < kVoxelsY - 1)) continue;
    const auto seen =
        seen_at(p, clean_->projection, static_cast<int>(clean_->width), static_cast<int>(clean_->height));
    if (seen && touches(footprint_of(*seen, kMaskStride, mask.rows(), mask.columns()), mask)) add_columns(p);
  }
  for (const float* point : sweep_.moved) add_columns(point);
  for (std::int64_t i = 0; i < watched_count(); ++i) add_columns(input_.watched.data_ptr<float>() + 4 * i);
}

LocalNetwork::Gradient LocalNetwork::backward(const Tensor& d_loss) {
  const Tensor d_logits = d_loss.to(typed_.points.scalar_type());
  Gradient gradient;
  gradient.points = sweep_.added;
  gradient.of_points =
      torch::zeros({static_cast<std::int64_t>(sweep_.added.size()), 4}, typed_.points.options());
  if (watched_count() > 0) gradient.masses = torch::zeros({watched_count()}, typed_.points.options());
  if (!backbone_) {
    rows_vjp(d_logits);
  } else {
    const Layer& layer = clean_->backbone_plan->plan[clean_->backbone_plan->output];
    Tensor d_output = torch::zeros({1, kOutputs, layer.rows, layer.columns}, output_.options());
    d_output.select(1, kLogit).copy_(d_logits.view({1, layer.rows, layer.columns}));
    if (joined_.defined()) {
      const auto before = torch::autograd::grad({joined_}, {before_join_, logits_before_join_},
                                                {d_output.squeeze(0)}, true, false, true);
      if (before[0].defined()) d_output = before[0].unsqueeze(0);
      if (before[1].defined()) rows_vjp(before[1]);
    }
    if (!regions_.empty()) d_output = second_stage_vjp(d_output.squeeze(0), gradient).unsqueeze(0);
    backbone_->add_gradient(clean_->backbone_plan->output, d_output);
    backbone_->backward();
    voxels_vjp(gradient);
    if (camera_ && network_->parts.image) features_vjp(gradient);
  }
  if (camera_) picture_vjp(gradient);
  return gradient;
}

void LocalNetwork::rows_vjp(const Tensor& d_logits) {
  Tensor d_rows;
  {
    const torch::AutoGradMode on(true);
    const Tensor rows = rows_.narrow(1, 4, 2).detach().requires_grad_(true);
    d_rows = torch::autograd::grad({logit_of_product(rows.select(1, 0), rows.select(1, 1))}, {rows},
                                   {d_logits})[0];
  }
  const torch::NoGradGuard guard;
  std::int64_t from = 0;
  for (const int number : clean_->camera_plan->row_layers) {
    const Layer& layer = clean_->camera_plan->plan[number];
    Tensor map = torch::zeros({1, layer.channels, layer.rows, layer.columns}, d_rows.options());
    map.narrow(1, 4, 2).copy_(
        d_rows.narrow(0, from, layer.places()).t().view({1, 2, layer.rows, layer.columns}));
    from += layer.places();
    camera_->add_gradient(number, map);
  }
}

void LocalNetwork::features_vjp(Gradient& gradient) {
  struct Rows {
    std::vector<std::int64_t> cells, points;
    Tensor gradient;
  };
  std::array<Rows, kGrids.size()> levels;
  std::vector<std::int64_t> all;
  for (std::size_t level = 0; level < kGrids.size(); ++level) {
    const Grid& grid = kGrids[level];
    const int number = clean_->backbone_plan->added[level];
    const Window touched = backbone_->touched(number);
    if (touched.empty()) continue;
    const Tensor map = backbone_->gradient(number, touched);
    const auto channels = map.size(1);
    const Tensor flat = map.permute({0, 2, 3, 1}).reshape({-1, channels});
    const Tensor loud = flat.ne(0).any(1).contiguous();
    Rows& rows = levels[level];
    std::vector<std::int64_t> places;
    for (const auto& [cell, point] : cells_[level]) {
      const std::int64_t row = cell / grid.columns, column = cell % grid.columns;
      if (point < 0 || !holds(touched, {row, column, row + 1, column + 1})) continue;
      const std::int64_t place = (row - touched.top) * touched.columns() + column - touched.left;
      if (!loud.data_ptr<bool>()[place]) continue;
      rows.cells.push_back(cell), rows.points.push_back(point);
      places.push_back(place);
    }
    if (places.empty()) continue;
    rows.gradient = flat.index_select(0, torch::tensor(places));
    all.insert(all.end(), rows.points.begin(), rows.points.end());
  }
  if (all.empty()) return;
  std::vector<Tensor> changed;
  {
    const torch::AutoGradMode on(true);
    const Tensor map = read_.detach().requires_grad_(true);
    const Tensor points =
        typed_.points.narrow(1, 0, 3).index_select(0, torch::tensor(all)).detach().requires_grad_(true);
    const Tensor read = features_at(map, points, input_.projection, kFeatureStride);
    std::vector<Tensor> outputs, gradients;
    std::int64_t from = 0;
    for (std::size_t level = 0; level < kGrids.size(); ++level) {
      const auto count = static_cast<std::int64_t>(levels[level].cells.size());
      if (count == 0) continue;
      outputs.push_back(network_->fuse[level]->rows(
          read.narrow(0, from, count),
          points.narrow(0, from, count) -
              centres_of(levels[level].cells, kGrids[level]).to(points.scalar_type())));
      gradients.push_back(levels[level].gradient);
      from += count;
    }
    changed = torch::autograd::grad(outputs, {map, points}, gradients);
  }
  const torch::NoGradGuard guard;
  add_to_points(gradient, all, changed[1]);
  camera_->add_gradient(clean_->camera_plan->fusion_layer, changed[0]);
}

void LocalNetwork::voxels_vjp(Gradient& gradient) {
  const int number = clean_->backbone_plan->voxels;
  const Window touched = intersection(backbone_->touched(number), kGridWindow);
  if (touched.empty()) return;
  const Tensor d_voxels = backbone_->gradient(number, touched);
  if (!sweep_.added.empty()) {
    ChangedRegion own(kVoxelsX, kVoxelsY);
    for (const std::int64_t i : sweep_.added) add_voxels_of(input_.points.data_ptr<float>() + 4 * i, own);
    Window at;
    for (const Window& window : own.windows(kVoxelsX * kVoxelsY)) at = bounds(at, window);
    at = intersection(at, touched);
    if (!at.empty()) {
      const Tensor added = typed_.points.index_select(0, torch::tensor(sweep_.added));
      add_to_points(gradient, sweep_.added,
                    soft_voxels_vjp(added, at, soft_voxels(typed_.points, at),
                                    cut(d_voxels, touched, at).narrow(1, 0, kVoxelsZ)));
    }
  }
  if (watched_count() > 0) masses_vjp(touched, d_voxels, gradient);
  if (!network_->parts.painted || !camera_) return;
  std::vector<Tensor> changed;
  {
    const torch::AutoGradMode on(true);
    SensorTensors input = typed_;
    input.points = typed_.points.detach().requires_grad_(true);
    input.camera.mask = seen_.mask.detach().requires_grad_(true);
    std::vector<Tensor> leaves = {input.camera.mask, input.points};
    if (watched_count() > 0)
      leaves.push_back(input.masses = torch::zeros_like(typed_.masses).requires_grad_(true));
    const Tensor painted = painted_voxels(input, touched);
    if (!painted.requires_grad()) return;
    changed = torch::autograd::grad({cut(painted, kGridWindow, touched)}, leaves,
                                    {d_voxels.narrow(1, kVoxelsZ, kPaintedChannels)}, {}, false, true);
  }
  const torch::NoGradGuard guard;
  if (changed.size() > 2 && changed[2].defined()) gradient.masses += changed[2];
  if (changed[1].defined() && !sweep_.added.empty())
    add_to_points(gradient, sweep_.added, changed[1].index_select(0, torch::tensor(sweep_.added)));
  if (changed[0].defined()) camera_->add_gradient(clean_->camera_plan->mask_layer, changed[0]);
}

void LocalNetwork::masses_vjp(const Window& touched, const Tensor& d_voxels, Gradient& gradient) {
  ChangedRegion near(kVoxelsX, kVoxelsY);
  for (std::int64_t i = 0; i < watched_count(); ++i)
    add_voxels_of(input_.watched.data_ptr<float>() + 4 * i, near);
  for (const Window& window : near.windows(kApart)) {
    const Window at = intersection(window, touched);
    if (at.empty()) continue;
    gradient.masses += soft_voxels_masses(typed_.watched, at, soft_voxels(typed_.points, at),
                                          cut(d_voxels, touched, at).narrow(1, 0, kVoxelsZ));
  }
}

void LocalNetwork::picture_vjp(Gradient& gradient) {
  camera_->backward();
  if (changed_.empty()) return;
  const int number = clean_->camera_plan->picture_layer;
  const Window focus_at = halved(changed_);
  const Window pixels = intersection(doubled(focus_at), whole_picture(input_.image));
  const Tensor d_focus = camera_->gradient(number, focus_at);
  const torch::AutoGradMode on(true);
  const Tensor picture = typed_.image.narrow(0, pixels.top, pixels.rows())
                             .narrow(1, pixels.left, pixels.columns())
                             .detach()
                             .clone()
                             .requires_grad_(true);
  const Tensor x = focus(network_picture(picture, 2 * focus_at.rows(), 2 * focus_at.columns()));
  gradient.image = torch::autograd::grad({x}, {picture}, {d_focus})[0].contiguous();
  gradient.pixels = pixels;
}

void LocalNetwork::add_to_points(Gradient& gradient, std::span<const std::int64_t> points,
                                 const Tensor& rows) {
  const std::int64_t width = std::min<std::int64_t>(rows.size(1), 4);
  std::vector<std::int64_t> from, into;
  for (std::size_t k = 0; k < points.size(); ++k) {
    const auto at = std::lower_bound(sweep_.added.begin(), sweep_.added.end(), points[k]);
    if (at == sweep_.added.end() || *at != points[k]) continue;  // as recorded
    from.push_back(static_cast<std::int64_t>(k)), into.push_back(at - sweep_.added.begin());
  }
  if (from.empty()) return;
  gradient.of_points.narrow(1, 0, width)
      .index_add_(0, torch::tensor(into), rows.index_select(0, torch::tensor(from)).narrow(1, 0, width));
}

double LocalNetwork::work() const {
  return (camera_ ? camera_->work() : 0) + (backbone_ ? backbone_->work() : 0);
}

double LocalNetwork::whole_work() const {
  return (camera_ ? clean_->camera_plan->plan.work() : 0) +
         (backbone_ ? clean_->backbone_plan->plan.work() : 0);
}

// The stages behind the backbone in a pass over a change: late fusion and the second stage. Both process all
// of their few hundred proposals; their gradients go to the maps that they read.

void LocalNetwork::join() {
  const torch::AutoGradMode on(true);
  before_join_ = output_.detach().requires_grad_(true);
  logits_before_join_ = seen_.logits.detach().requires_grad_(true);
  SensorTensors input = typed_;
  input.camera = seen_;
  input.camera.logits = logits_before_join_;
  joined_ = network_->join(before_join_, input);
  output_ = joined_.detach();
}

void LocalNetwork::check_again() {
  first_ = {output_, backbone_->whole(clean_->backbone_plan->bev), read_, seen_.mask};
  regions_ = SecondStageImpl::chosen(first_);
  output_ = network_->second->refine(first_, typed_, regions_);
}

Tensor LocalNetwork::second_stage_vjp(const Tensor& d_output, Gradient& gradient) {
  // Regions are independent: only those with a gradient are computed again, with a graph.
  const Tensor loud = d_output.ne(0).any(0).reshape({-1}).contiguous();
  std::vector<std::int64_t> cells;
  for (const std::int64_t cell : regions_)
    if (loud.data_ptr<bool>()[cell]) cells.push_back(cell);
  if (cells.empty()) return d_output;
  const torch::AutoGradMode on(true);
  const auto leaf = [](const Tensor& x) { return x.detach().requires_grad_(true); };
  const FirstStage first = {leaf(first_.output), leaf(first_.bev), leaf(first_.picture), leaf(first_.mask)};
  SensorTensors input = typed_;
  input.points = leaf(typed_.points);
  std::vector<Tensor> leaves = {first.output, first.bev, first.picture, first.mask, input.points};
  if (watched_count() > 0) leaves.push_back(input.masses = leaf(typed_.masses));
  const auto before = torch::autograd::grad({network_->second->refine(first, input, cells)}, leaves,
                                            {d_output}, {}, false, true);
  const torch::NoGradGuard guard;
  if (before[1].defined()) backbone_->add_gradient(clean_->backbone_plan->bev, before[1]);
  if (before[2].defined()) camera_->add_gradient(clean_->camera_plan->fusion_layer, before[2]);
  if (before[3].defined()) camera_->add_gradient(clean_->camera_plan->mask_layer, before[3]);
  if (before[4].defined() && !sweep_.added.empty())
    add_to_points(gradient, sweep_.added, before[4].index_select(0, torch::tensor(sweep_.added)));
  if (before.size() > 5 && before[5].defined()) gradient.masses += before[5];
  return before[0];
}

}  // namespace mirage::fusion
