#include "detection/audit.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <deque>
#include <memory>
#include <mutex>
#include <opencv2/imgproc.hpp>
#include <set>

#include "base/error.h"
#include "base/fields.h"
#include "base/image.h"
#include "base/parallel.h"
#include "base/random.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "base/types.h"
#include "detection/car_in_picture.h"
#include "scene/data/read_frames.h"
#include "scene/occlusion.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using Kind = AuditChange::Kind;

constexpr double kIou = 0.7;
constexpr double kSameCar = 0.1;  // IoU

/// The detector's answers to one view of a frame.
struct Answers {
  ScoredFrame scored;
  std::vector<Detection> cars;  ///< of each labelled car: its matching_proposal
  std::vector<char> found;      ///< of each labelled car
};

/// A frame's answers: to the right inputs, and to each change that it has.
struct FrameAnswers {
  Answers right;
  std::vector<std::optional<Answers>> changed;
};

/// The detections after suppression, and the proposal that matches each labelled car.
ViewAnswers answers_to(Detector& detector, const SensorView& view, const GroundTruth& truth) {
  const Matching matching = detector.capabilities().matching();
  const std::vector<Detection> proposals = detector.forward(view, kFaintScore, false);
  ViewAnswers found = {suppress(scored_over(proposals, kScoreThresholdForAp), matching), {}};
  for (const ObjectBoxes& car : scored({}, truth, 0, matching).truth.boxes)
    found[1].push_back(matching_proposal(proposals, car, matching));
  return found;
}

/// `found`: the result of answers_to.
Answers answers(ViewAnswers found, const GroundTruth& truth, double focal_length, Matching matching) {
  Answers result;
  result.scored = scored(std::move(found.at(0)), truth, focal_length, matching);
  result.cars = std::move(found.at(1));
  for (const ObjectBoxes& car : result.scored.truth.boxes) {
    result.found.push_back(std::any_of(
        result.scored.detections.begin(), result.scored.detections.end(), [&](const Detection& detection) {
          return detection.score() > kScoreThreshold && matching.overlap(detection, car) >= kIou;
        }));
  }
  return result;
}

ImageF blurred(const ImageF& picture, double sigma) {
  ImageF result = picture;
  const cv::Mat pixels(picture.height, picture.width, CV_32FC(picture.channels),
                       const_cast<float*>(picture.data.data()));
  cv::Mat out(picture.height, picture.width, CV_32FC(picture.channels), result.data.data());
  cv::GaussianBlur(pixels, out, cv::Size(), sigma, sigma, cv::BORDER_REPLICATE);
  return result;
}

/// The returns of `count` beams, drawn from the beams with returns.
std::vector<LidarPoint> thinned(std::span<const LidarPoint> points, const LidarModel& lidar, int count,
                                RandomStream random) {
  const std::vector<int> beam = beams_of(points, lidar);
  const std::set<int> all(beam.begin(), beam.end());
  std::vector<int> drawn(all.begin(), all.end());
  std::erase(drawn, -1);
  shuffle(drawn, random);
  drawn.resize(std::min<std::size_t>(drawn.size(), as_size(count)));
  std::vector<LidarPoint> result;
  for (std::size_t i = 0; i < points.size(); ++i)
    if (std::find(drawn.begin(), drawn.end(), beam[i]) != drawn.end()) result.push_back(points[i]);
  return result;
}

/// The data that the changes of one frame are made from.
struct Scene {
  const DataSet& data;
  const PicturePair& pair;
  std::size_t index;  ///< of the frame
  const Frame& frame;
  std::span<const LidarPoint> points;  ///< in view
  const Capabilities& can;
  const std::optional<LidarModel>& lidar;
  std::uint64_t seed;
};

/// The sweep of another frame, cut to the view as the scene's is.
std::vector<LidarPoint> sweep_in_view(const Scene& scene, const std::string& id) {
  if (!scene.frame.others.empty()) return scene.data.sweep(id);
  const auto [width, height] = scene.data.picture_size(id);
  return points_in_view(scene.data.sweep(id), scene.data.annotations(id, width, height).calibration);
}

/// The picture of the scene's camera of that number in another frame.
ImageF picture_in(const std::string& id, const Scene& scene, std::size_t of) {
  if (of == 0) return read_srgb(scene.data.source_files(id).at(1).file);
  const std::string& name = scene.frame.name_of(of);
  for (const SideCamera& camera : scene.data.others(id))
    if (camera.name == name) return camera.image.get();
  throw InputError("frame " + id, name, "has no such camera", "leave the frame out, or give --cameras first");
}

