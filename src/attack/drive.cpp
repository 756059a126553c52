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
#include "base/lazy.h"
#include "base/names.h"
#include "base/progress.h"
#include "base/ranks.h"
#include "detection/average_precision.h"
#include "scene/data/kitti_results.h"
#include "scene/data/read_frames.h"
#include "simulation/insertion.h"
#include "simulation/object_window.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr const char* kKept = "finished vehicles are kept; run the same command again to go on";
/// m; boxes from above are given this height, from the road up.
constexpr double kUnknownHeight = 1.5;
constexpr double kHalfLane = 1.75;  // m to each side of straight ahead
constexpr double kLateWithin = 10;  // m within which a confirmation comes late
/// Vehicles that are judged together: they share what a detector makes of their frames as recorded, and an
/// interruption loses all of them.
constexpr std::size_t kTogether = 8;

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

/// What a detector finds in each frame of a scene.
using Sights = std::vector<std::vector<Detection>>;
/// The tracks that live in each frame of a scene, in `velo`.
using Tracks = std::vector<std::vector<TrackState>>;

/// By the tracker of these settings.
Tracks follow(const std::vector<SceneFrame>& scene, const Sights& sights, double road,
              const TrackerSettings& settings) {
  Tracker tracker(settings);
  Tracks tracks(scene.size());
  for (std::size_t i = 0; i < scene.size(); ++i) {
    const Transform world_from_ego = laid_flat(scene[i].moment.world_from_ego);
    std::vector<TrackedDetection> seen;
    for (const Detection& detection : sights[i])
      seen.push_back({moved_flat(upright_box(detection.box, road), world_from_ego), detection.score()});
    for (TrackState& state : tracker.step(scene[i].moment.time, seen)) {
      state.box = moved_flat(state.box, world_from_ego.inverse());
      tracks[i].push_back(state);
    }
  }
  return tracks;
}

/// Boxes with identities as tracks: each is confirmed, and coasts where no detection touches it.
std::vector<TrackState> tracks_of(const std::vector<Detection>& boxes, const std::vector<Detection>& found,
                                  double road, const std::string& who) {
  std::vector<TrackState> tracks;
  for (const Detection& box : boxes) {
    if (box.identity < 0)
      throw InputError(who, "identities", "a box has none",
                       "answer with one a box, 0 or more, the same for the same object");
    TrackState state;
    state.id = box.identity;
    state.box = upright_box(box.box, road);
    state.confirmed = true;
    state.score = box.score();
    for (std::size_t k = 0; k < found.size() && state.detection < 0; ++k)
      if (iou(found[k].box.bev, box.box.bev) > 0) state.detection = static_cast<int>(k);
    tracks.push_back(state);
  }
  return tracks;
}

/// By the user's tracker, which reads kDetections.
Tracks follow(const std::vector<SceneFrame>& scene, const Sights& sights, double road, Detector& tracker) {
  Tracks tracks(scene.size());
  for (std::size_t i = 0; i < scene.size(); ++i) {
    std::vector<float> rows;
    for (const Detection& detection : sights[i]) {
      const Box3 box = upright_box(detection.box, road);
      for (const double value : {box.bev.x, box.bev.y, box.bottom + box.height / 2, box.bev.length,
                                 box.bev.width, box.height, box.bev.yaw, detection.score()})
        rows.push_back(static_cast<float>(value));
    }
    Frame frame;
    frame.id = scene[i].id;
    frame.moment = scene[i].moment;
    frame.calibration = scene[i].calibration;
    SensorView view;
    view.frame = &frame;
    view.calibration = &frame.calibration;
    view.continues = i > 0;
    SensorData detections;
    detections.kind = SensorData::Kind::other;
    detections.name = kDetections;
    detections.values = rows;
    detections.shape = {static_cast<std::int64_t>(sights[i].size()), 8, 0};
    detections.time = scene[i].moment.time;
    view.others.push_back(detections);
    tracks[i] = tracks_of(tracker.forward(view, 0, false), sights[i], road, tracker.name());
  }
  return tracks;
}

