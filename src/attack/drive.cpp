#include "attack/drive.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <set>

#include "attack/clean_view.h"
#include "attack/ride.h"
#include "base/angles.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/names.h"
#include "base/progress.h"
#include "scene/data/read_frames.h"
#include "simulation/insertion.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr const char* kKept = "finished vehicles are kept; run the same command again to go on";
/// m; boxes from above are given this height, from the road up.
constexpr double kUnknownHeight = 1.5;
constexpr double kHalfLane = 1.75;  // m to each side of straight ahead

/// A frame of a sequence with all that is known of it before anything is inserted.
struct SceneFrame {
  std::string id;
  Moment moment;
  std::vector<Label> labels;
  std::vector<Detection> clean;  ///< detections as recorded
};

/// A vehicle of a sequence: its frames, and its label in each.
struct Followed {
  int track = -1;
  std::vector<std::size_t> frames;  ///< by place in the sequence
  std::vector<int> labels;          ///< by place in that frame
};

/// Whether it is a car or van that the data set follows, inside the detector's region (x_min, x_max, y_min,
/// y_max; m).
bool is_judged(const Label& label, const std::array<double, 4>& region) {
  const BevBox& box = label.box.bev;
  return label.track >= 0 && has_box(label) && (label.type == "Car" || label.type == "Van") &&
         box.x >= region[0] && box.x <= region[1] && box.y >= region[2] && box.y <= region[3];
}

std::vector<Followed> vehicles_of(const std::vector<SceneFrame>& scene, const std::array<double, 4>& region,
                                  int least_frames) {
  std::map<int, Followed> followed;
  for (std::size_t i = 0; i < scene.size(); ++i)
    for (std::size_t k = 0; k < scene[i].labels.size(); ++k) {
      const Label& label = scene[i].labels[k];
      if (!is_judged(label, region)) continue;
      Followed& vehicle = followed[label.track];
      if (!vehicle.frames.empty() && vehicle.frames.back() == i)
        throw InputError("frame " + scene[i].id, "labels",
                         fmt::format("two are of the identity {}", label.track), "correct the labels");
      vehicle.track = label.track;
      vehicle.frames.push_back(i);
      vehicle.labels.push_back(static_cast<int>(k));
    }
  std::vector<Followed> long_enough;
  for (auto& [track, vehicle] : followed)
    if (static_cast<int>(vehicle.frames.size()) >= least_frames) long_enough.push_back(std::move(vehicle));
  return long_enough;
}

/// The detection's box; one from above is given a height.
Box3 upright_box(const Box3& box, double road) {
  return box.height > 0 ? box : Box3{box.bev, road, kUnknownHeight};
}

/// The tracks of a whole sequence: for each frame those that are confirmed, in `velo`.
std::vector<std::vector<TrackState>> follow(const std::vector<SceneFrame>& scene,
                                            const std::vector<const std::vector<Detection>*>& detections,
                                            double road, const TrackerSettings& settings) {
  Tracker tracker(settings);
  std::vector<std::vector<TrackState>> confirmed(scene.size());
  for (std::size_t i = 0; i < scene.size(); ++i) {
    const Transform world_from_ego = laid_flat(scene[i].moment.world_from_ego);
    std::vector<TrackedDetection> seen;
    for (const Detection& detection : *detections[i])
      seen.push_back({moved_flat(upright_box(detection.box, road), world_from_ego), detection.score()});
    for (TrackState& state : tracker.step(scene[i].moment.time, seen)) {
      if (!state.confirmed) continue;
      state.box = moved_flat(state.box, world_from_ego.inverse());
      confirmed[i].push_back(state);
    }
  }
  return confirmed;
}

bool is_phantom(const BevBox& box, const SceneFrame& frame, DriveVersion version) {
  for (const Label& label : frame.labels)
    if (has_box(label) && iou(box, label.box.bev) > 0) return false;
  return version == DriveVersion::clean ||
         std::none_of(frame.clean.begin(), frame.clean.end(),
                      [&](const Detection& d) { return iou(box, d.box.bev) > 0; });
}

/// Speed of the car in the world at each frame, m/s.
std::vector<Vec3d> ego_velocities(const std::vector<SceneFrame>& scene) {
  std::vector<Vec3d> velocities(scene.size(), Vec3d::Zero());
  for (std::size_t i = 0; i < scene.size() && scene.size() > 1; ++i) {
    const Moment &before = scene[i > 0 ? i - 1 : 0].moment,
                 &after = scene[std::min(i + 1, scene.size() - 1)].moment;
    velocities[i] = (after.world_from_ego.translation() - before.world_from_ego.translation()) /
                    (after.time - before.time);
  }
  return velocities;
}

