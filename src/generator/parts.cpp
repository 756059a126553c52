#include "generator/parts.h"

#include <cmath>

namespace mirage::generator {

void fit_label_box(Actor& actor) {
  Eigen::AlignedBox3d box;
  for (const Surface& s : actor.surfaces) box.extend(bounds(s.mesh));
  const Vec3d shift(-box.center().x(), -box.center().y(), -box.min().z());
  for (Surface& s : actor.surfaces)
    for (Vec3d& v : s.mesh.vertices) v += shift;
  actor.size = box.sizes();
}

void stretch(Actor& actor, const Vec3d& size) {
  const Vec3d scale = size.cwiseQuotient(actor.size);
  for (Surface& s : actor.surfaces)
    for (Vec3d& v : s.mesh.vertices) v = v.cwiseProduct(scale);
  actor.size = size;
}

void Actor::add(Mesh mesh, const Material& material, bool smooth) {
  surfaces.push_back(surface(std::move(mesh), material, smooth));
}

Mesh cylinder(double radius, double height, int segments, double top_radius) {
  if (top_radius < 0) top_radius = radius;
  Mesh mesh;
  for (int i = 0; i < segments; ++i) {
    const double a = 2 * kPi * i / segments;
    mesh.vertices.push_back({radius * std::cos(a), radius * std::sin(a), 0});
    mesh.vertices.push_back({top_radius * std::cos(a), top_radius * std::sin(a), height});
  }
  mesh.vertices.push_back({0, 0, 0});
  mesh.vertices.push_back({0, 0, height});
  for (int i = 0; i < segments; ++i) {
    const int a = 2 * i, b = 2 * ((i + 1) % segments);
    mesh.faces.insert(mesh.faces.end(), {{a, b, b + 1}, {a, b + 1, a + 1}});
    mesh.faces.push_back({b, a, 2 * segments});
    mesh.faces.push_back({a + 1, b + 1, 2 * segments + 1});
  }
  return mesh;
}

void add_wheel(Mesh& mesh, const Vec3d& end, double radius, double width, int segments, int turn) {
  append(mesh, cylinder(radius, width, segments),
         Transform(Eigen::Translation3d(end) * Eigen::AngleAxisd(turn * 0.5 * kPi, Vec3d::UnitX())));
}

void add_rod(Mesh& mesh, const Vec3d& from, const Vec3d& to, double radius, int segments, double end_radius) {
  const Vec3d axis = to - from;
  append(mesh, cylinder(radius, axis.norm(), segments, end_radius),
         Transform(Eigen::Translation3d(from) * Eigen::Quaterniond::FromTwoVectors(Vec3d::UnitZ(), axis)));
}

Mesh ellipsoid(const Vec3d& radii, int subdivisions) {
  Mesh mesh = icosphere(subdivisions);
  for (Vec3d& v : mesh.vertices) v = v.cwiseProduct(radii);
  return mesh;
}

void add_quad(Mesh& mesh, const Vec3d& a, const Vec3d& b, const Vec3d& c, const Vec3d& d) {
  const int n = static_cast<int>(mesh.vertices.size());
  mesh.vertices.insert(mesh.vertices.end(), {a, b, c, d});
  mesh.faces.insert(mesh.faces.end(), {{n, n + 1, n + 2}, {n, n + 2, n + 3}});
}

void add_box(Mesh& mesh, const Vec3d& corner, const Vec3d& opposite) {
  append(mesh, box_mesh((opposite - corner).cwiseAbs()),
         Transform(Eigen::Translation3d(0.5 * (corner + opposite))));
}

void add_leaves(Mesh& mesh, const Vec3d& centre, const Vec3d& radii, int count, double size,
                RandomStream& random) {
  for (int i = 0; i < count; ++i) {
    const auto direction = [&] {
      const double z = random.normal(), y = random.normal(), x = random.normal();
      return Vec3d(x, y, z).normalized();
    };
    const double r = std::cbrt(random.uniform(0.25, 1.0));
    const Vec3d out = direction(), p = centre + r * out.cwiseProduct(radii);
    // Leaves face outwards more or less, so that a crown has a light and a dark side.
    const Vec3d n = (out + 0.9 * direction()).normalized(),
                a = n.unitOrthogonal() * size * random.uniform(0.5, 1.2);
    const Vec3d b = n.cross(a) * random.uniform(0.5, 1.0);
    add_quad(mesh, p - a, p - b, p + a, p + b);
  }
}

Transform at(double x, double y, double z, double yaw) {
  return Transform(Eigen::Translation3d(x, y, z) * Eigen::AngleAxisd(yaw, Vec3d::UnitZ()));
}

Mesh moved(Mesh mesh, const Transform& pose) {
  for (Vec3d& v : mesh.vertices) v = pose * v;
  return mesh;
}

Surface surface(Mesh mesh, Material material, bool smooth) {
  return {.mesh = std::move(mesh), .material = material, .smooth = smooth};
}

Material plain(const Vec3f& albedo, float lidar, float gloss) {
  Material m;
  m.albedo = albedo;
  m.lidar = lidar;
  m.gloss = gloss;
  return m;
}

}  // namespace mirage::generator
