#include "attack/clean_detections.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <set>

#include "attack/evaluation.h"
#include "base/error.h"
#include "base/intervals.h"
#include "base/logging.h"
#include "base/types.h"
#include "detection/audit.h"
#include "detection/detect.h"

namespace mirage {
namespace {

using Undo = std::function<Detection(Detection, const CleanFrame&)>;

/// A possible mistake in a detector's boxes, and the function that undoes it.
struct Mistake {
  std::string name;
  Undo undo;
};

Mistake of_bev(std::string name, std::function<BevBox(BevBox)> undo) {
  return {std::move(name), [undo = std::move(undo)](Detection proposal, const CleanFrame&) {
            proposal.box.bev = undo(proposal.box.bev);
            return proposal;
          }};
}

/// Axis mistakes: x and y swapped or negated, and the heading with them or independently.
void add_axes(std::vector<Mistake>& list) {
  for (const bool exchanged : {false, true})
    for (const int sx : {1, -1})
      for (const int sy : {1, -1})
        for (const int heading : {0, 1, 2}) {
          const bool same = !exchanged && sx == 1 && sy == 1;
          if (same && heading != 2) continue;
          const char* of_heading[] = {"", ", yaw as it is", ", yaw clockwise"};
          list.push_back(of_bev(
              fmt::format("the axes read as x = {}{}, y = {}{}{}", sx < 0 ? "−" : "", exchanged ? "y" : "x",
                          sy < 0 ? "−" : "", exchanged ? "x" : "y", of_heading[heading]),
              [=](BevBox box) {
                double along = std::cos(box.yaw), left = std::sin(box.yaw);
                if (heading == 2) left = -left;
                if (exchanged) std::swap(box.x, box.y);
                box.x *= sx, box.y *= sy;
                if (heading != 1) {
                  if (exchanged) std::swap(along, left);
                  along *= sx, left *= sy;
                }
                box.yaw = std::atan2(left, along);
                return box;
              }));
        }
}

/// `beyond_a_turn`: whether headings exceed ±2π.
std::vector<Mistake> mistakes(Matching matching, bool beyond_a_turn) {
  std::vector<Mistake> list;
  if (matching.in_picture()) {
    list.push_back({"columns and rows exchanged", [](Detection p, const CleanFrame&) {
                      std::swap(p.picture.left, p.picture.top), std::swap(p.picture.right, p.picture.bottom);
                      return p;
                    }});
    list.push_back(
        {"shares of the picture's width and height read as pixels", [](Detection p, const CleanFrame& frame) {
           p.picture.left *= frame.width, p.picture.right *= frame.width;
           p.picture.top *= frame.height, p.picture.bottom *= frame.height;
           return p;
         }});
    return list;
  }
  if (beyond_a_turn) {  // otherwise small headings would turn to 0, the heading of many cars
    list.push_back(of_bev("yaw read as degrees", [](BevBox box) {
      box.yaw *= kDegree;
      return box;
    }));
    list.push_back(of_bev("yaw read as degrees, and length and width exchanged", [](BevBox box) {
      std::swap(box.length, box.width);
      box.yaw *= kDegree;
      return box;
    }));
  }
  list.push_back(of_bev("length and width exchanged (or yaw turned by 90°)", [](BevBox box) {
    std::swap(box.length, box.width);
    return box;
  }));
  list.push_back(of_bev("yaw read as KITTI's rotation_y", [](BevBox box) {
    box.yaw = -box.yaw - std::numbers::pi / 2;
    return box;
  }));
  list.push_back(of_bev("length and width read as halves", [](BevBox box) {
    box.length *= 2, box.width *= 2;
    return box;
  }));
  list.push_back(of_bev("length and width read as logarithms", [](BevBox box) {
    box.length = std::exp(std::min(box.length, 5.0)), box.width = std::exp(std::min(box.width, 5.0));
    return box;
  }));
  add_axes(list);
  return list;
}

int count_found(const std::vector<CleanFrame>& frames, double score, double iou, const Undo& undo = {}) {
  int found = 0;
  for (const CleanFrame& frame : frames)
    for (const HostTruth& host : frame.hosts)
      found += std::ranges::any_of(frame.proposals, [&](const Detection& proposal) {
        return proposal.score() > score && host.host_iou(undo ? undo(proposal, frame) : proposal) > iou;
      });
  return found;
}

/// Offset (x, y) from each host to the nearest box of any score, for hosts whose frame has a box.
std::vector<Vec2d> nearest_offsets(const std::vector<CleanFrame>& frames, Matching matching) {
  std::vector<Vec2d> offsets;
  for (const CleanFrame& frame : frames)
    for (const HostTruth& host : frame.hosts) {
      Vec2d nearest = Vec2d::Constant(std::numeric_limits<double>::infinity());
      for (const Detection& proposal : frame.proposals) {
        const BevBox box = matching.flat(proposal), own = matching.flat(host.host());
        const Vec2d offset(box.x - own.x, box.y - own.y);
        if (offset.norm() < nearest.norm()) nearest = offset;
      }
      if (nearest.allFinite()) offsets.push_back(nearest);
    }
  return offsets;
}

/// Whether all logits lie in [0, 1], with many distinct values, as probabilities do and logits do not.
bool looks_like_probabilities(const std::vector<CleanFrame>& frames) {
  constexpr std::size_t kEnough = 10;
  std::set<double> logits;
  for (const CleanFrame& frame : frames)
    for (const Detection& proposal : frame.proposals) {
      if (proposal.logit < 0 || proposal.logit > 1) return false;
      logits.insert(proposal.logit);
    }
  return logits.size() >= kEnough;
}

/// Adds hints on mistakes in the boxes if too few vehicles are found.
void add_hints(const std::vector<CleanFrame>& frames, Matching matching, CleanPerformance& result) {
  const EvaluationSettings by;
  std::vector<std::string>& hints = result.hints;
  std::size_t boxes = 0, turned = 0, most = 0;
  for (const CleanFrame& frame : frames) {
    boxes += frame.proposals.size();
    most = std::max(most, frame.proposals.size());
    for (const Detection& proposal : frame.proposals)
      turned += std::abs(proposal.box.bev.yaw) > 2 * std::numbers::pi;
  }
  if (boxes == 0) {
    hints.push_back(
        fmt::format("it gives no box with a score over {:g} in any of {} frames: look at its top-k, its "
                    "own threshold and its logits",
                    kScoreThresholdForAp, frames.size()));
    return;
  }
  const bool many_turned = !matching.in_picture() && 10 * turned >= boxes;
  if (many_turned)
    hints.push_back(
        fmt::format("{} of {} headings are beyond ±2π: yaw is in radians, not in degrees", turned, boxes));
  const int few = std::max(result.found, static_cast<int>(kFewFound * result.vehicles));
  const auto add_hint = [&](int found, const std::string& how) {
    if (found > few) hints.push_back(fmt::format("{} of {} would be found {}", found, result.vehicles, how));
  };
  int best = few;
  std::string how;
  for (const Mistake& mistake : mistakes(matching, many_turned))
    if (const int found = count_found(frames, by.score_threshold, by.detected_iou, mistake.undo);
        found > best)
      best = found, how = "with " + mistake.name;
  if (most * frames.size() == boxes && most < 10)
    hints.push_back(
        fmt::format("every frame has {} box{}: is its top-k too small?", most, most == 1 ? "" : "es"));
  if (!how.empty()) return add_hint(best, how);
  add_hint(count_found(frames, kScoreThresholdForAp, by.detected_iou),
           fmt::format("at scores over {:g}: its best score is {:.2f}, and a detection counts from {:g}",
                       kScoreThresholdForAp, result.best_score, by.score_threshold));
  add_hint(count_found(frames, by.score_threshold, 0.5), "at IoU 0.5: its boxes are too loose for IoU 0.7");
  std::vector<double> distances, x, y;
  for (const Vec2d& offset : nearest_offsets(frames, matching)) {
    distances.push_back(offset.norm());
    x.push_back(offset.x()), y.push_back(offset.y());
  }
  const double away = quantile(distances, 0.5), far = matching.in_picture() ? 50 : 5;
  if (away > far) {
    hints.push_back(fmt::format("the box nearest to a vehicle is {:.0f} {} away (median): {}", away,
                                matching.in_picture() ? "pixels" : "m",
                                matching.in_picture()
                                    ? "boxes are left, top, right, bottom in pixels"
                                    : "boxes are in metres in the LiDAR's frame, x forward, y left"));
  } else if (!matching.in_picture()) {
    const Vec2d shift(quantile(x, 0.5), quantile(y, 0.5));
    const Undo moved = [&](Detection p, const CleanFrame&) {
      p.box.bev.x -= shift.x(), p.box.bev.y -= shift.y();
      return p;
    };
    add_hint(count_found(frames, by.score_threshold, by.detected_iou, moved),
             fmt::format("with all boxes moved by x {:+.2f} m, y {:+.2f} m: is their origin the LiDAR?",
                         -shift.x(), -shift.y()));
  }
}

bool any_overlap(std::span<const Detection> proposals, const HostTruth& truth, double iou) {
  return std::ranges::any_of(proposals, [&](const Detection& p) {
    return p.score() > EvaluationSettings().score_threshold && truth.host_iou(p) > iou;
  });
}

CleanPerformance find_plain(const DetectorPool& detectors, FrameStore& store, const std::vector<Host>& hosts,
                            const SimulationSettings& simulation, bool quiet) {
  constexpr std::size_t kPlaces = 48;
  const std::vector<Host> some = spread_evenly(hosts, kPlaces);
  EvaluationSettings by;
  by.matching = detectors.front()->capabilities().matching();
  std::atomic<int> found = 0, boxes = 0;
  Progress progress("look for plain objects", some.size(), quiet);
  for_each_with_detector(detectors, some.size(), [&](Detector& detector, std::size_t i) {
    throw_if_interrupted("nothing was lost: no vehicle had been attacked yet");
    const auto prepared = store.get(some[i].id.frame);
    const Placement placement = store.placement(some[i].id);
    const auto seen = clean_of(detector, *prepared, placement, simulation, by);
    const EvaluationLabels there = labelled_boxes(placement, {}, prepared->frame.calibration, {});
    found += reports(seen, HostTruth::of_object(prepared->frame, *there.plain, by.matching));
    boxes += static_cast<int>(seen.size());
    progress.add();
  });
  CleanPerformance result;
  result.of_objects = true;
  result.found = found, result.boxes = boxes;
  result.vehicles = result.frames = static_cast<int>(some.size());
  return result;
}

}  // namespace

bool finds(std::span<const Detection> proposals, const HostTruth& truth) {
  return any_overlap(proposals, truth, EvaluationSettings().detected_iou);
}

bool reports(std::span<const Detection> proposals, const HostTruth& truth) {
  return any_overlap(proposals, truth, kVanished.iou);
}

std::vector<Detection> CleanDetectionCache::of(const PreparedFrame& prepared, Detector& detector) {
  return scored_over(all_of(prepared, detector), EvaluationSettings().score_threshold);
}

std::vector<Detection> CleanDetectionCache::all_of(const PreparedFrame& prepared, Detector& detector) {
  const Frame& frame = prepared.frame;
  const std::uint64_t version = detector.weights_version();
  {
    const std::scoped_lock lock(mutex_);
    if (version != version_) frames_.clear(), version_ = version;
    if (const auto cached = frames_.find(frame.id); cached != frames_.end()) return cached->second;
  }
  const auto look = [&] {
    EvaluationSettings settings;
    settings.score_threshold = kScoreThresholdForAp;
    return detections(detector, view_of(frame), settings);
  };
  std::vector<Detection> proposals =
      store_ && !identity_.empty() && version == 0
          ? store_->cache().detections(store_->content(frame.id), identity_, kScoreThresholdForAp, look)
          : look();
  const std::scoped_lock lock(mutex_);
  if (version != version_) return proposals;
  return frames_.try_emplace(frame.id, std::move(proposals)).first->second;
}

CleanPerformance clean_performance(const std::vector<CleanFrame>& frames, Matching matching) {
  CleanPerformance result;
  const EvaluationSettings by;
  std::vector<ScoredFrame> scores;
  for (const CleanFrame& frame : frames) {
    result.vehicles += static_cast<int>(frame.hosts.size());
    for (const HostTruth& host : frame.hosts) result.found += finds(frame.proposals, host);
    for (const Detection& proposal : frame.proposals) {
      result.boxes += proposal.score() > by.score_threshold;
      result.best_score = std::max(result.best_score, proposal.score());
    }
    scores.push_back(frame.scored);
  }
  result.frames = static_cast<int>(frames.size());
  result.ap50 = average_precision(scores, 0.5).average_precision;
  result.ap70 = average_precision(scores, 0.7).average_precision;
  if (looks_like_probabilities(frames))
    result.hints.push_back(
        "all its logits lie between 0 and 1, as probabilities do: give logits, log(p / (1 − p))");
  if (result.found < kFewFound * result.vehicles) add_hints(frames, matching, result);
  return result;
}

CleanPerformance measure_clean_performance(const DetectorPool& detectors, FrameStore& store,
                                           const std::vector<Host>& hosts,
                                           const SimulationSettings& simulation,
                                           CleanDetectionCache& clean_cache, bool quiet) {
  if (store.place().victim == Victim::object) return find_plain(detectors, store, hosts, simulation, quiet);
  std::map<std::string, std::vector<HostId>> by_frame;
  for (const Host& host : hosts) by_frame[host.id.frame].push_back(host.id);
  std::vector<std::pair<std::string, std::vector<HostId>>> listed(by_frame.begin(), by_frame.end());
  const Matching matching = detectors.front()->capabilities().matching();
  std::vector<CleanFrame> frames(listed.size());
  Progress progress("look at frames as recorded", listed.size(), quiet);
  for_each_with_detector(detectors, listed.size(), [&](Detector& detector, std::size_t i) {
    throw_if_interrupted("nothing was lost: no vehicle had been attacked yet");
    const auto prepared = store.get(listed[i].first);
    const Frame& frame = prepared->frame;
    CleanFrame& clean = frames[i];
    clean.proposals = clean_cache.all_of(*prepared, detector);
    for (HostId id : listed[i].second) {
      if (store.place().victim == Victim::neighbour) id.label = store.placement(id).neighbour.value();
      clean.hosts.emplace_back(frame, label_of(frame, id), matching);
    }
    clean.scored = scored(clean.proposals, ground_truth(frame, detector.region(), detector.capabilities()),
                          frame.calibration.camera.fy, matching);
    clean.width = frame.image.width, clean.height = frame.image.height;
    progress.add();
  });
  return clean_performance(frames, matching);
}

std::string describe(const CleanPerformance& found) {
  if (found.of_objects)
    return fmt::format("reports a plain object at {} of {} places", found.found, found.vehicles);
  return fmt::format("finds {} of {} vehicles (AP 0.7 {:.1f} %)", found.found, found.vehicles,
                     100 * found.ap70);
}

nlohmann::json to_json(const CleanPerformance& found) {
  return {{"found", found.found}, {"vehicles", found.vehicles}, {"frames", found.frames},
          {"ap50", found.ap50},   {"ap70", found.ap70},         {"hints", found.hints}};
}

void require_detections(const CleanPerformance& found, const Detector& detector) {
  const std::string hints = fmt::format("{}", fmt::join(found.hints, "; "));
  if (found.found == 0 && found.of_objects)
    throw InputError("detector", detector.name(),
                     fmt::format("reports nothing where a plain object stands, at {} places, so none can be "
                                 "hidden from it",
                                 found.vehicles),
                     "use one that sees any thing, as clusters does, or a --place with another victim");
  if (found.found == 0)
    throw InputError(
        "detector", detector.name(),
        fmt::format("finds none of the {} vehicles as recorded (boxes: {}, frames: {}, AP 0.7: {:.1f} %), so "
                    "none can be hidden from it",
                    found.vehicles, found.boxes, found.frames, 100 * found.ap70),
        hints.empty() ? "look at its boxes with mirage detect and mirage view" : hints);
  if (found.found < kFewFound * found.vehicles)
    spdlog::warn("{} {}, fewer than {:.0f} %. Success rates over so few vehicles mean little{}{}",
                 detector.name(), describe(found), 100 * kFewFound, hints.empty() ? "" : ". ", hints);
  else if (!hints.empty())
    spdlog::warn("{} {}, but {}", detector.name(), describe(found), hints);
}

}  // namespace mirage