/// A view, with the data that it shows in place of the frame's own.
struct ChangedView {
  std::deque<ImageF> pictures;
  std::vector<LidarPoint> points;
  Calibration calibration;
  SensorView view;

  ChangedView(const Scene& scene)
      : calibration(scene.frame.calibration), view(view_of(scene.frame, scene.frame.image, scene.points)) {}
  ChangedView(const ChangedView&) = delete;
  /// Shows picture(camera) for the first camera and each other one that the detector reads, by its number in
  /// the frame; empty: no picture.
  template <class Picture>
  void show_pictures(const Scene& scene, const Picture& picture) {
    for (std::size_t camera = 0; camera < scene.frame.cameras(); ++camera) {
      if (camera > 0 && !scene.can.names(scene.frame.name_of(camera))) continue;
      const ImageF& shown = pictures.emplace_back(picture(camera));
      if (camera > 0) view.others.push_back(sensor_beside(scene.frame, camera - 1, &shown));
      (camera > 0 ? view.others.back().image : view.image) = shown.empty() ? nullptr : &shown;
    }
  }
  void show(std::vector<LidarPoint> shown) {
    points = std::move(shown);
    view.points = points;
  }
  void set_camera_from_velo(const Transform& camera_from_velo) {
    calibration.camera_from_velo = camera_from_velo;
    view.calibration = &calibration;
  }
};

/// Null where the frame does not have the change.
std::unique_ptr<ChangedView> changed_view(const AuditChange& change, const Scene& scene) {
  auto changed = std::make_unique<ChangedView>(scene);
  const Transform& camera_from_velo = scene.frame.calibration.camera_from_velo;
  switch (change.kind) {
    case Kind::other_picture:
      changed->show_pictures(scene, [&](std::size_t of) { return picture_in(scene.pair.other, scene, of); });
      break;
    case Kind::black_picture:
      changed->show_pictures(scene, [&](std::size_t of) {
        const PinholeCamera& camera = scene.frame.calibration_of(of).camera;
        return ImageF(camera.width, camera.height, 3);
      });
      break;
    case Kind::no_picture:
      changed->show_pictures(scene, [](std::size_t) { return ImageF(); });
      break;
    case Kind::blurred_picture:
      changed->show_pictures(
          scene, [&](std::size_t of) { return blurred(scene.frame.image_of(of), change.amount); });
      break;
    case Kind::late_picture: {
      const auto earlier = scene.data.beside(scene.pair.frame, -static_cast<int>(change.amount));
      if (!earlier) return nullptr;
      changed->show_pictures(scene, [&](std::size_t of) { return picture_in(*earlier, scene, of); });
      break;
    }
    case Kind::other_sweep:
      changed->show(sweep_in_view(scene, scene.pair.other));
      break;
    case Kind::thinned_sweep:
      if (!scene.lidar) return nullptr;
      changed->show(thinned(scene.points, *scene.lidar, static_cast<int>(change.amount),
                            RandomStream(scene.seed, "audit beams", scene.index)));
      break;
    case Kind::no_points:
      changed->view.points = {};
      break;
    case Kind::turned_camera:
      changed->set_camera_from_velo(Eigen::AngleAxisd(change.amount * kDegree, Vec3d::UnitY()) *
                                    camera_from_velo);
      break;
    case Kind::moved_camera:
      changed->set_camera_from_velo(Eigen::Translation3d(change.amount, 0, 0) * camera_from_velo);
      break;
  }
  return changed;
}

/// The view of the frame at `index` under the change.
ShownView shown_view(const AuditChange& change, const DataSet& data, const PicturePair& pair,
                     std::size_t index, std::uint64_t seed) {
  ShownView view = {{pair.frame}, {static_cast<int>(change.kind), change.amount}};
  if (change.kind == Kind::other_picture || change.kind == Kind::other_sweep)
    view.frames.push_back(pair.other);
  if (change.kind == Kind::late_picture)
    if (const auto earlier = data.beside(pair.frame, -static_cast<int>(change.amount)))
      view.frames.push_back(*earlier);
  if (change.kind == Kind::thinned_sweep) view.change.insert(view.change.end(), {seed, index});
  return view;
}

/// A frame as it is shown.
struct Shown {
  Frame frame;
  std::vector<LidarPoint> points;
  GroundTruth truth;
};

/// The cars of a stratum, with the right inputs and with a change.
struct FoundCars {
  int vehicles = 0;
  ClusteredShare right, changed;
};

std::vector<Stratum> distances() {
  const std::vector<Stratum> strata = standard_strata();  // those of distance alone come first
  return {{"all"}, strata[0], strata[1], strata[2]};
}

