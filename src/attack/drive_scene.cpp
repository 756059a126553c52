#include "attack/drive_scene.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "attack/clean_view.h"
#include "base/angles.h"
#include "base/error.h"
#include "base/interrupt.h"
#include "scene/data/read_frames.h"
#include "simulation/insertion.h"
#include "simulation/object_window.h"

namespace mirage {
namespace {

/// Boxes with identities as tracks: each is confirmed, and coasts where no detection touches it.
std::vector<TrackState> tracks_of(const std::vector<Detection>& boxes, const std::vector<Detection>& found,
                                  const DriveScene& scene, const std::string& who) {
  std::vector<TrackState> tracks;
  for (const Detection& box : boxes) {
    if (box.identity < 0)
      throw InputError(who, "identities", "a box has none",
                       "answer with one a box, 0 or more, the same for the same object");
    TrackState state;
    state.id = box.identity;
    state.box = scene.upright(box.box);
    state.confirmed = true;
    state.score = box.score();
    for (std::size_t k = 0; k < found.size() && state.detection < 0; ++k)
      if (iou(found[k].box.bev, box.box.bev) > 0) state.detection = static_cast<int>(k);
    tracks.push_back(state);
  }
  return tracks;
}

/// By the tracker of these settings.
Tracks tracks_by(const TrackerSettings& settings, const DriveScene& scene, const Sights& sights) {
  const std::vector<SceneFrame>& frames = scene.frames();
  Tracker tracker(settings);
  Tracks tracks(frames.size());
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const Transform world_from_ego = laid_flat(frames[i].moment.world_from_ego);
    std::vector<TrackedDetection> found;
    for (const Detection& detection : sights[i])
      found.push_back({moved_flat(scene.upright(detection.box), world_from_ego), detection.score()});
    for (TrackState& state : tracker.step(frames[i].moment.time, found)) {
      state.box = moved_flat(state.box, world_from_ego.inverse());
      tracks[i].push_back(state);
    }
  }
  return tracks;
}

/// By the user's tracker, which reads kDetections.
Tracks tracks_by(Detector& tracker, const DriveScene& scene, const Sights& sights) {
  const std::vector<SceneFrame>& frames = scene.frames();
  Tracks tracks;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    std::vector<float> rows;
    for (const Detection& detection : sights[i]) {
      const Box3 box = scene.upright(detection.box);
      for (const double value : {box.bev.x, box.bev.y, box.bottom + box.height / 2, box.bev.length,
                                 box.bev.width, box.height, box.bev.yaw, detection.score()})
        rows.push_back(static_cast<float>(value));
    }
    Frame frame;
    frame.id = frames[i].id;
    frame.moment = frames[i].moment;
    frame.calibration = frames[i].calibration;
    SensorView view;
    view.frame = &frame;
    view.calibration = &frame.calibration;
    view.continues = i > 0;
    SensorData detections;
    detections.kind = SensorData::Kind::other;
    detections.name = kDetections;
    detections.values = rows;
    detections.shape = {static_cast<std::int64_t>(sights[i].size()), 8, 0};
    detections.time = frames[i].moment.time;
    view.others.push_back(detections);
    tracks.push_back(tracks_of(tracker.forward(view, 0, false), sights[i], scene, tracker.name()));
  }
  return tracks;
}

}  // namespace

DriveScene::DriveScene(const DetectorPool& detectors, FrameStore& store, const DriveRequest& request,
                       const Sequence& sequence)
    : detectors_(detectors),
      store_(store),
      request_(request),
      can_(detectors.front()->capabilities()),
      name_(sequence.name),
      road_(-store.get(sequence.frames.front().id)->lidar.height) {
  for (const SequenceFrame& frame : sequence.frames) {
    Annotations known = read_annotations(request.data, frame.id);
    frames_.push_back({frame.id, frame.moment, std::move(known.labels), std::move(known.calibration)});
  }
  clean_ = recorded();
  clean_tracks_ = follow(clean_);
}

Sights DriveScene::recorded() const {
  if (needs_all()) {
    const Riders nobody(frames_.size());
    return see({{Pass{&nobody, nullptr}}}, [] {}).front();
  }
  std::vector<HostId> frames;
  for (const SceneFrame& frame : frames_) frames.push_back({frame.id, 0});
  const CleanDetections clean = clean_detections(detectors_, store_, frames, request_.evaluation);
  Sights sights;
  for (const SceneFrame& frame : frames_) sights.push_back(clean.at(frame.id));
  return sights;
}

