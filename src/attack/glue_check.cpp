#include "attack/glue_check.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "attack/attack_step.h"
#include "attack/evaluation.h"
#include "base/error.h"
#include "base/intervals.h"
#include "base/sizes.h"

namespace mirage {
namespace {

constexpr double kNear = 3;     // m
constexpr double kStep = 0.01;  // m

double median(std::vector<double> values) {
  return values.empty() ? 0 : quantile(std::move(values), 0.5);
}

}  // namespace

BoxHabits box_habits(const std::vector<CleanFrame>& frames) {
  std::vector<double> length, label_length, width, label_width, along, across, yaw, logit, other;
  for (const CleanFrame& frame : frames) {
    std::vector<bool> taken(frame.proposals.size());
    for (const HostTruth& host : frame.hosts) {
      const BevBox& label = host.host().box.bev;
      // Detections are sorted by falling score.
      const auto found = std::ranges::find_if(
          frame.proposals, [&](const Detection& p) { return horizontal_distance(p.box.bev, label) < kNear; });
      if (found == frame.proposals.end()) continue;
      taken[as_size(found - frame.proposals.begin())] = true;
      const BevBox& box = found->box.bev;
      length.push_back(box.length), label_length.push_back(label.length);
      width.push_back(box.width), label_width.push_back(label.width);
      const double dx = box.x - label.x, dy = box.y - label.y, c = std::cos(label.yaw),
                   s = std::sin(label.yaw);
      along.push_back(c * dx + s * dy), across.push_back(c * dy - s * dx);
      yaw.push_back(std::abs(std::remainder(box.yaw - label.yaw, std::numbers::pi)));
      logit.push_back(found->logit);
    }
    for (std::size_t i = 0; i < taken.size(); ++i)
      if (!taken[i]) other.push_back(frame.proposals[i].logit);
  }
  BoxHabits habits;
  habits.vehicles = static_cast<int>(logit.size());
  habits.others = static_cast<int>(other.size());
  habits.length = median(length), habits.label_length = median(label_length);
  habits.width = median(width), habits.label_width = median(label_width);
  habits.along = median(along), habits.across = median(across), habits.yaw = median(yaw);
  habits.logit = median(logit), habits.other_logit = median(other);
  return habits;
}

SeenChange seen_change(Detector& detector, FrameStore& store, const std::vector<std::string>& frames,
                       int vehicles) {
  const AttackSettings settings;
  TexturedMesh object = initial_adversary(settings.limits);
  CleanDetectionCache clean_cache;
  SeenChange seen;
  if (!detector.capabilities().has_gradients) return seen;
  double products = 0, squared = 0, predicted_squared = 0;
  for (const std::string& frame : frames) {
    for (const Host& host :
         find_hosts(store, frame, detector.region(), settings.simulation, settings.min_view)) {
      if (seen.vehicles == vehicles) break;
      throw_if_interrupted("no result was written");
      const auto prepared = store.get(frame);
      const std::vector<Detection> clean = clean_cache.of(*prepared, detector);
      const StepHost carried{*prepared, host.id, store.placement(host.id), clean};
      const HostStep here = attack_host(detector, carried, object, settings);
      if (!here.found) continue;
      ++seen.vehicles;
      for (const int axis : {0, 1}) {
        double predicted = 0, measured = 0;
        for (const Vec3d& gradient : here.gradient.vertices) predicted += 2 * kStep * gradient[axis];
        for (const int side : {1, -1}) {
          TexturedMesh moved = object;
          for (Vec3d& vertex : moved.mesh.vertices) vertex[axis] += side * kStep;
          const HostStep there = attack_host(detector, carried, moved, settings, false);
          measured += side * (there.hide + there.false_positive);
        }
        products += predicted * measured, squared += measured * measured;
        predicted_squared += predicted * predicted;
        seen.largest = std::max(seen.largest, std::abs(measured));
      }
    }
    if (seen.vehicles == vehicles) break;
  }
  if (squared > 0) seen.share = products / squared;
  if (squared * predicted_squared > 0) seen.cosine = products / std::sqrt(squared * predicted_squared);
  return seen;
}

std::vector<std::pair<std::string, std::string>> rows_of(const CleanPerformance& found,
                                                         const BoxHabits& habits, const SeenChange& seen) {
  std::vector<std::pair<std::string, std::string>> rows = {
      {"found", fmt::format("{} of {} vehicles, AP 0.5 {:.1f} %, AP 0.7 {:.1f} %", found.found,
                            found.vehicles, 100 * found.ap50, 100 * found.ap70)}};
  if (habits.vehicles > 0) {
    constexpr double degree = 180 / std::numbers::pi;
    rows.push_back(
        {"boxes (median)", fmt::format("{:.2f} × {:.2f} m where labels have {:.2f} × {:.2f} m, {:+.2f} m "
                                       "ahead and {:+.2f} m left of them, turned by {:.1f}° ({} vehicles)",
                                       habits.length, habits.width, habits.label_length, habits.label_width,
                                       habits.along, habits.across, degree * habits.yaw, habits.vehicles)});
    rows.push_back({"logits (median)", fmt::format("{:.2f} for boxes at vehicles, {:.2f} for the {} others",
                                                   habits.logit, habits.other_logit, habits.others)});
  }
  if (seen.vehicles > 0)
    rows.push_back(
        {"gradient", fmt::format("predicts {:.2f} of the loss change when the object moves by 1 cm (1: "
                                 "all; cosine {:.2f}; {} vehicles; largest change {:.2g})",
                                 seen.share, seen.cosine, seen.vehicles, seen.largest)});
  else
    rows.push_back(
        {"gradient", "not checked: the detector gives none, or finds no vehicle that can carry an object"});
  for (const std::string& hint : found.hints) rows.push_back({"looks wrong", hint});
  return rows;
}

}  // namespace mirage