double ap70_of(const std::vector<ScoredFrame>& frames) {
  return average_precision(frames, kIou).average_precision;
}

AuditRow row_of(const AuditChange& change, const std::vector<FrameAnswers>& frames, std::size_t place) {
  AuditRow row;
  row.change = change;
  std::vector<ScoredFrame> right, changed;
  ClusteredShare delta_logit;
  const std::vector<Stratum> strata = distances();
  std::vector<FoundCars> found(strata.size());
  for (std::size_t f = 0; f < frames.size(); ++f) {
    const Answers& before = frames[f].right;
    const std::optional<Answers>& after = frames[f].changed[place];
    if (!after) continue;
    right.push_back(before.scored);
    changed.push_back(after->scored);
    for (std::size_t i = 0; i < before.cars.size(); ++i) {
      const TruthBox& car = before.scored.truth.boxes[i];
      const std::string cluster = cluster_of(std::to_string(f + 1), car.track);
      delta_logit.add(cluster, std::abs(before.cars[i].logit - after->cars[i].logit));
      row.delta_score += std::abs(before.cars[i].score() - after->cars[i].score());
      ++row.vehicles;
      for (std::size_t s = 0; s < strata.size(); ++s) {
        if (car.distance < strata[s].nearest || car.distance >= strata[s].farthest) continue;
        ++found[s].vehicles;
        found[s].right.add(cluster, before.found[i]);
        found[s].changed.add(cluster, after->found[i]);
      }
    }
  }
  row.frames = static_cast<int>(right.size());
  row.right70 = ap70_of(right);
  row.ap70 = ap70_of(changed);
  row.drop = average_precision_difference(right, changed, kIou);
  row.delta_logit = delta_logit.mean_interval();
  row.delta_score /= std::max(1, row.vehicles);
  for (std::size_t s = 0; s < strata.size(); ++s)
    if (found[s].vehicles > 0)
      row.lost.push_back(
          {strata[s].name, found[s].vehicles, share_difference(found[s].right, found[s].changed)});
  return row;
}

std::string points_of(const Interval& drop) {
  return fmt::format("{:.1f} points of AP 0.7 ({:.1f} to {:.1f})", 100 * drop.value, 100 * drop.low,
                     100 * drop.high);
}

std::string use_in_words(const AuditRow& row) {
  const char* input = row.change.input() == AuditInput::picture ? "picture" : "sweep";
  const char* verdict[] = {"it uses its {}", "it does not use its {}",
                           "whether it uses its {} cannot be told"};
  return fmt::format("Another frame's {} costs {}: {}.", input, points_of(row.drop),
                     fmt::format(fmt::runtime(verdict[static_cast<int>(row.use())]), input));
}

/// The weakest of these changes that costs AP beyond its interval, and whether a weaker one is harmless.
std::string sensitivity_text(const Audit& audit, Kind kind, const char* what) {
  const AuditRow* weakest = nullptr;
  const AuditRow* harmless = nullptr;
  for (const AuditRow& row : audit.rows) {
    if (row.change.kind != kind || !row.refused.empty()) continue;
    if (classify(row.drop) == DifferenceVerdict::same && !weakest) harmless = &row;
    if (!weakest && classify(row.drop) == DifferenceVerdict::more) weakest = &row;
  }
  std::string text;
  if (weakest) text = fmt::format("{} {} costs {}.", what, weakest->change.text(), points_of(weakest->drop));
  if (harmless)
    text += fmt::format("{}{} {} changes AP 0.7 by less than 5 points.", text.empty() ? "" : " ", what,
                        harmless->change.text());
  return text.empty() ? fmt::format("Whether {} matters cannot be told.", what) : text;
}

}  // namespace

AuditInput AuditChange::input() const {
  if (kind <= Kind::late_picture) return AuditInput::picture;
  return kind <= Kind::no_points ? AuditInput::points : AuditInput::calibration;
}

bool AuditChange::removes_input() const {
  return kind == Kind::no_picture || kind == Kind::no_points;
}

std::string AuditChange::text() const {
  switch (kind) {
    case Kind::other_picture:
    case Kind::other_sweep:
      return "another frame's";
    case Kind::black_picture:
      return "black";
    case Kind::no_picture:
    case Kind::no_points:
      return "none";
    case Kind::blurred_picture:
      return fmt::format("blurred by {:g} px", amount);
    case Kind::late_picture:
      return fmt::format("late by {:g} frame{}", amount, amount == 1 ? "" : "s");
    case Kind::thinned_sweep:
      return fmt::format("{:g} beams", amount);
    case Kind::turned_camera:
      return fmt::format("turned by {:g}°", amount);
    case Kind::moved_camera:
      return fmt::format("moved by {:g} cm", 100 * amount);
  }
  return "";
}

