#include "attack/drive.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <set>
#include <utility>

#include "base/disk_cache.h"
#include "base/error.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "base/types.h"
#include "detection/average_precision.h"
#include "scene/data/kitti_rows.h"
#include "simulation/insertion.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

/// A frame of a sequence before insertion.
struct SceneFrame {
  std::string id;
  Moment moment;
  std::vector<Label> labels;
  Calibration calibration;
};

/// Detections in each frame of a scene.
using SceneDetections = std::vector<std::vector<Detection>>;
/// The live tracks in each frame of a scene, in `velo`.
using Tracks = std::vector<std::vector<TrackState>>;

/// Tracks through one version of a scene: by the drive's own tracker, and by Mirage's tracker at each of
/// kDeaths.
struct VersionTracks {
  Tracks own;
  std::array<Tracks, kDeaths.size()> at_death;
};

/// The vehicle that carries the object in a frame; null if it is not tracked there.
struct FrameCarrier {
  const Carrier* carrier = nullptr;
  HostId host;
};
/// Indexed by frame of the scene.
using FrameCarriers = std::vector<FrameCarrier>;

/// One pass through a scene: an object on one vehicle, or no object.
struct Pass {
  const FrameCarriers* carriers = nullptr;
  const TexturedMesh* object = nullptr;
};

/// How to resume, for the message of Interrupted.
const char* how_to_go_on(const DriveRequest& request) {
  return request.goes_on ? "finished vehicles are kept; run the same command again to go on"
                         : "nothing is kept of a detector or tracker without a version; run it again";
}

/// One sequence of a drive, shared by all its vehicles: frames before insertion, detections in them (as
/// recorded or with an object on a vehicle), and the tracks. Its arguments must outlive it.
class DriveScene {
 public:
  /// Reads the sequence, and detects and tracks in it as recorded. InputError as judge_drive.
  DriveScene(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request,
             const Sequence& sequence)
      : detectors_(detectors),
        store_(store),
        request_(request),
        can_(detectors.front()->capabilities()),
        name_(sequence.name),
        road_(-store.get(sequence.frames.front().id)->lidar.height) {
    for (const SequenceFrame& frame : sequence.frames) {
      Annotations annotations = read_annotations(request.data, frame.id);
      frames_.push_back(
          {frame.id, frame.moment, std::move(annotations.labels), std::move(annotations.calibration)});
    }
    clean_ = recorded();
    clean_tracks_ = follow(clean_);
  }

  const std::string& name() const { return name_; }
  /// By rising time.
  const std::vector<SceneFrame>& frames() const { return frames_; }
  const SceneDetections& clean() const { return clean_; }              ///< as recorded
  const VersionTracks& clean_tracks() const { return clean_tracks_; }  ///< as recorded
  /// How boxes are compared with the vehicle's label.
  Matching matching() const { return can_.matching(); }
  /// Whether a frame's detections depend on other frames.
  bool needs_all() const { return can_.remembers || request_.settings.sweeps > 1; }
  /// Detections that confirm a track on a vehicle; 1 if another tracker confirms by its own rule.
  int birth() const { return request_.tracker || can_.remembers ? 1 : request_.settings.tracker.birth; }

  /// The detection's box; a bird's-eye box gets a default height.
  Box3 upright(const Box3& box) const {
    constexpr double kUnknownHeight = 1.5;  // m, from the road up
    return box.height > 0 ? box : Box3{box.bev, road_, kUnknownHeight};
  }

