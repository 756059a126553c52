// Meshes and materials that generated scenes are put together from.
#pragma once

#include <string>
#include <vector>

#include "base/random.h"
#include "geometry/mesh.h"
#include "sensors/ray_camera.h"

namespace mirage::generator {

/// A thing of the scene in its own frame: x along its heading, y left, z up, origin on the ground under the
/// centre of its label box.
struct Actor {
  std::string type;               ///< KITTI class; empty: clutter without a label
  std::vector<Surface> surfaces;  ///< in the actor's frame
  Vec3d size = Vec3d::Zero();     ///< length, width, height of the label box (m)
  std::string kind = {};          ///< body style of a car (generator/car_family.h); "look-alike"; else empty
};

/// Measures the label box from the surfaces so far and moves the origin under its centre. Surfaces added
/// later (mirrors) don't count.
void fit_label_box(Actor& actor);
/// Stretches the actor to the given label box.
void stretch(Actor& actor, const Vec3d& size);

/// Closed cylinder along z from 0 to `height`.
Mesh cylinder(double radius, double height, int segments, double top_radius = -1);
/// Ellipsoid of the given radii around the origin.
Mesh ellipsoid(const Vec3d& radii, int subdivisions = 1);
/// Two-sided rectangle patch of four corners.
void add_quad(Mesh& mesh, const Vec3d& a, const Vec3d& b, const Vec3d& c, const Vec3d& d);
/// Axis-aligned box from its lowest to its highest corner.
void add_box(Mesh& mesh, const Vec3d& low, const Vec3d& high);
/// Leaves: `count` small quads scattered through an ellipsoid, more of them near its surface.
void add_leaves(Mesh& mesh, const Vec3d& centre, const Vec3d& radii, int count, double size,
                RandomStream& random);

/// The pose at a place (m), turned by `yaw` (rad) about z.
Transform at(double x, double y, double z, double yaw = 0);
/// A mesh of one material; `smooth`: shaded by interpolated normals.
Surface surface(Mesh mesh, Material material, bool smooth = false);
/// One colour (linear albedo), `lidar` its reflectance at normal incidence.
Material plain(const Vec3f& albedo, float lidar, float gloss = 0);
/// Linear albedo of somebody's clothes.
Vec3f random_cloth(RandomStream& random);
/// Leaves of a hedge or tree, green or turning.
Material green(RandomStream& random);

/// A passenger car of any body style.
Actor make_car(RandomStream& random);
/// What only a picture tells from a car: `car` with every surface and all that a LiDAR meets of it, but to
/// the camera a clipped hedge, something under a tarpaulin or a stack of goods, closed and without wheels,
/// lamps or panes; one in five is a bin, a shed or a boat of its size instead. Type "Misc", kind
/// "look-alike": detection takes it for background.
Actor make_look_alike(Actor car, RandomStream& random);
/// How many of what stands where cars park, and of what stands on the lanes, are look-alikes.
inline constexpr double kAlikeParked = 0.5, kAlikeOnLanes = 0.2;
/// A delivery van.
Actor make_van(RandomStream& random);
/// A lorry.
Actor make_truck(RandomStream& random);
/// Somebody who stands or walks.
Actor make_pedestrian(RandomStream& random);
/// Somebody on a bicycle.
Actor make_cyclist(RandomStream& random);
/// Unlabelled things, some of them of a car's size: bins, kiosks, containers, hedges, stacks.
Actor make_clutter(RandomStream& random);
/// A tree; `detail` scales the number of its leaves.
Actor make_tree(RandomStream& random, double detail);
/// A post with a sign or a lamp, or a bare one.
Actor make_pole(RandomStream& random);
/// Faces −x. `lit`: 0 red, 1 amber, 2 green.
Actor make_traffic_light(RandomStream& random, int lit);

}  // namespace mirage::generator
