#include "simulation/placement.h"

#include <algorithm>
#include <limits>

#include "base/angles.h"
#include "scene/recorded_light.h"

namespace mirage {

Placement on_roof(Carrier carrier) {
  Placement placement{
      .velo_from_adversary = carrier.velo_from_roof, .support = Support::roof, .targets = {carrier.label}};
  placement.carrier = std::move(carrier);
  return placement;
}

Placement placement_of(const PlaceChoice& place, Carrier carrier) {
  if (place.in == PlaceChoice::In::roof) return on_roof(std::move(carrier));
  const Box3& box = carrier.label.box;
  const Transform velo_from_vehicle = velo_from_box(box);
  Transform pose(Eigen::Translation3d(place.at) * Eigen::AngleAxisd(place.yaw * kDegree, Vec3d::UnitZ()));
  if (place.in == PlaceChoice::In::vehicle) pose = velo_from_vehicle * pose;
  const Vec3d p_vehicle = velo_from_vehicle.inverse() * pose.translation();
  const bool above = 2 * std::abs(p_vehicle.x()) <= box.bev.length &&
                     2 * std::abs(p_vehicle.y()) <= box.bev.width &&
                     p_vehicle.z() >= saloon::kWaist * box.height;
  Placement placement = on_roof(std::move(carrier));
  placement.velo_from_adversary = pose;
  placement.support = above ? Support::roof : Support::free;
  return placement;
}

TexturedMesh place(const TexturedMesh& adversary, const Placement& placement) {
  TexturedMesh placed = adversary;
  const double lowest = bounds(adversary.mesh).min().z();
  for (Vec3d& v : placed.mesh.vertices) v = placement.velo_from_adversary * (v - Vec3d(0, 0, lowest));
  return placed;
}

std::optional<LightSurroundings> surroundings_of(const Frame& frame, const Placement& placement) {
  if (!placement.carrier) return std::nullopt;
  LightSurroundings around = light_surroundings(frame, *placement.carrier);
  if (placement.support == Support::free) {  // neither roof nor deck is below it
    around.roof = around.deck = {Vec2d::Zero(), Vec2d::Zero()};
    around.beside = shape_of(*placement.carrier);
  }
  return around;
}

double unhidden_depth(const Placement& placement, const Calibration& calibration) {
  double nearest = std::numeric_limits<double>::infinity();
  if (placement.support == Support::roof && placement.carrier)
    for (const Vec3d& corner : corners(placement.carrier->label.box))
      nearest = std::min(nearest, (calibration.camera_from_velo * corner).z());
  return nearest;
}

}  // namespace mirage