/// What one version shows of the vehicle.
void add_sights(DriveVersion version, const std::vector<SceneFrame>& scene, const Followed& followed,
                const std::vector<const std::vector<Detection>*>& detections,
                const std::vector<std::vector<TrackState>>& tracks, VehicleDrive& vehicle) {
  const HidingRule& rule = kHidingRules.front();
  const auto v = static_cast<std::size_t>(version);
  std::set<int> phantoms;
  for (std::size_t i = 0; i < followed.frames.size(); ++i) {
    const std::size_t at = followed.frames[i];
    const BevBox& box = scene[at].labels[static_cast<std::size_t>(followed.labels[i])].box.bev;
    DriveSight& sight = vehicle.frames[i].sights[v];
    for (const Detection& detection : *detections[at])
      sight.found = sight.found || iou(detection.box.bev, box) > rule.iou;
    for (const TrackState& track : tracks[at]) {
      if (iou(track.box.bev, box) > rule.iou) {
        if (track.detection >= 0)
          sight.track = TrackSight::found;
        else if (sight.track == TrackSight::lost)
          sight.track = TrackSight::coasting;
      } else if (is_phantom(track.box.bev, scene[at], version)) {
        ++sight.phantoms;
        phantoms.insert(track.id);
        const BevBox& where = track.box.bev;
        sight.phantom_in_lane = sight.phantom_in_lane || (where.x > 0 && std::abs(where.y) < kHalfLane);
      }
    }
  }
  vehicle.phantom_tracks[v] = static_cast<int>(phantoms.size());
}

/// One sequence, prepared.
struct DriveScene {
  std::vector<SceneFrame> frames;
  std::vector<std::vector<TrackState>> clean_tracks;
  std::vector<Vec3d> velocities;  ///< of the car
  double road = 0;                ///< m, z of the road in `velo`
};

VehicleDrive judge_vehicle(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request,
                           const std::string& sequence, const DriveScene& scene, const Followed& followed,
                           const std::function<void()>& frame_done) {
  const std::size_t count = followed.frames.size();
  std::vector<RideFrame> found(count);
  for (std::size_t i = 0; i < count; ++i) {
    const SceneFrame& frame = scene.frames[followed.frames[i]];
    found[i] = {frame.moment, store.placement({frame.id, followed.labels[i]}).carrier.value()};
  }
  const Ride ridden = ride(found);
  VehicleDrive vehicle;
  vehicle.sequence = sequence;
  vehicle.track = followed.track;
  vehicle.type = found.front().carrier.label.type;
  vehicle.fitted = ridden.fitted;
  vehicle.residual_m = ridden.residual_m;
  vehicle.residual_deg = ridden.residual_rad / kDegree;
  vehicle.fit_jitter_m = ridden.fit_jitter_m;
  vehicle.jitter_m = ridden.jitter_m;
  for (std::size_t i = 0; i < count; ++i) {
    const BevBox& box = found[i].carrier.label.box.bev;
    DriveFrame frame;
    frame.index = found[i].moment.index;
    frame.time = found[i].moment.time;
    frame.range = std::hypot(box.x, box.y);
    frame.nearest = frame.range;
    for (const Vec2d& corner : corners(box)) frame.nearest = std::min(frame.nearest, corner.norm());
    const Vec3d relative = found[i].moment.world_from_ego.linear().transpose() *
                           (ridden.velocities[i] - scene.velocities[followed.frames[i]]);
    if (frame.range > 0) frame.closing = -(relative.x() * box.x + relative.y() * box.y) / frame.range;
    vehicle.frames.push_back(frame);
  }
  const std::array<const TexturedMesh*, 2> objects = {&request.object, &request.random};
  std::array<std::vector<std::vector<Detection>>, 2> seen;
  for (auto& of : seen) of.resize(count);
  const bool local = detectors.front()->capabilities().why_whole.empty();
  for_each_with_detector(detectors, count, [&](Detector& detector, std::size_t i) {
    throw_if_interrupted(kKept);
    const auto held = store.get(scene.frames[followed.frames[i]].id);
    const PreparedFrame& prepared = *held;
    const Placement placement = placement_of(request.place, ridden.carriers[i]);
    for (std::size_t o = 0; o < objects.size(); ++o) {
      const Simulated simulated = simulate(prepared, placement, *objects[o], request.simulation);
      SensorView view = view_of(prepared.frame, simulated.image, simulated.sweep);
      CleanView as_recorded;
      if (local) {
        as_recorded = clean_view(prepared, simulated);
        view.clean = &as_recorded;
      }
      seen[o][i] = detections(detector, view, request.evaluation);
    }
    frame_done();
  });
  std::vector<const std::vector<Detection>*> all;
  for (const SceneFrame& frame : scene.frames) all.push_back(&frame.clean);
  add_sights(DriveVersion::clean, scene.frames, followed, all, scene.clean_tracks, vehicle);
  for (std::size_t o = 0; o < objects.size(); ++o) {
    for (std::size_t i = 0; i < count; ++i) all[followed.frames[i]] = &seen[o][i];
    add_sights(o == 0 ? DriveVersion::attacked : DriveVersion::random, scene.frames, followed, all,
               follow(scene.frames, all, scene.road, request.settings.tracker), vehicle);
  }
  return vehicle;
}

