// Meshes and materials of which generated scenes are built.
#pragma once

#include <numbers>
#include <string>
#include <vector>

#include "base/random.h"
#include "geometry/mesh.h"
#include "sensors/ray_camera.h"

namespace mirage::generator {

/// π.
inline constexpr double kPi = std::numbers::pi;

/// A thing of the scene in its own frame: x along its heading, y left, z up, origin on the ground under the
/// centre of its label box.
struct Actor {
  std::string type;               ///< KITTI class; empty: clutter without a label
  std::vector<Surface> surfaces;  ///< in the actor's frame
  Vec3d size = Vec3d::Zero();     ///< length, width, height of the label box (m)
  std::string kind = {};          ///< body style of a car (generator/car_body.h); "look-alike"; else empty

  /// Adds a surface().
  void add(Mesh mesh, const Material& material, bool smooth = false);
};

/// Measures the label box from the surfaces so far and moves the origin under its centre. Surfaces added
/// later (mirrors) don't count.
void fit_label_box(Actor& actor);
/// Stretches the actor to the given label box.
void stretch(Actor& actor, const Vec3d& size);

/// Closed cylinder along z from 0 to `height`.
Mesh cylinder(double radius, double height, int segments, double top_radius = -1);
/// Adds a cylinder that lies along y: from the middle of one end `width` m towards −y where `turn` is 1, and
/// towards +y where it is −1.
void add_wheel(Mesh& mesh, const Vec3d& end, double radius, double width, int segments, int turn);
/// Adds a cylinder from one point to another.
void add_rod(Mesh& mesh, const Vec3d& from, const Vec3d& to, double radius, int segments = 8,
             double end_radius = -1);
/// Ellipsoid of the given radii around the origin.
Mesh ellipsoid(const Vec3d& radii, int subdivisions = 1);
/// Two-sided rectangle patch of four corners.
void add_quad(Mesh& mesh, const Vec3d& a, const Vec3d& b, const Vec3d& c, const Vec3d& d);
/// Axis-aligned box between two opposite corners.
void add_box(Mesh& mesh, const Vec3d& corner, const Vec3d& opposite);
/// Leaves: `count` small quads scattered through an ellipsoid, more of them near its surface.
void add_leaves(Mesh& mesh, const Vec3d& centre, const Vec3d& radii, int count, double size,
                RandomStream& random);

/// The pose at a place (m), turned by `yaw` (rad) about z.
Transform at(double x, double y, double z, double yaw = 0);
/// The mesh at a pose.
Mesh moved(Mesh mesh, const Transform& pose);
/// A mesh of one material; `smooth`: shaded by interpolated normals.
Surface surface(Mesh mesh, Material material, bool smooth = false);
/// One colour (linear albedo), `lidar` its reflectance at normal incidence.
Material plain(const Vec3f& albedo, float lidar, float gloss = 0);
/// The entry of a list with shares on which `pick` (from 0 to their sum) falls.
template <class List>
const auto& by_share(const List& list, double pick) {
  for (const auto& entry : list)
    if ((pick -= entry.share) < 0) return entry;
  return list.back();
}
/// Linear albedo of somebody's clothes.
Vec3f random_cloth(RandomStream& random);
/// Leaves of a hedge or tree, green or turning.
Material green(RandomStream& random);

/// A passenger car of any body style.
Actor make_car(RandomStream& random);
/// A look-alike that only a picture tells from `car`. A LiDAR meets the car's own surfaces; the camera sees a
/// clipped hedge, a tarpaulin or a stack of goods, closed, without wheels, lamps or panes. One in five is a
/// bin, a shed or a boat of its size instead. Type "Misc", kind "look-alike": detection takes it for
/// background.
Actor make_look_alike(Actor car, RandomStream& random);
/// Shares of look-alikes among the things where cars park, and among those on the lanes.
inline constexpr double kParkedDecoyShare = 0.5, kLaneDecoyShare = 0.2;
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
/// The lamps of a traffic light, m.
struct SignalLamps {
  Vec3d highest;         ///< of the red one: the middle of its lens, as far forward as its hood begins
  double apart = 0;      ///< from one down to the next
  double lens = 0;       ///< radius
  double hood = 0;       ///< radius
  double hood_long = 0;  ///< forward
};
/// Adds three lenses to `actor` and their hoods to `hoods`; faces −x, `lit` as above.
void add_signal_lamps(Actor& actor, Mesh& hoods, const SignalLamps& lamps, int lit);

// Road signs put together from flat coloured pieces.

/// Albedo of sheeting, scene-linear.
namespace sign_color {
/// Linear RGB in [0, 1].
inline const Vec3f kRed(0.50f, 0.02f, 0.02f), kWhite(0.65f, 0.65f, 0.63f), kBlue(0.015f, 0.09f, 0.42f),
    kYellow(0.65f, 0.42f, 0.02f), kGreen(0.01f, 0.18f, 0.07f), kBlack(0.02f, 0.02f, 0.02f),
    kGrey(0.25f, 0.25f, 0.25f);
}  // namespace sign_color

/// Faces −x, around (x, 0, z) of the actor. The face is made of flat pieces, each a hair before the last.
class SignBoard {
 public:
  /// `x`, `z`: m, in the actor's frame. Pieces are appended to `actor`, which outlives this.
  SignBoard(Actor& actor, double x, double z) : actor_(actor), x_(x), z_(z) {}

  /// Regular polygon with `corners` (20: a disc); `turn` from the one that has a corner on top.
  void polygon(int corners, double radius, double turn, const Vec3f& color, double thickness = 0.003) {
    Mesh mesh;
    append(mesh, cylinder(radius, thickness, corners),
           Transform(Eigen::Translation3d(x_, 0, z_) * Eigen::AngleAxisd(-0.5 * kPi, Vec3d::UnitY()) *
                     Eigen::AngleAxisd(turn, Vec3d::UnitZ())));
    push(std::move(mesh), color, thickness);
  }
  /// Rectangle between (y, z) corners relative to the sign's middle; y to the left of the heading.
  void bar(double y0, double z0, double y1, double z1, const Vec3f& color) {
    Mesh mesh;
    add_box(mesh, {x_ - 0.003, y0, z_ + z0}, {x_, y1, z_ + z1});
    push(std::move(mesh), color, 0.003);
  }
  /// Rectangle around the sign's middle, `length` × `width` m; `angle` (rad) turns it about x, at 0 it lies
  /// level.
  void slanted_bar(double length, double width, double angle, const Vec3f& color) {
    Mesh mesh;
    append(mesh, box_mesh({0.003, length, width}),
           Transform(Eigen::Translation3d(x_ - 0.0015, 0, z_) * Eigen::AngleAxisd(angle, Vec3d::UnitX())));
    push(std::move(mesh), color, 0.003);
  }

 private:
  void push(Mesh mesh, const Vec3f& color, double thickness) {
    constexpr float retro = 2.f;  // LiDAR reflectivity of sign sheeting
    actor_.add(std::move(mesh), plain(color, retro, 0.01f));
    x_ -= thickness + 0.002;
  }
  Actor& actor_;
  double x_, z_;
};

}  // namespace mirage::generator