  /// Detections of each pass. All passes visit a frame before the next one, so that they share the detector's
  /// clean activations of it. Interrupted after Ctrl-C.
  std::vector<SceneDetections> see(const std::vector<Pass>& passes,
                                   const std::function<void()>& frame_done) const {
    std::vector<SceneDetections> scene_detections(passes.size(), SceneDetections(frames_.size()));
    std::vector<std::vector<Lazy<Sweep>>> sweeps(passes.size());
    const auto reach = as_size(request_.settings.sweeps);
    const auto sweep_of = [this](const Pass& pass, std::size_t i) {
      const auto prepared = store_.get(frames_[i].id);
      const Carrier* carrier = (*pass.carriers)[i].carrier;
      if (!carrier) return prepared->frame.sweep;
      const Placement placement = placement_of(request_.place, *carrier, prepared->frame.labels);
      return simulate(*prepared, placement, *pass.object, request_.simulation).sweep;
    };
    if (reach > 1)
      for (std::size_t p = 0; p < passes.size(); ++p)
        for (std::size_t i = 0; i < frames_.size(); ++i)
          sweeps[p].emplace_back([&sweep_of, &pass = passes[p], i] { return sweep_of(pass, i); });
    // Whether the detector's input for the frame contains nothing of the object.
    const auto is_as_recorded = [&](const Pass& pass, std::size_t i) {
      if (can_.remembers || !pass.object) return false;
      const auto last = pass.carriers->begin() + static_cast<std::ptrdiff_t>(i) + 1;
      return std::all_of(last - static_cast<std::ptrdiff_t>(std::min(i + 1, reach)), last,
                         [](const FrameCarrier& at) { return !at.carrier; });
    };
    std::optional<RenderedPictures> pictures;
    if (request_.renderer) pictures.emplace(*request_.renderer, request_.evaluation.expectation_seed);
    const auto detect = [&](Detector& detector, std::size_t p, std::size_t i) {
      if (is_as_recorded(passes[p], i)) {
        scene_detections[p][i] = clean_[i];
        return;
      }
      throw_if_interrupted(how_to_go_on(request_));
      scene_detections[p][i] = seen(detector, i, passes[p], sweeps[p], pictures ? &*pictures : nullptr);
      if ((*passes[p].carriers)[i].carrier) frame_done();
    };
    if (can_.remembers)
      for (std::size_t p = 0; p < passes.size(); ++p)
        for (std::size_t i = 0; i < frames_.size(); ++i) detect(*detectors_.front(), p, i);
    else
      for_each_with_detector(detectors_, frames_.size(), [&](Detector& detector, std::size_t i) {
        for (std::size_t p = 0; p < passes.size(); ++p) detect(detector, p, i);
      });
    return scene_detections;
  }

  /// Tracks; `own` are by the user's tracker, the detector itself, or Mirage's tracker.
  VersionTracks follow(const SceneDetections& scene_detections) const {
    VersionTracks tracks;
    TrackerSettings settings = request_.settings.tracker;
    const bool named = can_.remembers && std::ranges::any_of(scene_detections, [](const auto& boxes) {
                         return !boxes.empty() && boxes.front().identity >= 0;
                       });
    if (request_.tracker)
      tracks.own = tracks_by(*request_.tracker, scene_detections);
    else if (named)
      for (const auto& boxes : scene_detections) tracks.own.push_back(tracks_of(boxes, boxes, "--detector"));
    else
      tracks.own = tracks_by(settings, scene_detections);
    const bool is_ours = !request_.tracker && !named;
    for (std::size_t d = 0; d < kDeaths.size(); ++d) {
      settings.death = kDeaths[d];
      tracks.at_death[d] = is_ours && settings.death == request_.settings.tracker.death
                               ? tracks.own
                               : tracks_by(settings, scene_detections);
    }
    return tracks;
  }

 private:
  /// Boxes with identities as tracks: all are confirmed, and coast if no detection overlaps them.
  std::vector<TrackState> tracks_of(const std::vector<Detection>& boxes, const std::vector<Detection>& found,
                                    const std::string& who) const {
    std::vector<TrackState> tracks;
    for (const Detection& box : boxes) {
      if (box.identity < 0)
        throw InputError(who, "identities", "a box has none",
                         "answer with one a box, 0 or more, the same for the same object");
      TrackState state;
      state.id = box.identity;
      state.box = upright(box.box);
      state.confirmed = true;
      state.score = box.score();
      for (std::size_t k = 0; k < found.size() && state.detection < 0; ++k)
        if (iou(found[k].box.bev, box.box.bev) > 0) state.detection = static_cast<int>(k);
      tracks.push_back(state);
    }
    return tracks;
  }