std::vector<AuditChange> gate_changes() {
  return {{Kind::other_picture}, {Kind::black_picture}, {Kind::no_picture}};
}

std::vector<AuditChange> audit_changes(const Capabilities& can) {
  std::vector<AuditChange> changes;
  const auto add = [&](Kind kind, std::initializer_list<double> amounts) {
    for (const double amount : amounts) changes.push_back({kind, amount});
  };
  if (can.reads_image) {
    changes = gate_changes();
    add(Kind::blurred_picture, {2, 8});
    add(Kind::late_picture, {1, 2, 5});
  }
  if (can.reads_points) {
    add(Kind::other_sweep, {0});
    add(Kind::thinned_sweep, {8, 4, 2});
    add(Kind::no_points, {0});
  }
  if (can.reads_image && can.reads_points) {
    add(Kind::turned_camera, {0.5, 1, 2, 5, 10});
    add(Kind::moved_camera, {0.05, 0.1, 0.2, 0.5});
  }
  return changes;
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

Detection matching_proposal(std::span<const Detection> proposals, const ObjectBoxes& car, Matching matching) {
  Detection best{{}, std::log(kFaintScore / (1 - kFaintScore))};
  for (const Detection& proposal : proposals)
    if (proposal.logit > best.logit && matching.overlap(proposal, car) >= kSameCar) best = proposal;
  return best;
}

InputUse input_use(const Interval& drop, const Interval& delta_logit, int vehicles) {
  if (drop.low > 0 && delta_logit.value >= kMinDeltaLogit) return InputUse::used;
  if (vehicles > 0 && drop.value < kSameWithin &&
      (drop.high < kSameWithin || delta_logit.high < kMinDeltaLogit))
    return InputUse::ignored;
  return InputUse::unclear;
}

const AuditRow* Audit::row(AuditChange::Kind kind) const {
  const auto at = std::find_if(rows.begin(), rows.end(),
                               [&](const AuditRow& candidate) { return candidate.change.kind == kind; });
  return at == rows.end() ? nullptr : &*at;
}

Audit run_audit(std::span<Detector* const> detectors, const RecordedFrames& source,
                const std::vector<std::string>& ids, const std::vector<AuditChange>& changes,
                const std::optional<LidarModel>& lidar, std::uint64_t seed,
                const std::function<void(std::size_t, std::size_t)>& progress) {
  const auto set = open_data_set(source.data, source.cameras);
  const std::vector<PicturePair> pairs = pair_pictures(source.data, ids);
  std::vector<FrameAnswers> frames(pairs.size());
  std::vector<std::string> refused(changes.size());
  std::mutex mutex;
  std::size_t done = 0;
  const bool tells = rank() == 0;  // the others fill the cache
  const std::vector<std::size_t> order = order_among_ranks(pairs.size());
  hand_out(detectors.size(), pairs.size(), [&](std::size_t worker, std::size_t k) {
    throw_if_interrupted(source.cached_views ? "run the same command again to resume"
                                             : "nothing was saved; run the audit again from the start");
    Detector& detector = *detectors[worker];
    const std::size_t f = order[k];
    const Capabilities can = detector.capabilities();
    const Lazy<Shown> shown([&] {
      Shown made;
      made.frame = source.read(pairs[f].frame);
      made.points = RecordedFrames::points(made.frame);
      made.truth = ground_truth(made.frame, detector.region(), can);
      return made;
    });
    const auto with_cars = [&](ViewAnswers found) {
      return answers(std::move(found), shown.get().truth, shown.get().frame.calibration.camera.fy,
                     can.matching());
    };
    const auto cached = [&](const ShownView& view, const std::function<ViewAnswers()>& compute) {
      return source.cached_views ? source.cached_views(view, compute) : compute();
    };
    ViewAnswers found = cached({{pairs[f].frame}, "none"}, [&] {
      const Frame& frame = shown.get().frame;
      return answers_to(detector, view_of(frame, frame.image, shown.get().points), shown.get().truth);
    });
    if (tells)
      frames[f].right = with_cars(std::move(found));
    else
      frames[f].right.scored.detections = std::move(found.at(0));
    frames[f].changed.resize(changes.size());
    for (std::size_t c = 0; c < changes.size(); ++c) {
      const auto answer = [&]() -> ViewAnswers {
        const Scene scene{*set, pairs[f], f, shown.get().frame, shown.get().points, can, lidar, seed};
        const std::unique_ptr<ChangedView> changed = changed_view(changes[c], scene);
        if (!changed) return {};
        return answers_to(detector, changed->view, shown.get().truth);
      };
      const auto refuse = [&](const std::exception& error) {
        if (!changes[c].removes_input()) throw;
        const std::lock_guard lock(mutex);
        refused[c] = error.what();
      };
      try {
        found = cached(shown_view(changes[c], *set, pairs[f], f, seed), answer);
      } catch (const Failure& error) {
        refuse(error);
        continue;
      } catch (const InputError& error) {
        refuse(error);
        continue;
      }
      if (tells && !found.empty()) frames[f].changed[c] = with_cars(std::move(found));
    }
    const std::lock_guard lock(mutex);
    if (progress) progress(++done, pairs.size());
  });
  Audit audit;
  for (std::size_t f = 0; f < frames.size(); ++f)
    audit.as_recorded[pairs[f].frame] = frames[f].right.scored.detections;
  if (!tells) return audit;
  audit.frames = static_cast<int>(pairs.size());
  audit.left_out = static_cast<int>(ids.size() - pairs.size());
  std::vector<ScoredFrame> right;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    right.push_back(frames[f].right.scored);
    audit.vehicles += static_cast<int>(frames[f].right.cars.size());
  }
  audit.ap70 = ap70_of(right);
  audit.clusters = clusters_of(right);
  for (std::size_t c = 0; c < changes.size(); ++c) {
    if (!refused[c].empty()) {
      audit.rows.emplace_back().change = changes[c];
      audit.rows.back().refused = refused[c];
      continue;
    }
    AuditRow row = row_of(changes[c], frames, c);
    if (row.frames > 0 || frames.empty()) audit.rows.push_back(std::move(row));
  }
  return audit;
}

