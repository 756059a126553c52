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
#include "attack/vehicle_drive.h"
#include "base/angles.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/names.h"
#include "base/progress.h"
#include "detection/average_precision.h"
#include "scene/data/kitti_results.h"
#include "scene/data/read_frames.h"
#include "simulation/insertion.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr const char* kKept = "finished vehicles are kept; run the same command again to go on";
/// m; boxes from above are given this height, from the road up.
constexpr double kUnknownHeight = 1.5;
constexpr double kHalfLane = 1.75;  // m to each side of straight ahead
constexpr double kLateWithin = 10;  // m within which a confirmation comes late

/// A frame of a sequence with all that is known of it before anything is inserted.
struct SceneFrame {
  std::string id;
  Moment moment;
  std::vector<Label> labels;
  Calibration calibration;
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

/// The tracks of a whole sequence: for each frame those that live, in `velo`.
std::vector<std::vector<TrackState>> follow(const std::vector<SceneFrame>& scene,
                                            const std::vector<const std::vector<Detection>*>& detections,
                                            double road, const TrackerSettings& settings) {
  Tracker tracker(settings);
  std::vector<std::vector<TrackState>> tracks(scene.size());
  for (std::size_t i = 0; i < scene.size(); ++i) {
    const Transform world_from_ego = laid_flat(scene[i].moment.world_from_ego);
    std::vector<TrackedDetection> seen;
    for (const Detection& detection : *detections[i])
      seen.push_back({moved_flat(upright_box(detection.box, road), world_from_ego), detection.score()});
    for (TrackState& state : tracker.step(scene[i].moment.time, seen)) {
      state.box = moved_flat(state.box, world_from_ego.inverse());
      tracks[i].push_back(state);
    }
  }
  return tracks;
}

TrackerSettings with_death(TrackerSettings settings, int death) {
  settings.death = death;
  return settings;
}

/// Whether a thing there would have a label: the picture shows the middle of its box, and no DontCare region
/// holds half of it or more.
bool would_be_labelled(const Box3& box, const SceneFrame& frame) {
  const auto seen = projected(box, frame.calibration);
  if (!seen) return false;
  const PinholeCamera& camera = frame.calibration.camera;
  const Vec3d middle =
      frame.calibration.camera_from_velo * Vec3d(box.bev.x, box.bev.y, box.bottom + 0.5 * box.height);
  if (middle.z() <= 0) return false;
  const Vec2d pixel = camera.project<double>(middle);
  if (!(pixel.x() >= 0 && pixel.x() <= camera.width - 1 && pixel.y() >= 0 && pixel.y() <= camera.height - 1))
    return false;
  return std::none_of(frame.labels.begin(), frame.labels.end(), [&](const Label& label) {
    return label.type == "DontCare" && intersection_area(*seen, picture_box(label)) >= area(*seen) / 2;
  });
}

bool is_phantom(const Box3& standing, const SceneFrame& frame, DriveVersion version) {
  const BevBox& box = standing.bev;
  if (!would_be_labelled(standing, frame)) return false;
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
                const std::vector<std::vector<TrackState>>& tracks, int birth, VehicleDrive& vehicle) {
  const HidingRule& rule = kHidingRules.front();
  const auto v = static_cast<std::size_t>(version);
  std::set<int> phantoms;
  std::map<int, int> hits;  // of tracks on the vehicle, since it carries the object
  for (std::size_t i = 0; i < followed.frames.size(); ++i) {
    const std::size_t at = followed.frames[i];
    const BevBox& box = scene[at].labels[static_cast<std::size_t>(followed.labels[i])].box.bev;
    DriveSight& sight = vehicle.frames[i].sights[v];
    for (const Detection& detection : *detections[at])
      sight.found = sight.found || iou(detection.box.bev, box) > rule.iou;
    for (const TrackState& track : tracks[at]) {
      if (iou(track.box.bev, box) > rule.iou) {
        hits[track.id] += track.detection >= 0;
        if (!track.confirmed || hits[track.id] < birth) continue;
        if (track.detection >= 0)
          sight.track = TrackSight::found;
        else if (sight.track == TrackSight::lost)
          sight.track = TrackSight::coasting;
      } else if (track.confirmed && is_phantom(track.box, scene[at], version)) {
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
  std::array<std::vector<std::vector<TrackState>>, kDeaths.size()> clean_by_death;
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
  vehicle.in_box_m = ridden.in_box_m;
  vehicle.in_box_deg = ridden.in_box_rad / kDegree;
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
      SensorView view = view_of(prepared, simulated, detector.capabilities());
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
  const auto judge = [&](DriveVersion version, const auto& tracks, const auto& tracks_by_death) {
    add_sights(version, scene.frames, followed, all, tracks, request.settings.tracker.birth, vehicle);
    for (std::size_t d = 0; d < kDeaths.size(); ++d) {
      VehicleDrive other = vehicle;
      for (DriveFrame& frame : other.frames) frame.sights = {};
      add_sights(version, scene.frames, followed, all, tracks_by_death(d), request.settings.tracker.birth,
                 other);
      const DriveOutcome outcome = outcome_of(other, version);
      const auto v = static_cast<std::size_t>(version);
      vehicle.deaths[d].track_gap_s[v] = outcome.track_gap_s;
      vehicle.deaths[d].phantom_frames[v] = outcome.phantom_frames;
    }
  };
  judge(DriveVersion::clean, scene.clean_tracks, [&](std::size_t d) { return scene.clean_by_death[d]; });
  for (std::size_t o = 0; o < objects.size(); ++o) {
    for (std::size_t i = 0; i < count; ++i) all[followed.frames[i]] = &seen[o][i];
    const auto& tracker = request.settings.tracker;
    judge(o == 0 ? DriveVersion::attacked : DriveVersion::random,
          follow(scene.frames, all, scene.road, tracker), [&](std::size_t d) {
            return follow(scene.frames, all, scene.road, with_death(tracker, kDeaths[d]));
          });
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
      if (!track.confirmed) continue;
      // As the benchmark has it, what nobody would have labelled is no false alarm.
      const bool on_truth = std::any_of(boxes.begin(), boxes.end(),
                                        [&](const BevBox& box) { return iou(box, track.box.bev) > 0; });
      if (!on_truth && !would_be_labelled(track.box, scene.frames[i])) continue;
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
  for (const SequenceFrame& frame : sequence.frames) {
    Annotations known = read_annotations(request.data, frame.id);
    scene.frames.push_back(
        {frame.id, frame.moment, std::move(known.labels), std::move(known.calibration), clean.at(frame.id)});
  }
  for (const SceneFrame& frame : scene.frames) all.push_back(&frame.clean);
  scene.road = -store.get(sequence.frames.front().id)->lidar.height;
  scene.clean_tracks = follow(scene.frames, all, scene.road, request.settings.tracker);
  for (std::size_t d = 0; d < kDeaths.size(); ++d)
    scene.clean_by_death[d] =
        follow(scene.frames, all, scene.road, with_death(request.settings.tracker, kDeaths[d]));
  scene.velocities = ego_velocities(scene.frames);
  return scene;
}

std::string name_of(const VehicleDrive& vehicle) {
  return fmt::format("{} {}", vehicle.sequence, vehicle.track);
}

/// The median over vehicles of a figure of one version less that of another.
template <class FigureOf>
nlohmann::json median_difference(const std::vector<VehicleDrive>& vehicles, DriveVersion of,
                                 DriveVersion less, const FigureOf& figure_of) {
  std::vector<double> differences;
  for (const VehicleDrive& vehicle : vehicles)
    differences.push_back(figure_of(outcome_of(vehicle, of)) - figure_of(outcome_of(vehicle, less)));
  return to_json(median_interval(differences));
}

/// A figure of each vehicle, and differences, as medians.
template <class FigureOf>
nlohmann::json medians(const std::vector<VehicleDrive>& vehicles, const FigureOf& figure_of) {
  nlohmann::json json;
  for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
    std::vector<double> values;
    for (const VehicleDrive& vehicle : vehicles)
      values.push_back(figure_of(outcome_of(vehicle, static_cast<DriveVersion>(v))));
    json[kDriveVersions[v]] = to_json(median_interval(values));
  }
  for (const DriveVersion other : {DriveVersion::clean, DriveVersion::random})
    json[fmt::format("attacked_less_{}", kDriveVersions[static_cast<std::size_t>(other)])] =
        median_difference(vehicles, DriveVersion::attacked, other, figure_of);
  return json;
}

/// Of the vehicles that are first seen beyond kLateWithin: how many are confirmed no earlier than there.
nlohmann::json near_of(const std::vector<VehicleDrive>& vehicles) {
  nlohmann::json json = {{"metres", kLateWithin}, {"vehicles", 0}};
  for (const char* version : kDriveVersions) json[version] = 0;
  for (const VehicleDrive& vehicle : vehicles) {
    if (vehicle.frames.front().range <= kLateWithin) continue;
    json["vehicles"] = json["vehicles"].get<int>() + 1;
    for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
      const DriveOutcome outcome = outcome_of(vehicle, static_cast<DriveVersion>(v));
      if (!outcome.confirmed || outcome.confirmed->metres <= kLateWithin)
        json[kDriveVersions[v]] = json[kDriveVersions[v]].get<int>() + 1;
    }
  }
  return json;
}

/// What one of kDeaths gives and costs.
nlohmann::json death_row(const std::vector<VehicleDrive>& vehicles, std::size_t death) {
  nlohmann::json row = {{"death", kDeaths[death]}};
  for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
    std::vector<double> gaps;
    ClusteredShare phantoms;
    for (const VehicleDrive& vehicle : vehicles) {
      const DeathOutcome& at = vehicle.deaths[death];
      gaps.push_back(at.track_gap_s[v]);
      for (int i = 0; i < static_cast<int>(vehicle.frames.size()); ++i)
        phantoms.add(name_of(vehicle), i < at.phantom_frames[v]);
    }
    row["track_gap_s"][kDriveVersions[v]] = to_json(median_interval(gaps));
    row["phantom_share"][kDriveVersions[v]] = to_json(phantoms.interval());
  }
  return row;
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
  const auto confirmed_m = [](const DriveOutcome& of) { return of.confirmed ? of.confirmed->metres : 0; };
  json["confirmed_m"] = medians(result.vehicles, confirmed_m);
  std::vector<VehicleDrive> nearing;
  for (const VehicleDrive& vehicle : result.vehicles)
    if (vehicle.frames.back().range < vehicle.frames.front().range) nearing.push_back(vehicle);
  json["later_m"] = {{"vehicles", nearing.size()}};
  if (!nearing.empty()) {
    json["later_m"]["than_clean"] =
        median_difference(nearing, DriveVersion::clean, DriveVersion::attacked, confirmed_m);
    json["later_m"]["than_random"] =
        median_difference(nearing, DriveVersion::random, DriveVersion::attacked, confirmed_m);
  }
  json["near"] = near_of(result.vehicles);
  for (const auto& [key, number] :
       {std::pair("residual_m", &VehicleDrive::residual_m),
        std::pair("residual_deg", &VehicleDrive::residual_deg),
        std::pair("jitter_m", &VehicleDrive::jitter_m), std::pair("in_box_m", &VehicleDrive::in_box_m),
        std::pair("in_box_deg", &VehicleDrive::in_box_deg)}) {
    std::vector<double> values;
    for (const VehicleDrive& vehicle : result.vehicles) values.push_back(vehicle.*number);
    json["roof"][key] = to_json(median_interval(values));
  }
  for (const double seconds : {0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0}) {
    nlohmann::json row = {{"seconds", seconds}};
    for (std::size_t v = 0; v < kDriveVersions.size(); ++v) {
      ClusteredShare share;
      for (const VehicleDrive& vehicle : result.vehicles)
        share.add(name_of(vehicle), outcome_of(vehicle, static_cast<DriveVersion>(v)).gap_s >= seconds);
      row[kDriveVersions[v]] = to_json(share.interval());
    }
    json["survival"].push_back(row);
  }
  for (std::size_t d = 0; d < kDeaths.size(); ++d) json["deaths"].push_back(death_row(result.vehicles, d));
  for (std::size_t v = 0; v < kDriveVersions.size(); ++v)
    json["never_confirmed"][kDriveVersions[v]] =
        std::count_if(result.vehicles.begin(), result.vehicles.end(), [&](const VehicleDrive& vehicle) {
          return !outcome_of(vehicle, static_cast<DriveVersion>(v)).confirmed;
        });
  return json;
}

}  // namespace mirage
