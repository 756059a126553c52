#include "attack/ride.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>

#include "base/angles.h"
#include "base/intervals.h"
#include "tracking/smoother.h"

namespace mirage {
namespace {

double heading_of(const Transform& pose) {
  return std::atan2(pose(1, 0), pose(0, 0));
}

Transform upright_pose(const Vec3d& position, double yaw) {
  Transform pose = Transform::Identity();
  pose.linear() = Eigen::AngleAxisd(yaw, Vec3d::UnitZ()).toRotationMatrix();
  pose.translation() = position;
  return pose;
}

/// box_from_roof: the median place and heading.
Transform usual_roof(const std::vector<RideFrame>& frames) {
  const bool none = std::all_of(frames.begin(), frames.end(),
                                [](const RideFrame& frame) { return frame.carrier.from_box; });
  std::array<std::vector<double>, 4> values;
  for (const auto& [moment, carrier] : frames) {
    if (carrier.from_box && !none) continue;
    const Transform roof = velo_from_box(carrier.label.box).inverse() * carrier.velo_from_roof;
    for (int axis = 0; axis < 3; ++axis)
      values[static_cast<std::size_t>(axis)].push_back(roof.translation()[axis]);
    values[3].push_back(heading_of(roof));
  }
  std::array<double, 4> usual{};
  for (std::size_t i = 0; i < 4; ++i) usual[i] = median_interval(values[i]).value;
  return upright_pose(Vec3d(usual[0], usual[1], usual[2]), usual[3]);
}

/// See Ride::in_box_m.
std::pair<double, double> spread_in_boxes(const std::vector<RideFrame>& frames,
                                          const std::vector<Carrier>& carriers) {
  std::vector<Eigen::Vector4d> places;
  Eigen::Vector4d mean = Eigen::Vector4d::Zero();
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const Transform roof = velo_from_box(frames[i].carrier.label.box).inverse() * carriers[i].velo_from_roof;
    places.emplace_back(roof.translation().x(), roof.translation().y(), roof.translation().z(),
                        heading_of(roof));
    mean += places.back() / static_cast<double>(frames.size());
  }
  double squares = 0, turns = 0;
  for (const Eigen::Vector4d& place : places) {
    squares += (place - mean).head<3>().squaredNorm();
    turns += (place - mean)[3] * (place - mean)[3];
  }
  const auto count = static_cast<double>(frames.size());
  return {std::sqrt(squares / count), std::sqrt(turns / count)};
}

}  // namespace

Ride ride(const std::vector<RideFrame>& frames) {
  constexpr double kBoxSigma = 0.15, kBoxHeightSigma = 0.08, kBoxYawSigma = 0.04;  // m, m, rad
  Ride track;
  if (frames.empty()) return track;
  const Transform box_from_roof = usual_roof(frames);
  std::vector<PlaceMeasurement> measured;
  for (const auto& [moment, carrier] : frames) {
    PlaceMeasurement place;
    Transform velo_from_roof = carrier.velo_from_roof;
    if (carrier.from_box) {
      velo_from_roof = velo_from_box(carrier.label.box) * box_from_roof;
      place.sigma = Vec3d(kBoxSigma, kBoxSigma, kBoxHeightSigma);
      place.yaw_sigma = kBoxYawSigma;
    }
    const Transform world_from_roof = moment.world_from_ego * velo_from_roof;
    place.time = moment.time;
    place.position = world_from_roof.translation();
    place.yaw = heading_of(world_from_roof);
    measured.push_back(place);
  }
  const std::vector<SmoothPlace> places = smooth(measured);
  std::vector<Vec3d> found, smoothed;
  double squares = 0, turns = 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const SmoothPlace& place = places[i];
    const Transform ego_from_world = frames[i].moment.world_from_ego.inverse();
    Carrier carrier = frames[i].carrier;
    // Upright in `velo`, as every roof and box.
    const Vec3d along = ego_from_world.linear() * Vec3d(std::cos(place.yaw), std::sin(place.yaw), 0);
    carrier.velo_from_roof = upright_pose(ego_from_world * place.position, std::atan2(along.y(), along.x()));
    const Transform box = carrier.velo_from_roof * box_from_roof.inverse();
    carrier.label.box.bev.x = box.translation().x();
    carrier.label.box.bev.y = box.translation().y();
    carrier.label.box.bev.yaw = heading_of(box);
    carrier.label.box.bottom = box.translation().z();
    if (carrier.shape) {
      const Transform moved = carrier.velo_from_roof * frames[i].carrier.velo_from_roof.inverse();
      Mesh mesh = *carrier.shape;
      for (Vec3d& v : mesh.vertices) v = moved * v;
      carrier.shape = std::make_shared<const Mesh>(std::move(mesh));
    }
    if (!carrier.from_box) {
      ++track.fitted;
      squares += (measured[i].position - place.position).squaredNorm();
      const double turn = wrap_angle(measured[i].yaw - place.yaw);
      turns += turn * turn;
    }
    found.push_back(measured[i].position);
    smoothed.push_back(place.position);
    track.carriers.push_back(std::move(carrier));
    track.velocities.push_back(place.velocity);
  }
  std::tie(track.in_box_m, track.in_box_rad) = spread_in_boxes(frames, track.carriers);
  track.residual_m = std::sqrt(squares / std::max(1, track.fitted));
  track.residual_rad = std::sqrt(turns / std::max(1, track.fitted));
  track.fit_jitter_m = jitter(found);
  track.jitter_m = jitter(smoothed);
  return track;
}

}  // namespace mirage