std::vector<std::string> describe(const Audit& audit) {
  std::vector<std::string> lines;
  for (const Kind kind : {Kind::other_picture, Kind::other_sweep})
    if (const AuditRow* row = audit.row(kind)) lines.push_back(use_in_words(*row));
  const std::pair<Kind, const char*> errors[] = {
      {Kind::late_picture, "A picture"}, {Kind::turned_camera, "A camera"}, {Kind::moved_camera, "A camera"}};
  for (const auto& [kind, what] : errors)
    if (audit.row(kind)) lines.push_back(sensitivity_text(audit, kind, what));
  return lines;
}

nlohmann::json to_json(const Audit& audit) {
  nlohmann::json rows = nlohmann::json::array(), uses = nlohmann::json::object();
  for (const AuditRow& row : audit.rows) {
    nlohmann::json json = {{"input", to_word(row.change.input())}, {"change", row.change.text()}};
    if (!row.refused.empty()) {
      json["refused"] = row.refused;
      rows.push_back(std::move(json));
      continue;
    }
    nlohmann::json lost = nlohmann::json::array();
    for (const AuditRow::RecallLoss& part : row.lost) {
      lost.push_back(to_json(part.share));
      lost.back().update({{"stratum", part.stratum}, {"vehicles", part.vehicles}});
    }
    json.update({{"frames", row.frames},
                 {"vehicles", row.vehicles},
                 {"ap70_right", row.right70},
                 {"ap70", row.ap70},
                 {"drop", row.drop.value},
                 {"low", row.drop.low},
                 {"high", row.drop.high},
                 {"delta_logit", row.delta_logit.value},
                 {"delta_score", row.delta_score},
                 {"recall_lost", lost}});
    if (std::isfinite(row.delta_logit.high)) json["delta_logit_high"] = row.delta_logit.high;
    rows.push_back(std::move(json));
  }
  const std::pair<const char*, Kind> inputs[] = {{"image", Kind::other_picture},
                                                 {"points", Kind::other_sweep}};
  for (const auto& [name, kind] : inputs)
    if (const AuditRow* row = audit.row(kind)) {
      const InputUse use = row->use();
      uses[name] = use == InputUse::unclear ? nlohmann::json() : nlohmann::json(use == InputUse::used);
    }
  return {{"frames", audit.frames},
          {"frames_left_out", audit.left_out},
          {"vehicles", audit.vehicles},
          {"clusters", to_json(audit.clusters)},
          {"intervals_over", to_string(audit.clusters)},
          {"ap70", audit.ap70},
          {"answer", describe(audit)},
          {"uses", uses},
          {"audit", rows}};
}

}  // namespace mirage