/// InputError where it is no tracker.
void check_tracker(const Detector& tracker) {
  const Capabilities can = tracker.capabilities();
  if (can.reads_image || can.reads_points || can.reads != std::vector<std::string>{kDetections})
    throw InputError("--tracker", tracker.name(), "does not read detections alone",
                     "let it say reads = (\"detections\",)");
  if (!can.remembers)
    throw InputError("--tracker", tracker.name(), "remembers nothing",
                     "give it new_sequence(), which is called where a sequence begins");
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
                const Sights& sights, const Tracks& tracks, int birth, VehicleDrive& vehicle) {
  const HidingRule& rule = kHidingRules.front();
  const auto v = static_cast<std::size_t>(version);
  std::set<int> phantoms;
  std::map<int, int> hits;  // of tracks on the vehicle, since it carries the object
  for (std::size_t i = 0; i < followed.frames.size(); ++i) {
    const std::size_t at = followed.frames[i];
    const BevBox& box = scene[at].labels[static_cast<std::size_t>(followed.labels[i])].box.bev;
    DriveSight& sight = vehicle.frames[i].sights[v];
    for (const Detection& detection : sights[at])
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
  std::string name;
  std::vector<SceneFrame> frames;
  Tracks clean_tracks;
  std::array<Tracks, kDeaths.size()> clean_by_death;
  std::vector<Vec3d> velocities;  ///< of the car
  double road = 0;                ///< m, z of the road in `velo`
};

/// The vehicle that carries the object in a frame; null where it is not followed.
struct Rider {
  const Carrier* carrier = nullptr;
  HostId host;
};
/// By the place of a frame in its scene.
using Riders = std::vector<Rider>;

/// One way through a scene: an object on one vehicle, or nothing on any.
struct Pass {
  const Riders* riders = nullptr;
  const TexturedMesh* object = nullptr;
};

/// Looks at the frames of a scene, with an object on one vehicle or as recorded.
class Watch {
 public:
  Watch(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request,
        const std::vector<SceneFrame>& scene)
      : detectors_(detectors),
        store_(store),
        request_(request),
        scene_(scene),
        can_(detectors.front()->capabilities()) {}

  /// Whether a frame's answer depends on others.
  bool needs_all() const { return can_.remembers || request_.settings.sweeps > 1; }

  /// What the detector finds in each frame as recorded.
  Sights recorded() const {
    if (needs_all()) {
      const Riders nobody(scene_.size());
      return see({{Pass{&nobody, nullptr}}}, [] {}).front();
    }
    std::vector<HostId> frames;
    for (const SceneFrame& frame : scene_) frames.push_back({frame.id, 0});
    const CleanDetections clean = clean_detections(detectors_, store_, frames, request_.evaluation);
    Sights sights;
    for (const SceneFrame& frame : scene_) sights.push_back(clean.at(frame.id));
    return sights;
  }

  /// The same of each pass. Passes go through a frame one after the other, so that what a detector makes of
  /// the frame without an object serves them all.
  std::vector<Sights> see(const std::vector<Pass>& passes, const std::function<void()>& frame_done) const {
    std::vector<Sights> sights(passes.size(), Sights(scene_.size()));
    std::vector<std::vector<Lazy<Sweep>>> sweeps(passes.size());
    if (request_.settings.sweeps > 1)
      for (std::size_t p = 0; p < passes.size(); ++p)
        for (std::size_t i = 0; i < scene_.size(); ++i)
          sweeps[p].emplace_back(
              [this, pass = passes[p], i] { return sweep_of(i, (*pass.riders)[i].carrier, pass.object); });
    std::optional<RenderedPictures> pictures;
    if (request_.renderer) pictures.emplace(*request_.renderer, request_.evaluation.expectation_seed);
    const auto look = [&](Detector& detector, std::size_t p, std::size_t i) {
      const Rider& rider = (*passes[p].riders)[i];
      if (is_as_recorded(passes[p], i)) {
        sights[p][i] = scene_[i].clean;
        return;
      }
      throw_if_interrupted(kKept);
      sights[p][i] = seen(detector, i, rider, passes[p].object, sweeps[p], pictures ? &*pictures : nullptr);
      if (rider.carrier) frame_done();
    };
    if (can_.remembers)
      for (std::size_t p = 0; p < passes.size(); ++p)
        for (std::size_t i = 0; i < scene_.size(); ++i) look(*detectors_.front(), p, i);
    else
      for_each_with_detector(detectors_, scene_.size(), [&](Detector& detector, std::size_t i) {
        for (std::size_t p = 0; p < passes.size(); ++p) look(detector, p, i);
      });
    return sights;
  }

 private:
  /// Whether nothing of the object is in what the detector sees of the frame.
  bool is_as_recorded(const Pass& pass, std::size_t i) const {
    if (can_.remembers || !pass.object) return false;
    const auto last = pass.riders->begin() + static_cast<std::ptrdiff_t>(i) + 1;
    const auto count = std::min<std::ptrdiff_t>(last - pass.riders->begin(), request_.settings.sweeps);
    return std::all_of(last - count, last, [](const Rider& rider) { return !rider.carrier; });
  }

  Sweep sweep_of(std::size_t i, const Carrier* carrier, const TexturedMesh* object) const {
    const auto prepared = store_.get(scene_[i].id);
    if (!carrier) return prepared->frame.sweep;
    return simulate(*prepared, placement_of(request_.place, *carrier), *object, request_.simulation).sweep;
  }

  /// Returns of the frame and of those before it, in its `velo`.
  Sweep merged(std::size_t i, const std::vector<Lazy<Sweep>>& sweeps) const {
    const std::size_t first = i + 1 - std::min(i + 1, static_cast<std::size_t>(request_.settings.sweeps));
    Sweep together;
    for (std::size_t k = first; k <= i; ++k) {
      const Transform moved = scene_[i].moment.world_from_ego.inverse() * scene_[k].moment.world_from_ego;
      for (const LidarPoint& point : sweeps[k].get()) {
        const Vec3f at = (moved * point.position().cast<double>()).cast<float>();
        together.push_back({at.x(), at.y(), at.z(), point.reflectance});
      }
    }
    return together;
  }

  std::vector<Detection> seen(Detector& detector, std::size_t i, const Rider& rider,
                              const TexturedMesh* object, const std::vector<Lazy<Sweep>>& sweeps,
                              RenderedPictures* pictures) const {
    const auto held = store_.get(scene_[i].id);
    const PreparedFrame& prepared = *held;
    Simulated simulated;
    CleanView as_recorded;
    SensorView view;
    if (rider.carrier) {
      const Placement placement = placement_of(request_.place, *rider.carrier);
      simulated = simulate(prepared, placement, *object, request_.simulation);
      PixelRect changed = simulated.rect;
      if (pictures)
        changed = united(changed, pictures->correct({prepared, rider.host, placement, request_.simulation},
                                                    *object, {-1, *object}, simulated));
      view = view_of(prepared, simulated, can_);
      if (pictures) require_no_others(view);
      if (can_.why_whole.empty() && sweeps.empty()) {
        as_recorded = clean_view(prepared, simulated);
        as_recorded.changed = changed;
        view.clean = &as_recorded;
      }
    } else {
      view = view_of(prepared.frame);
    }
    view.continues = i > 0;
    Sweep together;
    if (!sweeps.empty()) view.points = together = merged(i, sweeps);
    return detections(detector, view, request_.evaluation);
  }

  const DetectorPool& detectors_;
  FrameStore& store_;
  const DriveRequest& request_;
  const std::vector<SceneFrame>& scene_;
  Capabilities can_;
};

/// By whoever tracks: the detector itself, the user's tracker, or ours.
Tracks tracks_by(const DriveRequest& request, const Capabilities& can, const std::vector<SceneFrame>& scene,
                 const Sights& sights, double road) {
  if (request.tracker) return follow(scene, sights, road, *request.tracker);
  const bool named = can.remembers && std::any_of(sights.begin(), sights.end(), [](const auto& boxes) {
                       return !boxes.empty() && boxes.front().identity >= 0;
                     });
  if (!named) return follow(scene, sights, road, request.settings.tracker);
  Tracks tracks;
  for (const auto& boxes : sights) tracks.push_back(tracks_of(boxes, boxes, road, "--detector"));
  return tracks;
}

/// Detections that confirm a track on a vehicle: a tracker of the user's confirms by its own rule.
int birth_of(const DriveRequest& request, const Capabilities& can) {
  return request.tracker || can.remembers ? 1 : request.settings.tracker.birth;
}

/// To a millimetre.
nlohmann::json row_of(const Box3& box, double last) {
  nlohmann::json row;
  for (const double value :
       {box.bev.x, box.bev.y, box.bottom, box.bev.length, box.bev.width, box.height, box.bev.yaw, last})
    row.push_back(std::round(1e3 * value) / 1e3);
  return row;
}

/// See DriveRequest::folder.
nlohmann::json shown(const Followed& followed, const Sights& sights, const Tracks& tracks, double road) {
  nlohmann::json json = {{"boxes", nlohmann::json::array()}, {"tracks", nlohmann::json::array()}};
  for (const std::size_t at : followed.frames) {
    auto boxes = nlohmann::json::array(), of_tracks = nlohmann::json::array();
    for (const Detection& found : sights[at])
      boxes.push_back(row_of(upright_box(found.box, road), found.score()));
    for (const TrackState& track : tracks[at]) {
      if (!track.confirmed) continue;
      of_tracks.push_back(row_of(track.box, track.detection >= 0 ? 1 : 0));
      of_tracks.back().insert(of_tracks.back().begin(), track.id);
    }
    json["boxes"].push_back(boxes);
    json["tracks"].push_back(of_tracks);
  }
  return json;
}

/// A vehicle, and what its file holds besides.
struct JudgedVehicle {
  VehicleDrive vehicle;
  nlohmann::json shown;
};

/// A vehicle's ride through its scene, and where it is in it.
struct Driver {
  const Followed* followed = nullptr;
  Ride ride;
  Riders riders;
};

Driver driver_of(FrameStore& store, const DriveScene& scene, const Followed& followed) {
  std::vector<std::pair<Moment, HostId>> frames;
  for (std::size_t i = 0; i < followed.frames.size(); ++i) {
    const SceneFrame& frame = scene.frames[followed.frames[i]];
    frames.push_back({frame.moment, {frame.id, followed.labels[i]}});
  }
  Driver driver{&followed, ride(store, frames), Riders(scene.frames.size())};
  for (std::size_t i = 0; i < frames.size(); ++i)
    driver.riders[followed.frames[i]] = {&driver.ride.carriers[i], frames[i].second};
  return driver;
}

/// All but what was seen of it.
VehicleDrive unseen_drive(const DriveScene& scene, const Driver& driver) {
  const auto& [followed, ridden, riders] = driver;
  VehicleDrive vehicle;
  vehicle.sequence = scene.name;
  vehicle.track = followed->track;
  vehicle.type = ridden.carriers.front().label.type;
  vehicle.fitted = ridden.fitted;
  vehicle.residual_m = ridden.residual_m;
  vehicle.residual_deg = ridden.residual_rad / kDegree;
  vehicle.fit_jitter_m = ridden.fit_jitter_m;
  vehicle.jitter_m = ridden.jitter_m;
  vehicle.in_box_m = ridden.in_box_m;
  vehicle.in_box_deg = ridden.in_box_rad / kDegree;
  for (std::size_t i = 0; i < followed->frames.size(); ++i) {
    const std::size_t at = followed->frames[i];
    const Moment& moment = scene.frames[at].moment;
    const BevBox& box = scene.frames[at].labels[static_cast<std::size_t>(followed->labels[i])].box.bev;
    DriveFrame frame;
    frame.index = moment.index;
    frame.time = moment.time;
    frame.range = std::hypot(box.x, box.y);
    frame.nearest = frame.range;
    for (const Vec2d& corner : corners(box)) frame.nearest = std::min(frame.nearest, corner.norm());
    const Vec3d relative =
        moment.world_from_ego.linear().transpose() * (ridden.velocities[i] - scene.velocities[at]);
    if (frame.range > 0) frame.closing = -(relative.x() * box.x + relative.y() * box.y) / frame.range;
    vehicle.frames.push_back(frame);
  }
  return vehicle;
}

/// Vehicles of one scene, together.
std::vector<JudgedVehicle> judge_vehicles(const DetectorPool& detectors, FrameStore& store,
                                          const DriveRequest& request, const DriveScene& scene,
                                          const std::vector<const Followed*>& vehicles,
                                          const std::function<void()>& frame_done) {
  std::vector<Driver> drivers;
  drivers.reserve(vehicles.size());
  for (const Followed* followed : vehicles) drivers.push_back(driver_of(store, scene, *followed));
  const std::array objects = {std::pair(DriveVersion::attacked, &request.object),
                              std::pair(DriveVersion::random, &request.random)};
  std::vector<Pass> passes;
  for (const Driver& driver : drivers)
    for (const auto& [version, object] : objects) passes.push_back({&driver.riders, object});
  const std::vector<Sights> seen = Watch(detectors, store, request, scene.frames).see(passes, frame_done);
  const Capabilities can = detectors.front()->capabilities();
  const TrackerSettings& settings = request.settings.tracker;
  Sights as_recorded;
  for (const SceneFrame& frame : scene.frames) as_recorded.push_back(frame.clean);
  std::vector<JudgedVehicle> all;
  for (std::size_t k = 0; k < drivers.size(); ++k) {
    const Followed& followed = *drivers[k].followed;
    JudgedVehicle judged{unseen_drive(scene, drivers[k]), {}};
    VehicleDrive& vehicle = judged.vehicle;
    const auto judge = [&](DriveVersion version, const Sights& sights, const Tracks& tracks,
                           const auto& tracks_by_death) {
      add_sights(version, scene.frames, followed, sights, tracks, birth_of(request, can), vehicle);
      judged.shown[kDriveVersions[static_cast<std::size_t>(version)]] =
          shown(followed, sights, tracks, scene.road);
      for (std::size_t d = 0; d < kDeaths.size(); ++d) {
        VehicleDrive other = vehicle;
        for (DriveFrame& frame : other.frames) frame.sights = {};
        add_sights(version, scene.frames, followed, sights, tracks_by_death(d), settings.birth, other);
        const DriveOutcome outcome = outcome_of(other, version);
        const auto v = static_cast<std::size_t>(version);
        vehicle.deaths[d].track_gap_s[v] = outcome.track_gap_s;
        vehicle.deaths[d].phantom_frames[v] = outcome.phantom_frames;
      }
    };
    judge(DriveVersion::clean, as_recorded, scene.clean_tracks,
          [&](std::size_t d) { return scene.clean_by_death[d]; });
    for (std::size_t o = 0; o < objects.size(); ++o) {
      const Sights& sights = seen[k * objects.size() + o];
      judge(objects[o].first, sights, tracks_by(request, can, scene.frames, sights, scene.road),
            [&](std::size_t d) {
              return follow(scene.frames, sights, scene.road, with_death(settings, kDeaths[d]));
            });
    }
    all.push_back(std::move(judged));
  }
  return all;
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
  scene.name = sequence.name;
  for (const SequenceFrame& frame : sequence.frames) {
    Annotations known = read_annotations(request.data, frame.id);
    scene.frames.push_back(
        {frame.id, frame.moment, std::move(known.labels), std::move(known.calibration), {}});
  }
  const Sights sights = Watch(detectors, store, request, scene.frames).recorded();
  for (std::size_t i = 0; i < sights.size(); ++i) scene.frames[i].clean = sights[i];
  scene.road = -store.get(sequence.frames.front().id)->lidar.height;
  scene.clean_tracks =
      tracks_by(request, detectors.front()->capabilities(), scene.frames, sights, scene.road);
  for (std::size_t d = 0; d < kDeaths.size(); ++d)
    scene.clean_by_death[d] =
        follow(scene.frames, sights, scene.road, with_death(request.settings.tracker, kDeaths[d]));
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

/// s that the object adds to the longest gap of detection.
double added_gap(const VehicleDrive& vehicle) {
  return outcome_of(vehicle, DriveVersion::attacked).gap_s - outcome_of(vehicle, DriveVersion::clean).gap_s;
}

double gap_of(const DriveOutcome& of) {
  return of.gap_s;
}
double track_gap_of(const DriveOutcome& of) {
  return of.track_gap_s;
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

Ride ride(FrameStore& store, std::span<const std::pair<Moment, HostId>> frames) {
  std::vector<RideFrame> found;
  for (const auto& [moment, host] : frames) found.push_back({moment, store.placement(host).carrier.value()});
  return ride(found);
}

DriveVehicles longest_hidden(const DriveResult& result, int count) {
  std::vector<const VehicleDrive*> hidden;
  for (const VehicleDrive& vehicle : result.vehicles)
    if (added_gap(vehicle) > 0) hidden.push_back(&vehicle);
  std::stable_sort(hidden.begin(), hidden.end(),
                   [](const auto* a, const auto* b) { return added_gap(*a) > added_gap(*b); });
  DriveVehicles chosen;
  for (const VehicleDrive* vehicle : hidden)
    if (static_cast<int>(chosen.size()) < count) chosen.emplace(vehicle->sequence, vehicle->track);
  return chosen;
}

nlohmann::json by_renderer(const DriveResult& result, const DriveResult& plain) {
  std::vector<VehicleDrive> same;
  for (const VehicleDrive& vehicle : result.vehicles)
    for (const VehicleDrive& other : plain.vehicles)
      if (other.sequence == vehicle.sequence && other.track == vehicle.track) same.push_back(other);
  nlohmann::json json = {{"gap_s", medians(result.vehicles, gap_of)},
                         {"track_gap_s", medians(result.vehicles, track_gap_of)},
                         {"raster_gap_s", medians(same, gap_of)}};
  ClusteredShare kept;
  for (std::size_t i = 0; i < same.size(); ++i) {
    json["vehicles"].push_back(to_json(result.vehicles[i]));
    kept.add(name_of(same[i]), added_gap(result.vehicles[i]) / added_gap(same[i]), 0, added_gap(same[i]));
  }
  json["kept"] = to_json(kept.mean_interval());
  return json;
}

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
  if (request.tracker) check_tracker(*request.tracker);
  const auto region = detectors.front()->region();
  DriveResult result;
  std::vector<TrackFrame> track_frames;
  std::vector<DriveScene> scenes;
  std::vector<std::pair<std::size_t, Followed>> vehicles;  // each with its scene's place
  std::vector<std::vector<std::size_t>> groups;            // of vehicles that are judged together
  std::size_t frames = 0, done = 0;
  for (std::size_t s = 0; s < request.sequences.size(); ++s) {
    scenes.push_back(prepare_scene(detectors, store, request, request.sequences[s]));
    const DriveScene& scene = scenes.back();
    add_track_frames(scene, region, static_cast<int>(s), track_frames);
    result.frames += static_cast<int>(scene.frames.size());
    const bool alone = Watch(detectors, store, request, scene.frames).needs_all();  // each holds its sweeps
    std::size_t in_group = 0;
    for (Followed& vehicle : vehicles_of(scene.frames, region, request.settings.least_frames)) {
      if (request.only && !request.only->contains({scene.name, vehicle.track})) continue;
      frames += vehicle.frames.size();
      if (in_group++ % (alone ? 1 : kTogether) == 0) groups.emplace_back();
      groups.back().push_back(vehicles.size());
      vehicles.emplace_back(s, std::move(vehicle));
    }
  }
  const std::string key = request.made_of.identity();
  Progress progress("drive", 2 * frames, request.evaluation.quiet);
  std::mutex mutex;
  const auto frame_done = [&] {
    const std::lock_guard lock(mutex);
    progress.update(++done);
  };
  std::vector<VehicleDrive> judged(vehicles.size());
  for (const std::size_t g : order_among_ranks(groups.size())) {
    throw_if_interrupted(kKept);
    const DriveScene& scene = scenes[vehicles[groups[g].front()].first];
    const auto file_of = [&](std::size_t k) {
      const std::string name = fmt::format("{}_{}.json", escape_name(scene.name), vehicles[k].second.track);
      return request.folder.empty() ? fs::path() : request.folder / name;
    };
    std::vector<std::size_t> fresh;
    std::vector<const Followed*> of_group;
    for (const std::size_t k : groups[g]) {
      if (auto stored = stored_vehicle(file_of(k), key)) {
        progress.update(done += 2 * vehicles[k].second.frames.size());
        judged[k] = std::move(*stored);
      } else {
        fresh.push_back(k);
        of_group.push_back(&vehicles[k].second);
      }
    }
    if (fresh.empty()) continue;
    std::vector<JudgedVehicle> together =
        judge_vehicles(detectors, store, request, scene, of_group, frame_done);
    for (std::size_t i = 0; i < fresh.size(); ++i) {
      nlohmann::json kept = to_json(together[i].vehicle);
      kept["key"] = key;
      kept["shown"] = std::move(together[i].shown);
      if (const fs::path file = file_of(fresh[i]); !file.empty()) write_json(file, kept);
      judged[fresh[i]] = std::move(together[i].vehicle);
    }
  }
  result.vehicles = std::move(judged);
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
  json["gap_s"] = medians(result.vehicles, gap_of);
  json["track_gap_s"] = medians(result.vehicles, track_gap_of);
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