/// The vehicle's stored result if it is of the same key and whole; none otherwise.
std::optional<VehicleDrive> stored_vehicle(const fs::path& file, const std::string& key) {
  if (file.empty() || !fs::exists(file)) return std::nullopt;
  try {
    const nlohmann::json stored = read_json(file);
    const JsonFields fields(file, stored, "delete the file");
    if (fields.text("key") != key) return std::nullopt;
    return read_vehicle_drive(fields);
  } catch (const InputError& damaged) {
    spdlog::warn("{}", damaged.what());
    return std::nullopt;
  }
}

/// Truths and tracks of a sequence as recorded. Identities of several sequences are kept apart by `sequence`.
void add_track_frames(const DriveScene& scene, const std::array<double, 4>& region, int sequence,
                      std::vector<TrackFrame>& frames) {
  constexpr int kTracksOfSequence = 1 << 20;
  for (std::size_t i = 0; i < scene.frames.size(); ++i) {
    std::vector<BevBox> boxes, tracks;
    TrackFrame frame;
    for (const Label& label : scene.frames[i].labels)
      if (is_judged(label, region)) {
        frame.truths.push_back(label.track);
        boxes.push_back(label.box.bev);
      }
    for (const TrackState& track : scene.clean_tracks[i]) {
      frame.tracks.push_back(sequence * kTracksOfSequence + track.id);
      tracks.push_back(track.box.bev);
    }
    frame.similarity.resize(static_cast<Eigen::Index>(boxes.size()),
                            static_cast<Eigen::Index>(tracks.size()));
    for (std::size_t t = 0; t < boxes.size(); ++t)
      for (std::size_t k = 0; k < tracks.size(); ++k)
        frame.similarity(static_cast<Eigen::Index>(t), static_cast<Eigen::Index>(k)) =
            iou(boxes[t], tracks[k]);
    frames.push_back(std::move(frame));
  }
}

DriveScene prepare_scene(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request,
                         const Sequence& sequence) {
  DriveScene scene;
  std::vector<HostId> frames;
  for (const SequenceFrame& frame : sequence.frames) frames.push_back({frame.id, 0});
  const CleanDetections clean = clean_detections(detectors, store, frames, request.evaluation);
  std::vector<const std::vector<Detection>*> all;
  for (const SequenceFrame& frame : sequence.frames)
    scene.frames.push_back(
        {frame.id, frame.moment, read_annotations(request.data, frame.id).labels, clean.at(frame.id)});
  for (const SceneFrame& frame : scene.frames) all.push_back(&frame.clean);
  scene.road = -store.get(sequence.frames.front().id)->lidar.height;
  scene.clean_tracks = follow(scene.frames, all, scene.road, request.settings.tracker);
  scene.velocities = ego_velocities(scene.frames);
  return scene;
}

/// A figure of each vehicle, and differences, as medians.
template <class FigureOf>
nlohmann::json medians(const std::vector<VehicleDrive>& vehicles, const FigureOf& figure_of) {
  ByVersion<std::vector<double>> values;
  for (const VehicleDrive& vehicle : vehicles)
    for (std::size_t v = 0; v < values.size(); ++v)
      values[v].push_back(figure_of(outcome_of(vehicle, static_cast<DriveVersion>(v))));
  nlohmann::json json;
  for (std::size_t v = 0; v < values.size(); ++v)
    json[kDriveVersions[v]] = to_json(median_interval(values[v]));
  const auto attacked = static_cast<std::size_t>(DriveVersion::attacked);
  for (const DriveVersion other : {DriveVersion::clean, DriveVersion::random}) {
    const auto v = static_cast<std::size_t>(other);
    std::vector<double> differences;
    for (std::size_t i = 0; i < vehicles.size(); ++i)
      differences.push_back(values[attacked][i] - values[v][i]);
    json[fmt::format("attacked_less_{}", kDriveVersions[v])] = to_json(median_interval(differences));
  }
  return json;
}

}  // namespace

