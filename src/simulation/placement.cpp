#include "simulation/placement.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/sizes.h"
#include "base/types.h"
#include "scene/data/kitti_rows.h"
#include "scene/recorded_light.h"

namespace mirage {

Placement on_roof(Carrier carrier) {
  Placement placement{
      .velo_from_adversary = carrier.velo_from_roof, .support = Support::roof, .targets = {carrier.label}};
  placement.carrier = std::move(carrier);
  return placement;
}

namespace {

using In = PlaceChoice::In;

/// Origin of `at` in the vehicle's frame, on the ground.
Vec3d anchor_of(In in, const BevBox& box) {
  switch (in) {
    case In::front:
      return {box.length / 2, 0, 0};
    case In::rear:
      return {-box.length / 2, 0, 0};
    case In::left:
      return {0, box.width / 2, 0};
    case In::right:
      return {0, -box.width / 2, 0};
    default:
      return Vec3d::Zero();
  }
}

bool has_room(const PlaceChoice& place, const Placement& placement, std::span<const Label> labels) {
  constexpr double kShareTaken = 0.1;
  const Transform& pose = placement.velo_from_adversary;
  const Vec3d at = pose.translation();
  const BevBox footprint{at.x(), at.y(), place.volume.x(), place.volume.y(),
                         std::atan2(pose(1, 0), pose(0, 0))};
  return std::ranges::none_of(labels, [&](const Label& label) {
    if (!has_box(label) ||
        (place.in != In::vehicle && in_one_place(label.box.bev, placement.carrier->label.box.bev)))
      return false;
    const Box3& box = label.box;
    return at.z() < box.bottom + box.height && box.bottom < at.z() + place.volume.z() &&
           intersection_area(footprint, box.bev) > kShareTaken * place.volume.x() * place.volume.y();
  });
}

std::optional<int> neighbour_of(const PlaceChoice& place, const Placement& placement,
                                std::span<const Label> labels) {
  const Vec3d at = placement.velo_from_adversary.translation();
  std::optional<int> nearest;
  double least = place.within;
  for (std::size_t i = 0; i < labels.size(); ++i) {
    const Label& label = labels[i];
    if (!is_sought(label) || !has_box(label) || in_one_place(label.box.bev, placement.carrier->label.box.bev))
      continue;
    const double distance = std::hypot(label.box.bev.x - at.x(), label.box.bev.y - at.y());
    if (distance < least || (!nearest && distance == least)) least = distance, nearest = static_cast<int>(i);
  }
  return nearest;
}

/// The smallest upright box along `box`'s heading that holds `within` (in its axes) and the placed mesh.
Box3 box_around(const Box3& box, Eigen::AlignedBox3d within, const Mesh& placed) {
  const Transform velo_from_vehicle = velo_from_box(box), vehicle_from_velo = velo_from_vehicle.inverse();
  for (const std::size_t i : used_vertices(placed)) within.extend(vehicle_from_velo * placed.vertices[i]);
  const Vec3d middle = velo_from_vehicle * Vec3d(within.center().x(), within.center().y(), within.min().z());
  return {{middle.x(), middle.y(), within.sizes().x(), within.sizes().y(), box.bev.yaw},
          middle.z(),
          within.sizes().z()};
}

}  // namespace

Placement placement_of(const PlaceChoice& place, Carrier carrier, std::span<const Label> labels) {
  Placement placement = on_roof(std::move(carrier));
  const Box3& box = placement.carrier->label.box;
  const Transform offset(Eigen::Translation3d(place.at) *
                         Eigen::AngleAxisd(place.yaw * kDegree, Vec3d::UnitZ()));
  if (place.in == In::roof) {
    placement.velo_from_adversary = placement.velo_from_adversary * offset;
  } else {
    const Transform velo_from_vehicle = velo_from_box(box);
    Transform& pose = placement.velo_from_adversary = offset;
    if (place.in != In::world)
      pose = velo_from_vehicle * (Eigen::Translation3d(anchor_of(place.in, box.bev)) * offset);
    const Vec3d p_vehicle = velo_from_vehicle.inverse() * pose.translation();
    const bool above = 2 * std::abs(p_vehicle.x()) <= box.bev.length &&
                       2 * std::abs(p_vehicle.y()) <= box.bev.width &&
                       p_vehicle.z() >= saloon::kWaist * box.height;
    placement.support = above ? Support::roof : Support::free;
  }
  placement.victim = place.victim;
  placement.volume = place.volume;
  placement.grows_box = place.box == TrueBox::grown;
  if (place.of_file() && placement.support == Support::free && !has_room(place, placement, labels))
    placement.left_out = LeftOut::no_room;
  if (place.victim == Victim::neighbour && placement.left_out == LeftOut::no) {
    placement.neighbour = neighbour_of(place, placement, labels);
    if (placement.neighbour)
      placement.targets = {labels[as_size(*placement.neighbour)]};
    else
      placement.left_out = LeftOut::no_neighbour;
  }
  if (placement.left_out != LeftOut::no || place.victim == Victim::object) placement.targets.clear();
  return placement;
}

std::string why_left_out(const PlaceChoice& place, LeftOut left_out) {
  if (left_out == LeftOut::no_room)
    return fmt::format("a labelled object already stands where {} puts the mesh", text_of(place));
  if (left_out == LeftOut::no_neighbour)
    return fmt::format("no other vehicle is within {:g} m of the object, as {} requires", place.within,
                       text_of(place));
  return "";
}

void warn_of_volume(const PlaceChoice& place, const Vec3d& size, const std::string& where) {
  constexpr double kRounding = 1e-6;  // m
  if (!place.of_file() || place.in == In::roof || (size.array() <= place.volume.array() + kRounding).all())
    return;
  const auto words = [](const Vec3d& v) {
    return fmt::format("{:.4g} × {:.4g} × {:.4g} m", v.x(), v.y(), v.z());
  };
  spdlog::warn("{}: {} is larger than the volume of {}, {}: hosts are checked for room for that volume only",
               where, words(size), text_of(place), words(place.volume));
}

Box3 grown_box(const Box3& box, const Mesh& placed) {
  return box_around(box,
                    {Vec3d(-box.bev.length / 2, -box.bev.width / 2, 0),
                     Vec3d(box.bev.length / 2, box.bev.width / 2, box.height)},
                    placed);
}

Label own_label(const Placement& placement, const Mesh& placed, const Calibration& calibration) {
  const Transform& pose = placement.velo_from_adversary;
  const Vec3d at = pose.translation();
  Label label;
  label.type = "Misc";
  label.box = box_around({{at.x(), at.y(), 0, 0, std::atan2(pose(1, 0), pose(0, 0))}, at.z(), 0},
                         Eigen::AlignedBox3d(), placed);
  if (placement.carrier) label.track = placement.carrier->label.track;
  if (const auto seen = projected(label.box, calibration))
    label.left = seen->left, label.top = seen->top, label.right = seen->right, label.bottom = seen->bottom;
  return label;
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

double occluder_depth_limit(const Placement& placement, const Calibration& calibration) {
  double nearest = std::numeric_limits<double>::infinity();
  if (placement.support == Support::roof && placement.carrier)
    for (const Vec3d& corner : corners(placement.carrier->label.box))
      nearest = std::min(nearest, (calibration.camera_from_velo * corner).z());
  return nearest;
}

}  // namespace mirage
