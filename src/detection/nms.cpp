#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include "base/error.h"
#include "detection/detector.h"

namespace mirage {

Matching Capabilities::matching() const {
  return {judged_by != MatchBy::own ? judged_by : finds_bev ? MatchBy::bev : MatchBy::picture};
}

bool Capabilities::names(const std::string& sensor) const {
  return std::find(reads.begin(), reads.end(), sensor) != reads.end();
}

SensorView view_of(const Frame& frame) {
  return view_of(frame, frame.image, frame.sweep);
}

SensorView view_of(const Frame& frame, const ImageF& image, std::span<const LidarPoint> points) {
  SensorView view{&image, points, &frame.calibration};
  view.frame = &frame;
  return view;
}

SensorData sensor_beside(const Frame& frame, std::size_t place, const ImageF* image) {
  SensorData data;
  data.time = frame.moment ? frame.moment->time : 0;
  if (place >= frame.others.size()) {
    const Measurement& measured = frame.measurements.at(place - frame.others.size());
    data.kind = SensorData::Kind::other;
    data.name = measured.name;
    data.values = measured.data, data.shape = measured.shape;
    data.sensor_from_ego = measured.sensor_from_ego;
    return data;
  }
  const SideCamera& camera = frame.others[place];
  data.name = camera.name;
  data.image = image ? image : &camera.image.get();
  data.camera = camera.calibration.camera;
  data.sensor_from_ego = camera.calibration.camera_from_velo;
  return data;
}

std::vector<SensorData> sensors(const SensorView& view, const Capabilities& can, const std::string& who) {
  SensorData camera, lidar;
  camera.name = kFirstCamera, camera.image = view.image;
  lidar.kind = SensorData::Kind::lidar, lidar.name = kFirstLidar, lidar.points = view.points;
  if (view.calibration) {
    camera.camera = view.calibration->camera;
    camera.sensor_from_ego = view.calibration->camera_from_velo;
  }
  if (view.frame && can.names(view.frame->camera)) camera.name = view.frame->camera;
  std::vector<SensorData> all = {std::move(camera), std::move(lidar)};
  std::vector<SensorData> rest = view.others;
  const std::size_t beside = view.frame ? view.frame->others.size() + view.frame->measurements.size() : 0;
  for (std::size_t k = 0; k < beside; ++k) {
    const std::string& name = k < view.frame->others.size()
                                  ? view.frame->others[k].name
                                  : view.frame->measurements[k - view.frame->others.size()].name;
    const auto there =
        std::find_if(rest.begin(), rest.end(), [&](const SensorData& sensor) { return sensor.name == name; });
    if (there != rest.end()) {
      all.push_back(std::move(*there));
      rest.erase(there);
    } else if (can.names(name)) {
      all.push_back(sensor_beside(*view.frame, k));
    }
  }
  std::move(rest.begin(), rest.end(), std::back_inserter(all));
  for (const std::string& name : can.reads)
    if (std::none_of(all.begin(), all.end(), [&](const SensorData& s) { return s.name == name; }))
      throw InputError(who, name, "the frame has no such sensor",
                       "use a data set that has it with --cameras all, a plugin with --sensors, or another "
                       "detector");
  return all;
}

void require_first_sensors(const Capabilities& can, const Frame& frame, const std::string& who) {
  for (const std::string& name : can.reads)
    if (name != kFirstCamera && name != kFirstLidar && name != frame.camera)
      throw InputError(who, name,
                       "is read by the detector, and only the first camera and the LiDAR are changed",
                       "use a detector that reads these alone");
}

double Detection::score() const {
  return logit >= 0 ? 1 / (1 + std::exp(-logit)) : std::exp(logit) / (1 + std::exp(logit));
}

namespace {

constexpr double kMaxSide = 1000, kMaxBoxDistance = 1e5;  // m
constexpr double kMaxPicture = 1e6;                       // pixels

/// A proposal's problem, and the advice for its network; empty if it is valid.
std::pair<std::string, const char*> proposal_problem(const Detection& proposal, Matching matching) {
  const BevBox& box = proposal.box.bev;
  const double bottom = proposal.box.bottom, height = proposal.box.height;
  const PictureBox& picture = proposal.picture;
  for (const double value : {box.x, box.y, box.length, box.width, box.yaw, bottom, height, picture.left,
                             picture.top, picture.right, picture.bottom, proposal.logit})
    if (!std::isfinite(value))
      return {"its box or logit is not finite", "check the detector's weights, and divisions by zero"};
  if (matching.in_picture()) {
    if (picture.right < picture.left || picture.bottom < picture.top)
      return {fmt::format("left {:g} to right {:g} and top {:g} to bottom {:g} is not a box", picture.left,
                          picture.right, picture.top, picture.bottom),
              "give left, top, right, bottom in pixels, not a centre and a size"};
    const double farthest = std::max(
        {std::abs(picture.left), std::abs(picture.top), std::abs(picture.right), std::abs(picture.bottom)});
    if (farthest > kMaxPicture)
      return {fmt::format("reaches to pixel {:g}", farthest), "limit what the network gives"};
    return {};
  }
  const double shorter = std::min(box.length, box.width), longer = std::max(box.length, box.width);
  if (shorter <= 0 || longer > kMaxSide)
    return {fmt::format("length {:g} m and width {:g} m are not a size (over 0, at most {:g} m)", box.length,
                        box.width, kMaxSide),
            "let the network's sizes be positive, as by exp or softplus, and limit them"};
  if (matching.by == MatchBy::space && !(height > 0 && height <= kMaxSide))
    return {fmt::format("height {:g} m is not a size (over 0, at most {:g} m)", height, kMaxSide),
            "let the network's sizes be positive, as by exp or softplus, and limit them"};
  if (horizontal_distance(box) > kMaxBoxDistance)
    return {fmt::format("x {:g} m, y {:g} m is not a place near the sensor", box.x, box.y),
            "give metres in the LiDAR's frame, and limit what the network gives"};
  return {};
}

}  // namespace

void check_proposals(std::span<const Detection> proposals, Matching matching, const std::string& who) {
  for (std::size_t i = 0; i < proposals.size(); ++i)
    if (const auto [problem, fix] = proposal_problem(proposals[i], matching); !problem.empty())
      throw InputError(who, fmt::format("box {} of {}", i, proposals.size()), problem, fix);
}

std::vector<Detection> suppress(std::vector<Detection> proposals, Matching matching) {
  return suppress(std::move(proposals), matching.same(), matching);
}

std::vector<Detection> suppress(std::vector<Detection> proposals, double most, Matching matching) {
  check_proposals(proposals, matching);  // a NaN has no place in an order
  std::stable_sort(proposals.begin(), proposals.end(),
                   [](const Detection& a, const Detection& b) { return a.logit > b.logit; });
  std::vector<Detection> kept;
  for (const Detection& proposal : proposals) {
    const auto overlaps = [&](const Detection& other) {
      return other.type == proposal.type && matching.overlap(proposal, other) > most;
    };
    if (std::none_of(kept.begin(), kept.end(), overlaps)) kept.push_back(proposal);
  }
  return kept;
}

}  // namespace mirage
