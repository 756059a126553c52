#include "detection/reliance.h"

#include <fmt/format.h>

#include <algorithm>
#include <climits>
#include <cmath>
#include <limits>
#include <map>
#include <mutex>

#include "base/error.h"
#include "base/image_io.h"
#include "base/interrupt.h"
#include "base/parallel.h"
#include "detection/detect.h"
#include "detection/points_in_view.h"
#include "scene/data/read_frames.h"

namespace mirage {

/// One frame under all of its pictures.
struct RelianceMeter::Looks {
  /// Under one of them.
  struct Sight {
    ScoredFrame scored;
    std::vector<Proposal> cars;  ///< of each labelled car: the proposal that speaks for it
  };
  Sight right, swapped, black;
  std::optional<Sight> none;
};

namespace {

using Sight = RelianceMeter::Looks::Sight;

namespace fs = std::filesystem;

constexpr double kSameCar = 0.1;  // IoU

/// `proposals`: over kFaintScore.
Sight sight_of(const std::vector<Proposal>& proposals, const GroundTruth& truth, double focal_length,
               Plane plane) {
  Sight result;
  result.scored =
      scored(suppress(scored_over(proposals, kScoreThresholdForAp), plane), truth, focal_length, plane);
  for (const BevBox& car : result.scored.truth.boxes) result.cars.push_back(speaker(proposals, car, plane));
  return result;
}

Sight look(Detector& detector, const SensorView& view, const GroundTruth& truth) {
  return sight_of(detector.forward(view, kFaintScore, false), truth, view.calibration->camera.fy,
                  detector.capabilities().plane());
}

/// Null if the detector needs a picture.
std::optional<Sight> look_without(Detector& detector, SensorView view, const GroundTruth& truth) {
  view.image = nullptr;
  try {
    return look(detector, view, truth);
  } catch (const Failure&) {
  } catch (const InputError&) {
  }
  return std::nullopt;
}

Reliance summarize(std::span<const std::unique_ptr<RelianceMeter::Looks>> looks) {
  Reliance result;
  std::vector<ScoredFrame> right, swapped, black, none;
  ClusteredShare delta_logit;
  for (const auto& sights : looks) {
    if (!sights) continue;  // was not looked at
    ++result.frames;
    right.push_back(sights->right.scored);
    swapped.push_back(sights->swapped.scored);
    black.push_back(sights->black.scored);
    if (sights->none) none.push_back(sights->none->scored);
    for (std::size_t i = 0; i < sights->right.cars.size(); ++i) {
      const Proposal &seen = sights->right.cars[i], &misled = sights->swapped.cars[i];
      result.mean_delta_logit += std::abs(seen.logit - misled.logit);
      const std::vector<int>& tracks = sights->right.scored.truth.tracks;
      delta_logit.add(cluster_of(std::to_string(result.frames), tracks.empty() ? -1 : tracks[i]),
                      std::abs(seen.logit - misled.logit));
      result.mean_delta_score += std::abs(seen.score() - misled.score());
      ++result.vehicles;
    }
  }
  result.mean_delta_logit /= std::max(1, result.vehicles);
  result.mean_delta_score /= std::max(1, result.vehicles);
  result.delta_logit_high = delta_logit.mean_interval().high;
  constexpr double kIou = 0.7;
  const auto ap = [&](const std::vector<ScoredFrame>& frames) {
    return average_precision(frames, kIou).average_precision;
  };
  result.ap70 = ap(right);
  result.ap70_swapped = ap(swapped);
  result.ap70_black = ap(black);
  if (!none.empty() && none.size() == right.size()) result.ap70_none = ap(none);
  result.drop = average_precision_difference(right, swapped, kIou);
  result.clusters = clusters_of(right);
  return result;
}

}  // namespace

Proposal speaker(std::span<const Proposal> proposals, const BevBox& car, Plane plane) {
  Proposal best{{}, std::log(kFaintScore / (1 - kFaintScore))};
  for (const Proposal& proposal : proposals) {
    if (proposal.logit <= best.logit) continue;
    const BevBox box = rectangle(proposal, plane);
    const double reach = std::hypot(car.length, car.width) + std::hypot(box.length, box.width);
    if (2 * std::hypot(box.x - car.x, box.y - car.y) < reach && iou(box, car) >= kSameCar) best = proposal;
  }
  return best;
}

bool reads_picture(const Detector& detector) {
  return detector.capabilities().reads_image;
}

Reliance no_camera() {
  Reliance blind;
  blind.reads_picture = false;
  return blind;
}

std::vector<PicturePair> pair_pictures(const fs::path& data, const std::vector<std::string>& ids) {
  std::map<std::pair<int, int>, std::vector<std::string>> of_size;
  std::map<std::string, std::pair<int, int>> size_of;
  const auto set = open_data_set(data);
  for (const std::string& id : ids) {
    size_of[id] = set->picture_size(id);
    of_size[size_of[id]].push_back(id);
  }
  std::map<std::string, std::string> others;
  for (const auto& [size, members] : of_size)
    for (std::size_t i = 0; i < members.size() && members.size() > 1; ++i)
      others[members[i]] = members[(i + members.size() / 2) % members.size()];
  std::vector<PicturePair> pairs;
  for (const std::string& id : ids)
    if (const auto other = others.find(id); other != others.end()) pairs.push_back({id, other->second});
  return pairs;
}

RelianceMeter::RelianceMeter(fs::path data, const std::vector<std::string>& ids)
    : data_(std::move(data)), pairs_(pair_pictures(data_, ids)), frames_(ids.size()), looks_(pairs_.size()) {}

RelianceMeter::~RelianceMeter() = default;

void RelianceMeter::look(Detector& detector, const Frame& frame, std::span<const LidarPoint> points,
                         const std::vector<Proposal>& right) {
  const auto pair = std::find_if(pairs_.begin(), pairs_.end(),
                                 [&](const PicturePair& candidate) { return candidate.frame == frame.id; });
  if (pair == pairs_.end()) return;
  const ImageF other = read_srgb(picture_file(data_, pair->other)),
               black(frame.image.width, frame.image.height, 3);
  const GroundTruth truth = ground_truth(frame, detector.region());
  const auto with = [&](const ImageF* image) { return SensorView{image, points, &frame.calibration}; };
  looks_[static_cast<std::size_t>(pair - pairs_.begin())] = std::make_unique<Looks>(
      Looks{sight_of(right, truth, frame.calibration.camera.fy, detector.capabilities().plane()),
            mirage::look(detector, with(&other), truth), mirage::look(detector, with(&black), truth),
            look_without(detector, with(nullptr), truth)});
}

Reliance RelianceMeter::result() const {
  Reliance result = summarize(looks_);
  result.left_out = static_cast<int>(frames_ - pairs_.size());
  return result;
}

Reliance measure_reliance(std::span<Detector* const> detectors, const fs::path& data,
                          const std::vector<std::string>& ids,
                          const std::function<void(std::size_t, std::size_t)>& progress) {
  if (!reads_picture(*detectors.front())) return no_camera();
  RelianceMeter meter(data, ids);
  const std::vector<PicturePair>& pairs = meter.pairs();
  std::mutex mutex;
  std::size_t done = 0;
  parallel_for(detectors.size(), [&](std::size_t worker) {
    for (std::size_t i = worker; i < pairs.size(); i += detectors.size()) {
      throw_if_interrupted("how much the detector uses its picture is measured anew");
      const Frame frame = read_frame(data, pairs[i].frame);
      const std::vector<LidarPoint> points = points_in_view(frame.sweep, frame.calibration);
      Detector& detector = *detectors[worker];
      meter.look(detector, frame, points,
                 detector.forward({&frame.image, points, &frame.calibration}, kFaintScore, false));
      const std::lock_guard lock(mutex);
      if (progress) progress(++done, pairs.size());
    }
  });
  return meter.result();
}

std::string picture_note(const Reliance& reliance) {
  if (reliance.uses_picture()) return "";
  if (!reliance.reads_picture) return "this detector has no picture: nothing follows about images";
  if (reliance.vehicles == 0)
    return "whether this detector uses its picture cannot be measured here: nothing follows about images";
  if (reliance.ap70 <= 0) return "this detector finds no vehicle as recorded: nothing follows about images";
  if (!reliance.ignores_picture())
    return fmt::format(
        "whether this detector uses its picture cannot be told from {} cars in {} frames: nothing follows "
        "about images",
        reliance.vehicles, reliance.frames);
  return "this detector does not use its picture: nothing follows about images";
}

std::string describe(const Reliance& reliance) {
  if (!reliance.reads_picture) return "no camera";
  return fmt::format(
      "AP 0.7 {:.1f} % with the right picture, {:.1f} % with another frame's: {:+.1f} points ({:+.1f} to "
      "{:+.1f}); logits of cars move by {:.2f}",
      100 * reliance.ap70, 100 * reliance.ap70_swapped, 100 * reliance.drop.value, 100 * reliance.drop.low,
      100 * reliance.drop.high, reliance.mean_delta_logit);
}

nlohmann::json to_json(const Reliance& reliance) {
  nlohmann::json json = {{"reads_picture", reliance.reads_picture},
                         {"uses_picture", reliance.uses_picture()},
                         {"note", picture_note(reliance)}};
  if (!reliance.reads_picture) return json;
  json.update({{"ap70", reliance.ap70},
               {"ap70_swapped", reliance.ap70_swapped},
               {"ap70_black", reliance.ap70_black},
               {"drop", reliance.drop.value},
               {"drop_low", reliance.drop.low},
               {"drop_high", reliance.drop.high},
               {"mean_delta_logit", reliance.mean_delta_logit},
               {"mean_delta_score", reliance.mean_delta_score},
               {"frames", reliance.frames},
               {"frames_left_out", reliance.left_out},
               {"vehicles", reliance.vehicles},
               {"clusters", to_json(reliance.clusters)}});
  if (std::isfinite(reliance.delta_logit_high)) json["delta_logit_high"] = reliance.delta_logit_high;
  if (reliance.ap70_none) json["ap70_none"] = *reliance.ap70_none;
  return json;
}

Reliance reliance_from_json(const JsonFields& fields) {
  Reliance reliance;
  reliance.reads_picture = fields.truth("reads_picture");
  if (!reliance.reads_picture) return reliance;
  constexpr double kOne = 1 + 1e-9;  // rounded
  const auto share = [&](const char* key) { return fields.number(key, -kOne, kOne); };
  reliance.ap70 = share("ap70");
  reliance.ap70_swapped = share("ap70_swapped");
  reliance.ap70_black = share("ap70_black");
  if (fields.has("ap70_none")) reliance.ap70_none = share("ap70_none");
  reliance.drop = {share("drop"), share("drop_low"), share("drop_high")};
  reliance.mean_delta_logit = fields.number("mean_delta_logit", 0, 1e9);
  reliance.delta_logit_high = fields.has("delta_logit_high") ? fields.number("delta_logit_high", 0, 1e9)
                                                             : std::numeric_limits<double>::infinity();
  reliance.mean_delta_score = share("mean_delta_score");
  reliance.frames = fields.count("frames");
  reliance.left_out = fields.count("frames_left_out");
  reliance.vehicles = fields.count("vehicles");
  reliance.clusters = cluster_count_from_json(fields.object("clusters"));
  return reliance;
}

}  // namespace mirage