  /// Tracks by Mirage's tracker with these settings.
  Tracks tracks_by(const TrackerSettings& settings, const SceneDetections& scene_detections) const {
    Tracker tracker(settings);
    Tracks tracks(frames_.size());
    for (std::size_t i = 0; i < frames_.size(); ++i) {
      const Transform world_from_ego = laid_flat(frames_[i].moment.world_from_ego);
      std::vector<TrackedDetection> found;
      for (const Detection& detection : scene_detections[i])
        found.push_back({moved_flat(upright(detection.box), world_from_ego), detection.score()});
      for (TrackState& state : tracker.step(frames_[i].moment.time, found)) {
        state.box = moved_flat(state.box, world_from_ego.inverse());
        tracks[i].push_back(state);
      }
    }
    return tracks;
  }

  /// Tracks by the user's tracker, which reads kDetections.
  Tracks tracks_by(Detector& tracker, const SceneDetections& scene_detections) const {
    Tracks tracks;
    for (std::size_t i = 0; i < frames_.size(); ++i) {
      std::vector<float> rows;
      for (const Detection& detection : scene_detections[i]) {
        const Box3 box = upright(detection.box);
        for (const double value : {box.bev.x, box.bev.y, box.bottom + box.height / 2, box.bev.length,
                                   box.bev.width, box.height, box.bev.yaw, detection.score()})
          rows.push_back(static_cast<float>(value));
      }
      Frame frame;
      frame.id = frames_[i].id;
      frame.moment = frames_[i].moment;
      frame.calibration = frames_[i].calibration;
      SensorView view;
      view.frame = &frame;
      view.calibration = &frame.calibration;
      view.continues = i > 0;
      SensorData detections;
      detections.kind = SensorData::Kind::other;
      detections.name = kDetections;
      detections.values = rows;
      detections.shape = {static_cast<std::int64_t>(scene_detections[i].size()), 8, 0};
      detections.time = frames_[i].moment.time;
      view.others.push_back(detections);
      tracks.push_back(tracks_of(tracker.forward(view, 0, false), scene_detections[i], tracker.name()));
    }
    return tracks;
  }

  SceneDetections recorded() const {
    if (needs_all()) {
      const FrameCarriers nobody(frames_.size());
      return see({{Pass{&nobody, nullptr}}}, [] {}).front();
    }
    std::vector<HostId> frames;
    for (const SceneFrame& frame : frames_) frames.push_back({frame.id, 0});
    const CleanDetections clean = clean_detections(detectors_, store_, frames, request_.evaluation);
    SceneDetections scene_detections;
    for (const SceneFrame& frame : frames_) scene_detections.push_back(clean.at(frame.id));
    return scene_detections;
  }

  /// Returns of the frame and of those before it, in its `velo`.
  Sweep merged(std::size_t i, const std::vector<Lazy<Sweep>>& sweeps) const {
    const std::size_t first = i + 1 - std::min(i + 1, as_size(request_.settings.sweeps));
    Sweep together;
    for (std::size_t k = first; k <= i; ++k) {
      const Transform moved = frames_[i].moment.world_from_ego.inverse() * frames_[k].moment.world_from_ego;
      for (const LidarPoint& point : sweeps[k].get()) {
        const Vec3f at = (moved * point.position().cast<double>()).cast<float>();
        together.push_back({at.x(), at.y(), at.z(), point.reflectance});
      }
    }
    return together;
  }

