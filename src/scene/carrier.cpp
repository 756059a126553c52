#include "scene/carrier.h"

#include <cmath>
#include <utility>

namespace mirage {
namespace {

/// Distance of a car's cabin centre behind the box's centre, as a share of its length: bonnets are longer
/// than boots (typical hatchbacks and saloons: 4–8 %).
constexpr double kCabinShift = 0.06;

// Shares of the labelled box, of an ordinary saloon.
using saloon::kRoofFront, saloon::kRoofRear, saloon::kRoofWidth, saloon::kWaist;
constexpr double kClearance = 0.14;                                // of the height
constexpr double kCabinRear = -0.44, kCabinFront = 0.24;           // of the length, at the waist
constexpr double kWaistWidth = 0.98;                               // of the width
constexpr double kAxle = 0.30, kWheelRadius = 0.22, kTyre = 0.12;  // of length, height, width

/// A closed hexahedron between two upright rectangles [x0, x1] × [−half, half] at two heights.
Mesh frustum(double z0, const Vec2d& x_low, double half_low, double z1, const Vec2d& x_high,
             double half_high) {
  Mesh mesh = box_mesh(Vec3d(2, 2, 2));
  for (Vec3d& v : mesh.vertices) {
    const bool top = v.z() > 0;
    const Vec2d& x = top ? x_high : x_low;
    const double half = top ? half_high : half_low;
    v = Vec3d(v.x() > 0 ? x.y() : x.x(), v.y() > 0 ? half : -half, top ? z1 : z0);
  }
  return mesh;
}

/// A closed cylinder along y.
Mesh wheel(double radius, double width) {
  constexpr int kSides = 16;
  Mesh mesh;
  for (int side = 0; side < 2; ++side)
    for (int i = 0; i < kSides; ++i) {
      const double angle = 2 * std::acos(-1.0) * i / kSides;
      mesh.vertices.emplace_back(radius * std::cos(angle), (side == 0 ? -0.5 : 0.5) * width,
                                 radius * std::sin(angle));
    }
  for (int i = 0; i < kSides; ++i) {
    const int j = (i + 1) % kSides;
    mesh.faces.push_back({i, j, kSides + j});
    mesh.faces.push_back({i, kSides + j, kSides + i});
    if (i > 0 && j > 0) {
      mesh.faces.push_back({0, j, i});
      mesh.faces.push_back({kSides, kSides + i, kSides + j});
    }
  }
  if (signed_volume(mesh) < 0)
    for (Face& f : mesh.faces) std::swap(f[1], f[2]);
  return mesh;
}

}  // namespace

Mesh car_proxy(const Box3& box) {
  const double l = box.bev.length, w = box.bev.width, h = box.height;
  Mesh car;
  const Transform velo_from_car = velo_from_box(box);
  append(car,
         frustum(kClearance * h, Vec2d(-l / 2, l / 2), w / 2, kWaist * h, Vec2d(-l / 2, l / 2),
                 kWaistWidth * w / 2),
         velo_from_car);
  // The cabin starts a little below the waist, so that body and cabin share no face.
  append(car,
         frustum((kWaist - 0.05) * h, Vec2d(kCabinRear, kCabinFront) * l, 0.94 * w / 2, h,
                 Vec2d(kRoofRear, kRoofFront) * l, kRoofWidth * w / 2),
         velo_from_car);
  const double radius = kWheelRadius * h, tyre = kTyre * w;
  for (const double x : {-kAxle * l, kAxle * l})
    for (const double y : {-(w - tyre) / 2, (w - tyre) / 2})
      append(car, wheel(radius, tyre), velo_from_car * Eigen::Translation3d(x, y, radius));
  return car;
}

std::shared_ptr<const Mesh> shape_of(const Carrier& carrier) {
  return carrier.shape ? carrier.shape : std::make_shared<const Mesh>(car_proxy(carrier.label.box));
}

Carrier BoxRoofFinder::find(const Frame&, const Label& label) const {
  Carrier carrier;
  carrier.label = label;
  carrier.velo_from_roof = velo_from_box(label.box) *
                           Eigen::Translation3d(-kCabinShift * label.box.bev.length, 0, label.box.height);
  return carrier;
}

}  // namespace mirage