Transform laid_flat(const Transform& pose) {
  Transform laid = Transform::Identity();
  laid.linear() = Eigen::AngleAxisd(std::atan2(pose(1, 0), pose(0, 0)), Vec3d::UnitZ()).toRotationMatrix();
  laid.translation() = Vec3d(pose.translation().x(), pose.translation().y(), 0);
  return laid;
}

Box3 moved_flat(const Box3& box, const Transform& pose) {
  const Vec3d at = pose * Vec3d(box.bev.x, box.bev.y, box.bottom);
  const double turn = std::atan2(pose(1, 0), pose(0, 0));
  return {
      {at.x(), at.y(), box.bev.length, box.bev.width, wrap_angle(box.bev.yaw + turn)}, at.z(), box.height};
}

DriveResult judge_drive(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request) {
  const Capabilities can = detectors.front()->capabilities();
  if (!can.finds_bev)
    throw InputError("--detector", detectors.front()->name(),
                     "finds boxes in the picture alone, which have no place in the world",
                     "use a detector of boxes in space: lidar, fusion, …");
  if (can.remembers)
    throw InputError("--detector", detectors.front()->name(),
                     "answers by the frames before, and a drive asks it frame by frame",
                     "use it without its memory: the tracker remembers");
  const auto region = detectors.front()->region();
  DriveResult result;
  std::vector<TrackFrame> track_frames;
  const std::string key = request.made_of.identity();
  for (std::size_t s = 0; s < request.sequences.size(); ++s) {
    const Sequence& sequence = request.sequences[s];
    const DriveScene scene = prepare_scene(detectors, store, request, sequence);
    add_track_frames(scene, region, static_cast<int>(s), track_frames);
    result.frames += static_cast<int>(scene.frames.size());
    const std::vector<Followed> followed = vehicles_of(scene.frames, region, request.settings.least_frames);
    std::size_t frames = 0, done = 0;
    for (const Followed& vehicle : followed) frames += vehicle.frames.size();
    Progress progress("drive " + escape_name(sequence.name), frames, request.evaluation.quiet);
    std::mutex mutex;
    for (const Followed& vehicle : followed) {
      throw_if_interrupted(kKept);
      const std::string name = fmt::format("{}_{}.json", escape_name(sequence.name), vehicle.track);
      const fs::path file = request.folder.empty() ? fs::path() : request.folder / name;
      auto judged = stored_vehicle(file, key);
      if (judged) {
        progress.update(done += vehicle.frames.size());
      } else {
        judged = judge_vehicle(detectors, store, request, sequence.name, scene, vehicle, [&] {
          const std::lock_guard lock(mutex);
          progress.update(++done);
        });
        nlohmann::json stored = to_json(*judged);
        stored["key"] = key;
        if (!file.empty()) write_json(file, stored);
      }
      result.vehicles.push_back(std::move(*judged));
    }
  }
  if (result.vehicles.empty())
    throw InputError(request.data.string(), "labels",
                     fmt::format("no car or van is followed through {} frames in the detector's region",
                                 request.settings.least_frames),
                     "give more frames or lower --least-frames");
  result.clean = score_tracks(track_frames);
  return result;
}

nlohmann::json to_json(const DriveResult& result) {
  nlohmann::json json = {{"frames", result.frames}, {"tracker", to_json(result.clean)}};
  for (const VehicleDrive& vehicle : result.vehicles) json["vehicles"].push_back(to_json(vehicle));
  json["gap_s"] = medians(result.vehicles, [](const DriveOutcome& of) { return of.gap_s; });
  json["track_gap_s"] = medians(result.vehicles, [](const DriveOutcome& of) { return of.track_gap_s; });
  json["confirmed_m"] = medians(
      result.vehicles, [](const DriveOutcome& of) { return of.confirmed ? of.confirmed->metres : 0; });
  for (const double seconds : {0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0}) {
    nlohmann::json row = {{"seconds", seconds}};
    for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
      ClusteredShare share;
      for (const VehicleDrive& vehicle : result.vehicles)
        share.add(fmt::format("{} {}", vehicle.sequence, vehicle.track),
                  outcome_of(vehicle, static_cast<DriveVersion>(v)).gap_s >= seconds);
      row[kDriveVersions[v]] = to_json(share.interval());
    }
    json["survival"].push_back(row);
  }
  for (std::size_t v = 0; v < kDriveVersions.size(); ++v)
    json["never_confirmed"][kDriveVersions[v]] =
        std::count_if(result.vehicles.begin(), result.vehicles.end(), [&](const VehicleDrive& vehicle) {
          return !outcome_of(vehicle, static_cast<DriveVersion>(v)).confirmed;
        });
  return json;
}

}  // namespace mirage