  std::vector<Detection> seen(Detector& detector, std::size_t i, const Pass& pass,
                              const std::vector<Lazy<Sweep>>& sweeps, RenderedPictures* pictures) const {
    const FrameCarrier& frame_carrier = (*pass.carriers)[i];
    const auto prepared = store_.get(frames_[i].id);
    const auto found = [&](SensorView view) {
      view.continues = i > 0;
      Sweep together;
      if (!sweeps.empty()) view.points = together = merged(i, sweeps);
      return detections(detector, view, request_.evaluation);
    };
    if (!frame_carrier.carrier) return found(view_of(prepared->frame));
    RenderedMesh rendered;  // iteration −1: its pictures are not cached
    if (pictures) rendered.mesh = *pass.object;
    const StepHost host{*prepared,
                        frame_carrier.host,
                        placement_of(request_.place, *frame_carrier.carrier, prepared->frame.labels),
                        {},
                        nullptr,
                        pictures,
                        &rendered};
    Observation shown(host, *pass.object, request_.simulation);
    return found(shown.view(can_, can_.why_whole.empty() && sweeps.empty()));
  }

  const DetectorPool& detectors_;
  FrameStore& store_;
  const DriveRequest& request_;
  Capabilities can_;
  std::string name_;
  std::vector<SceneFrame> frames_;
  double road_ = 0;  ///< m, its z in `velo`
  SceneDetections clean_;
  VersionTracks clean_tracks_;
};

constexpr double kHalfLane = 1.75;  // m to each side of straight ahead
/// Vehicles judged together: they share the detector's clean activations of their frames; an interruption
/// loses all of them.
constexpr std::size_t kVehiclesPerBatch = 8;

/// A vehicle of a sequence: its frames, and its label in each.
struct TrackedVehicle {
  int track = -1;
  std::vector<std::size_t> frames;  ///< by place in the sequence
  std::vector<int> labels;          ///< by place in that frame

  const Label& label(const DriveScene& scene, std::size_t i) const {
    return scene.frames()[frames[i]].labels[as_size(labels[i])];
  }
};

/// Labels of these types inside the detector's region (x_min, x_max, y_min, y_max; m).
struct Sought {
  const std::vector<std::string>& types;
  std::array<double, 4> region;
};

/// Whether the label is sought and has a track.
bool is_judged(const Label& label, const Sought& sought) {
  const BevBox& box = label.box.bev;
  const auto& region = sought.region;
  return label.track >= 0 && has_box(label) &&
         std::ranges::find(sought.types, label.type) != sought.types.end() && box.x >= region[0] &&
         box.x <= region[1] && box.y >= region[2] && box.y <= region[3];
}

std::vector<TrackedVehicle> vehicles_of(const std::vector<SceneFrame>& scene, const Sought& sought,
                                        int least_frames) {
  std::map<int, TrackedVehicle> followed;
  for (std::size_t i = 0; i < scene.size(); ++i)
    for (std::size_t k = 0; k < scene[i].labels.size(); ++k) {
      const Label& label = scene[i].labels[k];
      if (!is_judged(label, sought)) continue;
      TrackedVehicle& vehicle = followed[label.track];
      if (!vehicle.frames.empty() && vehicle.frames.back() == i)
        throw InputError("frame " + scene[i].id, "labels",
                         fmt::format("two are of the identity {}", label.track), "correct the labels");
      vehicle.track = label.track;
      vehicle.frames.push_back(i);
      vehicle.labels.push_back(static_cast<int>(k));
    }
  std::vector<TrackedVehicle> long_enough;
  for (auto& [track, vehicle] : followed)
    if (static_cast<int>(vehicle.frames.size()) >= least_frames) long_enough.push_back(std::move(vehicle));
  return long_enough;
}

/// InputError if it is no tracker.
void check_tracker(const Detector& tracker) {
  const Capabilities can = tracker.capabilities();
  if (can.reads_image || can.reads_points || can.reads != std::vector<std::string>{kDetections})
    throw InputError("--tracker", tracker.name(), "does not read detections alone",
                     "let it say reads = (\"detections\",)");
  if (!can.remembers)
    throw InputError("--tracker", tracker.name(), "remembers nothing",
                     "give it new_sequence(), which is called where a sequence begins");
}