std::vector<Sights> DriveScene::see(const std::vector<Pass>& passes,
                                    const std::function<void()>& frame_done) const {
  std::vector<Sights> sights(passes.size(), Sights(frames_.size()));
  std::vector<std::vector<Lazy<Sweep>>> sweeps(passes.size());
  const auto reach = static_cast<std::size_t>(request_.settings.sweeps);
  const auto sweep_of = [this](const Pass& pass, std::size_t i) {
    const auto prepared = store_.get(frames_[i].id);
    const Carrier* carrier = (*pass.riders)[i].carrier;
    if (!carrier) return prepared->frame.sweep;
    const Placement placement = placement_of(request_.place, *carrier, prepared->frame.labels);
    return simulate(*prepared, placement, *pass.object, request_.simulation).sweep;
  };
  if (reach > 1)
    for (std::size_t p = 0; p < passes.size(); ++p)
      for (std::size_t i = 0; i < frames_.size(); ++i)
        sweeps[p].emplace_back([&sweep_of, &pass = passes[p], i] { return sweep_of(pass, i); });
  // Whether nothing of the object is in what the detector sees of the frame.
  const auto is_as_recorded = [&](const Pass& pass, std::size_t i) {
    if (can_.remembers || !pass.object) return false;
    const auto last = pass.riders->begin() + static_cast<std::ptrdiff_t>(i) + 1;
    return std::all_of(last - static_cast<std::ptrdiff_t>(std::min(i + 1, reach)), last,
                       [](const Rider& rider) { return !rider.carrier; });
  };
  std::optional<RenderedPictures> pictures;
  if (request_.renderer) pictures.emplace(*request_.renderer, request_.evaluation.expectation_seed);
  const auto look = [&](Detector& detector, std::size_t p, std::size_t i) {
    if (is_as_recorded(passes[p], i)) {
      sights[p][i] = clean_[i];
      return;
    }
    throw_if_interrupted(kVehiclesKept);
    sights[p][i] = seen(detector, i, passes[p], sweeps[p], pictures ? &*pictures : nullptr);
    if ((*passes[p].riders)[i].carrier) frame_done();
  };
  if (can_.remembers)
    for (std::size_t p = 0; p < passes.size(); ++p)
      for (std::size_t i = 0; i < frames_.size(); ++i) look(*detectors_.front(), p, i);
  else
    for_each_with_detector(detectors_, frames_.size(), [&](Detector& detector, std::size_t i) {
      for (std::size_t p = 0; p < passes.size(); ++p) look(detector, p, i);
    });
  return sights;
}

/// Returns of the frame and of those before it, in its `velo`.
Sweep DriveScene::merged(std::size_t i, const std::vector<Lazy<Sweep>>& sweeps) const {
  const std::size_t first = i + 1 - std::min(i + 1, static_cast<std::size_t>(request_.settings.sweeps));
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

std::vector<Detection> DriveScene::seen(Detector& detector, std::size_t i, const Pass& pass,
                                        const std::vector<Lazy<Sweep>>& sweeps,
                                        RenderedPictures* pictures) const {
  const Rider& rider = (*pass.riders)[i];
  const auto held = store_.get(frames_[i].id);
  const PreparedFrame& prepared = *held;
  Simulated simulated;
  CleanView as_recorded;
  SensorView view;
  if (rider.carrier) {
    const Placement placement = placement_of(request_.place, *rider.carrier, prepared.frame.labels);
    simulated = simulate(prepared, placement, *pass.object, request_.simulation);
    PixelRect changed = simulated.rect;
    if (pictures)
      changed = united(changed, pictures->correct({prepared, rider.host, placement, request_.simulation},
                                                  *pass.object, {-1, *pass.object}, simulated));
    view = view_of(prepared, simulated, can_);
    if (pictures) require_no_others(view);
    if (can_.why_whole.empty() && sweeps.empty()) {
      as_recorded = clean_view(prepared, simulated.rect);
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

Box3 DriveScene::upright(const Box3& box) const {
  constexpr double kUnknownHeight = 1.5;  // m, from the road up
  return box.height > 0 ? box : Box3{box.bev, road_, kUnknownHeight};
}

VersionTracks DriveScene::follow(const Sights& sights) const {
  VersionTracks tracks;
  TrackerSettings settings = request_.settings.tracker;
  const bool named = can_.remembers && std::any_of(sights.begin(), sights.end(), [](const auto& boxes) {
                       return !boxes.empty() && boxes.front().identity >= 0;
                     });
  if (request_.tracker)
    tracks.own = tracks_by(*request_.tracker, *this, sights);
  else if (named)
    for (const auto& boxes : sights) tracks.own.push_back(tracks_of(boxes, boxes, *this, "--detector"));
  else
    tracks.own = tracks_by(settings, *this, sights);
  const bool is_ours = !request_.tracker && !named;
  for (std::size_t d = 0; d < kDeaths.size(); ++d) {
    settings.death = kDeaths[d];
    if (!is_ours || settings.death != request_.settings.tracker.death)
      tracks.others[d] = tracks_by(settings, *this, sights);
  }
  return tracks;
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

}  // namespace mirage
