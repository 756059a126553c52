#include "exchange/host_proxy.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "geometry/shapes.h"
#include "scene/light_surroundings.h"

namespace mirage {
namespace {

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

Mesh ground_proxy(const Vec3d& centre, double reach) {
  Mesh ground;
  for (const Vec2d& corner :
       {Vec2d(reach, reach), Vec2d(-reach, reach), Vec2d(-reach, -reach), Vec2d(reach, -reach)})
    ground.vertices.push_back(centre + Vec3d(corner.x(), corner.y(), 0));
  ground.faces = {{0, 1, 2}, {0, 2, 3}};
  return ground;
}

ExportScene host_scene(const Frame& frame, const Label& host, const Rooftop& rooftop,
                       const TexturedMesh& adversary, const std::string& name) {
  ExportScene scene;
  scene.name = name;
  scene.adversary = place(adversary, rooftop);
  const Mesh vehicle = rooftop.vehicle ? *rooftop.vehicle : car_proxy(host.box);
  const double ground = bounds(vehicle).min().z();
  scene.proxies.push_back({"host", rooftop.vehicle ? "fitted" : "box", vehicle, vehicle_paint(frame, host)});
  scene.proxies.push_back(
      {"ground", "", ground_proxy({host.box.bev.x, host.box.bev.y, ground}), Vec3d::Constant(kRoadAlbedo)});
  scene.calibration = frame.calibration;
  scene.lighting = frame.lighting;
  scene.photograph = frame.image;
  return scene;
}

}  // namespace mirage
