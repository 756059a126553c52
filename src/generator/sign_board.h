// Road signs put together from flat coloured pieces.
#pragma once

#include <numbers>

#include "generator/parts.h"
#include "geometry/shapes.h"

namespace mirage::generator {

namespace sign_color {
inline const Vec3f kRed(0.50f, 0.02f, 0.02f), kWhite(0.65f, 0.65f, 0.63f), kBlue(0.015f, 0.09f, 0.42f),
    kYellow(0.65f, 0.42f, 0.02f), kGreen(0.01f, 0.18f, 0.07f), kBlack(0.02f, 0.02f, 0.02f),
    kGrey(0.25f, 0.25f, 0.25f);
}  // namespace sign_color

/// Faces −x, around (x, 0, z) of the actor. The face is made of flat pieces, each a hair before the last.
class SignBoard {
 public:
  SignBoard(Actor& actor, double x, double z) : actor_(actor), x_(x), z_(z) {}

  /// Regular polygon with `corners` (20: a disc); `turn` from the one that has a corner on top.
  void polygon(int corners, double radius, double turn, const Vec3f& color, double thickness = 0.003) {
    Mesh mesh;
    append(mesh, cylinder(radius, thickness, corners),
           Transform(Eigen::Translation3d(x_, 0, z_) *
                     Eigen::AngleAxisd(-0.5 * std::numbers::pi, Vec3d::UnitY()) *
                     Eigen::AngleAxisd(turn, Vec3d::UnitZ())));
    push(std::move(mesh), color, thickness);
  }
  /// Rectangle between (y, z) corners relative to the sign's middle; y to the left of the heading.
  void bar(double y0, double z0, double y1, double z1, const Vec3f& color) {
    Mesh mesh;
    add_box(mesh, {x_ - 0.003, y0, z_ + z0}, {x_, y1, z_ + z1});
    push(std::move(mesh), color, 0.003);
  }
  void slanted_bar(double length, double width, double angle, const Vec3f& color) {
    Mesh mesh;
    append(mesh, box_mesh({0.003, length, width}),
           Transform(Eigen::Translation3d(x_ - 0.0015, 0, z_) * Eigen::AngleAxisd(angle, Vec3d::UnitX())));
    push(std::move(mesh), color, 0.003);
  }

 private:
  void push(Mesh mesh, const Vec3f& color, double thickness) {
    constexpr float retro = 2.f;  // LiDAR reflectivity of sign sheeting
    actor_.surfaces.push_back(surface(std::move(mesh), plain(color, retro, 0.01f)));
    x_ -= thickness + 0.002;
  }
  Actor& actor_;
  double x_, z_;
};

}  // namespace mirage::generator