/// Whether an object there would be labelled: the picture shows its box's centre, and no DontCare region
/// covers half of it or more.
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
  return std::ranges::none_of(frame.labels, [&](const Label& label) {
    return label.type == "DontCare" && intersection_area(*seen, picture_box(label)) >= area(*seen) / 2;
  });
}

bool is_phantom(const Box3& box, const DriveScene& scene, std::size_t at, DriveVersion version) {
  const SceneFrame& frame = scene.frames()[at];
  const auto touches = [&](const Box3& other) { return iou(box.bev, other.bev) > 0; };
  return would_be_labelled(box, frame) &&
         std::ranges::none_of(frame.labels,
                              [&](const Label& label) {
                                return is_road_user(label) && has_box(label) && touches(label.box);
                              }) &&
         (version == DriveVersion::clean ||
          std::ranges::none_of(scene.clean()[at],
                               [&](const Detection& detection) { return touches(detection.box); }));
}

/// Velocity of the ego car in the world at frame i, m/s; at least two frames.
Vec3d ego_velocity(const std::vector<SceneFrame>& frames, std::size_t i) {
  const Moment &before = frames[i > 0 ? i - 1 : 0].moment,
               &after = frames[std::min(i + 1, frames.size() - 1)].moment;
  return (after.world_from_ego.translation() - before.world_from_ego.translation()) /
         (after.time - before.time);
}

/// Fills in the vehicle's observations in one version.
void set_observations(DriveVersion version, const DriveScene& scene, const TrackedVehicle& followed,
                      const SceneDetections& scene_detections, const Tracks& tracks, int birth,
                      VehicleDrive& vehicle) {
  const double least = kVanished.iou;
  std::set<int> phantoms;
  std::map<int, int> hits;  // by track on the vehicle, since it carries the object
  for (std::size_t i = 0; i < followed.frames.size(); ++i) {
    const std::size_t at = followed.frames[i];
    const ObjectBoxes truth = boxes_of(followed.label(scene, i));
    const auto is_on_it = [&](const ObjectBoxes& boxes) {
      return scene.matching().overlap(boxes, truth) > least;
    };
    DriveObservation& observation = vehicle.frames[i].observations[version] = {};
    for (const Detection& detection : scene_detections[at])
      observation.found = observation.found || is_on_it(detection);
    for (const TrackState& track : tracks[at]) {
      if (is_on_it({track.box, {}})) {
        hits[track.id] += track.detection >= 0;
        if (!track.confirmed || hits[track.id] < birth) continue;
        if (track.detection >= 0)
          observation.track = TrackStatus::found;
        else if (observation.track == TrackStatus::lost)
          observation.track = TrackStatus::coasting;
      } else if (track.confirmed && is_phantom(track.box, scene, at, version)) {
        ++observation.phantoms;
        phantoms.insert(track.id);
        const BevBox& where = track.box.bev;
        observation.phantom_in_lane =
            observation.phantom_in_lane || (where.x > 0 && std::abs(where.y) < kHalfLane);
      }
    }
  }
  vehicle.phantom_tracks[version] = static_cast<int>(phantoms.size());
}

/// Box and `last` as a row, rounded to 0.001.
nlohmann::json row_of(const Box3& box, double last) {
  nlohmann::json row;
  for (const double value :
       {box.bev.x, box.bev.y, box.bottom, box.bev.length, box.bev.width, box.height, box.bev.yaw, last})
    row.push_back(std::round(1e3 * value) / 1e3);
  return row;
}

/// Boxes and tracks for DriveRequest::folder.
nlohmann::json shown(const DriveScene& scene, const TrackedVehicle& followed,
                     const SceneDetections& scene_detections, const Tracks& tracks) {
  nlohmann::json json = {{"boxes", nlohmann::json::array()}, {"tracks", nlohmann::json::array()}};
  for (const std::size_t at : followed.frames) {
    auto boxes = nlohmann::json::array(), of_tracks = nlohmann::json::array();
    for (const Detection& found : scene_detections[at])
      boxes.push_back(row_of(scene.upright(found.box), found.score()));
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

/// A vehicle's roof track, and its carrier in each frame.
struct Driver {
  RoofTrack roof_track;
  FrameCarriers carriers;
};

Driver driver_of(FrameStore& store, const DriveScene& scene, const TrackedVehicle& followed) {
  std::vector<std::pair<Moment, HostId>> frames;
  for (std::size_t i = 0; i < followed.frames.size(); ++i) {
    const SceneFrame& frame = scene.frames()[followed.frames[i]];
    frames.push_back({frame.moment, {frame.id, followed.labels[i]}});
  }
  Driver driver{roof_track(store, frames), FrameCarriers(scene.frames().size())};
  for (std::size_t i = 0; i < frames.size(); ++i)
    driver.carriers[followed.frames[i]] = {&driver.roof_track.carriers[i], frames[i].second};
  return driver;
}

/// The vehicle without its observations.
VehicleDrive unseen_drive(const DriveScene& scene, const TrackedVehicle& followed, const RoofTrack& roof) {
  VehicleDrive vehicle;
  vehicle.sequence = scene.name();
  vehicle.track = followed.track;
  vehicle.type = roof.carriers.front().label.type;
  vehicle.roof = roof.fit;
  for (std::size_t i = 0; i < followed.frames.size(); ++i) {
    const std::size_t at = followed.frames[i];
    const Moment& moment = scene.frames()[at].moment;
    const BevBox& box = followed.label(scene, i).box.bev;
    DriveFrame frame;
    frame.index = moment.index;
    frame.time = moment.time;
    frame.range = horizontal_distance(box);
    frame.nearest = frame.range;
    for (const Vec2d& corner : corners(box)) frame.nearest = std::min(frame.nearest, corner.norm());
    const Vec3d relative =
        moment.world_from_ego.linear().transpose() * (roof.velocities[i] - ego_velocity(scene.frames(), at));
    if (frame.range > 0) frame.closing = -(relative.x() * box.x + relative.y() * box.y) / frame.range;
    vehicle.frames.push_back(frame);
  }
  return vehicle;
}

/// Where a finished vehicle is written; empty: nowhere.
fs::path file_of(const DriveRequest& request, const DriveScene& scene, int track) {
  if (request.folder.empty()) return {};
  return request.folder / (vehicle_name(scene.name(), track) + ".json");
}

/// The vehicle's stored result if it may be reused, has the same key and is complete; otherwise nullopt.
std::optional<VehicleDrive> stored_vehicle(const DriveRequest& request, const fs::path& file,
                                           const std::string& key) {
  if (!request.goes_on) return std::nullopt;
  return read_cached(file, key,
                     [](const JsonFields& fields) { return std::optional(read_vehicle_drive(fields)); });
}

/// A tracked vehicle and its result.
struct Judged {
  TrackedVehicle followed;
  VehicleDrive vehicle;
};

/// Judges vehicles of one scene together, and stores each result.
void judge_vehicles(FrameStore& store, const DriveRequest& request, const DriveScene& scene,
                    const std::vector<Judged*>& together, const std::function<void()>& frame_done) {
  const std::array objects = {std::pair(DriveVersion::attacked, &request.object),
                              std::pair(DriveVersion::random, &request.random)};
  std::vector<Driver> drivers;
  for (const Judged* judged : together) drivers.push_back(driver_of(store, scene, judged->followed));
  std::vector<Pass> passes;
  for (const Driver& driver : drivers)
    for (const auto& [version, object] : objects) passes.push_back({&driver.carriers, object});
  const std::vector<SceneDetections> seen = scene.see(passes, frame_done);
  for (std::size_t k = 0; k < together.size(); ++k) {
    const TrackedVehicle& followed = together[k]->followed;
    VehicleDrive& vehicle = together[k]->vehicle;
    vehicle = unseen_drive(scene, followed, drivers[k].roof_track);
    nlohmann::json showed;
    const auto judge = [&](DriveVersion version, const SceneDetections& scene_detections,
                           const VersionTracks& tracks) {
      set_observations(version, scene, followed, scene_detections, tracks.own, scene.birth(), vehicle);
      showed[to_word(version)] = shown(scene, followed, scene_detections, tracks.own);
      VehicleDrive other = vehicle;
      for (std::size_t d = 0; d < kDeaths.size(); ++d) {
        set_observations(version, scene, followed, scene_detections, tracks.at_death[d],
                         request.settings.tracker.birth, other);
        const DriveOutcome outcome = outcome_of(other, version);
        vehicle.deaths[d].track_gap_s[version] = outcome.track_gap_s;
        vehicle.deaths[d].phantom_frames[version] = outcome.phantom_frames;
      }
    };
    judge(DriveVersion::clean, scene.clean(), scene.clean_tracks());
    for (std::size_t o = 0; o < objects.size(); ++o) {
      const SceneDetections& scene_detections = seen[k * objects.size() + o];
      judge(objects[o].first, scene_detections, scene.follow(scene_detections));
    }
    if (const fs::path file = file_of(request, scene, followed.track); !file.empty()) {
      nlohmann::json record = to_json(vehicle);
      record["key"] = request.provenance.identity();
      record["shown"] = std::move(showed);
      write_json(file, record);
    }
  }
}

/// Truths and tracks of a sequence as recorded. Identities of several sequences are kept apart by `sequence`.
void add_track_frames(const DriveScene& scene, const Sought& sought, int sequence,
                      std::vector<TrackFrame>& frames) {
  constexpr int kTracksOfSequence = 1 << 20;
  for (std::size_t i = 0; i < scene.frames().size(); ++i) {
    std::vector<BevBox> boxes, tracks;
    TrackFrame frame;
    for (const Label& label : scene.frames()[i].labels)
      if (is_judged(label, sought)) {
        frame.truths.push_back(label.track);
        boxes.push_back(label.box.bev);
      }
    for (const TrackState& track : scene.clean_tracks().own[i]) {
      if (!track.confirmed) continue;
      // As in the benchmark, tracks on unlabelled regions are no false alarms.
      const bool on_truth =
          std::ranges::any_of(boxes, [&](const BevBox& box) { return iou(box, track.box.bev) > 0; });
      if (!on_truth && !would_be_labelled(track.box, scene.frames()[i])) continue;
      frame.tracks.push_back(sequence * kTracksOfSequence + track.id);
      tracks.push_back(track.box.bev);
    }
    frame.similarity = Eigen::MatrixXd::NullaryExpr(
        static_cast<Eigen::Index>(boxes.size()), static_cast<Eigen::Index>(tracks.size()),
        [&](Eigen::Index t, Eigen::Index k) { return iou(boxes[as_size(t)], tracks[as_size(k)]); });
    frames.push_back(std::move(frame));
  }
}

/// Why the vehicle is left out. One frame without room suffices, since the object keeps its place.
LeftOut left_out_of(const PlaceChoice& place, const DriveScene& scene, const TrackedVehicle& vehicle) {
  for (std::size_t i = 0; i < vehicle.frames.size(); ++i) {
    const Carrier carrier{.label = vehicle.label(scene, i)};
    const LeftOut why = placement_of(place, carrier, scene.frames()[vehicle.frames[i]].labels).left_out;
    if (why != LeftOut::no) return why;
  }
  return LeftOut::no;
}

/// Vehicles of one scene that are judged together.
struct Group {
  const DriveScene* scene = nullptr;
  std::vector<Judged> vehicles;
};

}  // namespace

Transform laid_flat(const Transform& pose) {
  return upright_pose({pose.translation().x(), pose.translation().y(), 0}, heading_of(pose));
}

Box3 moved_flat(const Box3& box, const Transform& pose) {
  const Vec3d at = pose * Vec3d(box.bev.x, box.bev.y, box.bottom);
  const double yaw = wrap_angle(box.bev.yaw + heading_of(pose));
  return {{at.x(), at.y(), box.bev.length, box.bev.width, yaw}, at.z(), box.height};
}

DriveResult judge_drive(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request) {
  const Capabilities can = detectors.front()->capabilities();
  if (!can.finds_bev)
    throw InputError("--detector", detectors.front()->name(),
                     "finds boxes in the picture alone, which have no place in the world",
                     "use a detector of boxes in space: lidar, fusion, …");
  if (can.matching().in_picture())
    throw FieldError("matching", can.matching().name(),
                     "compares boxes in the picture, and a drive follows them in the world",
                     "use bev, 3d or centre");
  if (request.tracker) check_tracker(*request.tracker);
  const Sought sought{request.types, detectors.front()->region()};
  DriveResult result;
  std::vector<TrackFrame> track_frames;
  std::vector<DriveScene> scenes;
  scenes.reserve(request.sequences.size());
  std::vector<Group> groups;
  std::size_t frames = 0;
  for (const Sequence& sequence : request.sequences) {
    const DriveScene& scene = scenes.emplace_back(detectors, store, request, sequence);
    add_track_frames(scene, sought, static_cast<int>(scenes.size()) - 1, track_frames);
    result.frames += static_cast<int>(scene.frames().size());
    const std::size_t together = scene.needs_all() ? 1 : kVehiclesPerBatch;  // each holds its sweeps
    std::size_t in_group = 0;
    for (TrackedVehicle& vehicle : vehicles_of(scene.frames(), sought, request.settings.least_frames)) {
      if (request.only && !request.only->contains({scene.name(), vehicle.track})) continue;
      const LeftOut why = left_out_of(request.place, scene, vehicle);
      result.left_out.add(why);
      if (why != LeftOut::no) continue;
      frames += vehicle.frames.size();
      if (in_group++ % together == 0) groups.push_back({&scene, {}});
      groups.back().vehicles.push_back({std::move(vehicle), {}});
    }
  }
  const std::string key = request.provenance.identity();
  Progress progress("drive", 2 * frames, request.evaluation.quiet);
  const auto frame_done = [&] { progress.add(); };
  for (const std::size_t g : order_among_ranks(groups.size())) {
    throw_if_interrupted(how_to_go_on(request));
    auto& [scene, of_group] = groups[g];
    std::vector<Judged*> fresh;
    for (Judged& judged : of_group) {
      if (auto stored = stored_vehicle(request, file_of(request, *scene, judged.followed.track), key)) {
        progress.add(2 * judged.followed.frames.size());
        judged.vehicle = std::move(*stored);
      } else {
        fresh.push_back(&judged);
      }
    }
    if (!fresh.empty()) judge_vehicles(store, request, *scene, fresh, frame_done);
  }
  for (Group& group : groups)
    for (Judged& judged : group.vehicles) result.vehicles.push_back(std::move(judged.vehicle));
  if (rank() == 0) warn_of_left_out(request.place, result.left_out);
  if (result.vehicles.empty()) refuse_left_out(request.place, result.left_out);
  if (result.vehicles.empty())
    throw InputError(request.data.string(), "labels",
                     fmt::format("no {} is followed through {} frames in the detector's region",
                                 fmt::join(request.types, " or "), request.settings.least_frames),
                     "give more frames or lower --least-frames");
  result.clean = score_tracks(track_frames);
  return result;
}

}  // namespace mirage
