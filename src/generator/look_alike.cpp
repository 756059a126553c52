// Things that only a picture tells from cars.
#include <algorithm>
#include <cmath>
#include <numbers>

#include "generator/car_assembly.h"
#include "geometry/shapes.h"

namespace mirage::generator {
namespace {

constexpr double kHem = 0.42;  // of the height: from here down to the ground a cover hangs straight

/// What the camera sees instead of a surface; the LiDAR goes on meeting what was there.
Material veiled(const Material& below, Material cover) {
  cover.veiled = true;
  cover.gloss = below.gloss, cover.transparency = below.transparency, cover.lidar = below.lidar;
  return cover;
}

/// A surface for the camera alone.
Surface seen_only(Mesh mesh, Material cover) {
  cover.veiled = true, cover.transparency = 1;
  return surface(std::move(mesh), cover);
}

/// Counter-clockwise convex outline of a mesh's plan below `height` (Andrew's monotone chain).
std::vector<Vec2d> outline(const Mesh& mesh, double height) {
  std::vector<Vec2d> points;
  for (const Vec3d& v : mesh.vertices)
    if (v.z() <= height) points.push_back(v.head<2>());
  std::sort(points.begin(), points.end(), [](const Vec2d& a, const Vec2d& b) {
    return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
  });
  std::vector<Vec2d> hull;
  for (int pass = 0; pass < 2; ++pass) {
    const std::size_t first = hull.size();
    for (const Vec2d& p : points) {
      while (hull.size() >= first + 2) {
        const Vec2d a = hull.back() - hull[hull.size() - 2], b = p - hull.back();
        if (a.x() * b.y() - a.y() * b.x() > 0) break;
        hull.pop_back();
      }
      hull.push_back(p);
    }
    hull.pop_back();
    std::reverse(points.begin(), points.end());
  }
  return hull;
}

/// The cover's lower part, down to the ground, with what is between the wheels.
Mesh hem(const Mesh& body, double height) {
  Mesh mesh;
  const std::vector<Vec2d> plan = outline(body, kHem * height);
  for (std::size_t i = 0; i < plan.size(); ++i) {
    const Vec2d a = 1.012 * plan[i], b = 1.012 * plan[(i + 1) % plan.size()];
    const double low = 0.005, high = kHem * height;
    add_quad(mesh, {a.x(), a.y(), low}, {b.x(), b.y(), low}, {b.x(), b.y(), high}, {a.x(), a.y(), high});
  }
  return mesh;
}

/// Leaves over a surface, `count` of them, evenly by area.
void strew(Mesh& leaves, const Mesh& mesh, int count, RandomStream& random) {
  std::vector<double> until;
  double sum = 0;
  for (const Vec3d& n : face_normals(mesh)) until.push_back(sum += n.norm());
  for (int i = 0; i < count; ++i) {
    const auto at = std::lower_bound(until.begin(), until.end(), random.uniform() * sum);
    const Face& f =
        mesh.faces[std::min<std::size_t>(static_cast<std::size_t>(at - until.begin()), until.size() - 1)];
    double b1 = random.uniform(), b2 = random.uniform();
    if (b1 + b2 > 1) b1 = 1 - b1, b2 = 1 - b2;
    const Vec3d p = (1 - b1 - b2) * mesh.vertices[f[0]] + b1 * mesh.vertices[f[1]] + b2 * mesh.vertices[f[2]];
    add_leaves(leaves, p, {0.05, 0.05, 0.05}, 1, 0.07, random);
  }
}

Material tarpaulin(RandomStream& random) {
  const Vec3f colors[8] = {{0.03f, 0.09f, 0.04f}, {0.03f, 0.08f, 0.30f}, {0.25f, 0.26f, 0.27f},
                           {0.10f, 0.10f, 0.06f}, {0.50f, 0.17f, 0.02f}, {0.45f, 0.40f, 0.30f},
                           {0.60f, 0.60f, 0.58f}, {0.05f, 0.05f, 0.055f}};
  const float tone = static_cast<float>(random.uniform(0.7, 1.3));
  Material m = plain(tone * colors[random.below(8)], 0);
  m.pattern = Pattern::cloth, m.variant = random.next_u32();
  return m;
}

Material goods(RandomStream& random) {
  // Cardboard, straw, wrapped pallets, timber, brick, plastic crates: what it is, and what shows between.
  const Vec3f colors[7][2] = {
      {{0.36f, 0.24f, 0.13f}, {0.10f, 0.06f, 0.03f}}, {{0.30f, 0.21f, 0.12f}, {0.45f, 0.38f, 0.25f}},
      {{0.42f, 0.32f, 0.11f}, {0.14f, 0.10f, 0.03f}}, {{0.55f, 0.56f, 0.58f}, {0.22f, 0.22f, 0.23f}},
      {{0.34f, 0.23f, 0.13f}, {0.05f, 0.03f, 0.02f}}, {{0.30f, 0.11f, 0.07f}, {0.36f, 0.35f, 0.33f}},
      {{0.05f, 0.12f, 0.30f}, {0.01f, 0.02f, 0.06f}}};
  const Vec3f* pick = colors[random.below(7)];
  const float tone = static_cast<float>(random.uniform(0.75, 1.25));
  Material m = plain(tone * pick[0], 0);
  m.second = tone * pick[1];
  m.pattern = Pattern::stack, m.variant = random.next_u32();
  return m;
}

Actor bin(const Vec3d& size, RandomStream& random) {
  Actor actor;
  const double l = 0.5 * size.x(), w = 0.5 * size.y(), h = size.z(), in = random.uniform(0.75, 0.95);
  Mesh tub, ribs, lid;
  const double low = 0.12, rim = random.uniform(0.75, 0.95) * h;
  const auto corner = [&](int k, double z, double k_in) {
    return Vec3d((k == 0 || k == 3 ? 1 : -1) * l * k_in, (k < 2 ? 1 : -1) * w * k_in, z);
  };
  for (int k = 0; k < 4; ++k)
    add_quad(tub, corner(k, low, in), corner((k + 1) % 4, low, in), corner((k + 1) % 4, rim, 1),
             corner(k, rim, 1));
  add_quad(tub, corner(0, low, in), corner(1, low, in), corner(2, low, in), corner(3, low, in));
  for (double x = -0.75 * l; x < 0.8 * l; x += 0.5)
    for (double side : {-1.0, 1.0})
      add_box(ribs, {x - 0.04, side * w * 0.5 * (1 + in) - 0.05, low},
              {x + 0.04, side * w * 0.5 * (1 + in) + 0.05, rim});
  add_box(lid, {-l, -w, rim}, {l, w, rim + 0.04});
  add_box(lid, {-0.8 * l, -0.7 * w, rim}, {0.8 * l, 0.7 * w, h});
  const Vec3f colors[6] = {{0.02f, 0.10f, 0.05f}, {0.03f, 0.08f, 0.28f}, {0.25f, 0.26f, 0.26f},
                           {0.50f, 0.33f, 0.03f}, {0.25f, 0.09f, 0.03f}, {0.05f, 0.05f, 0.05f}};
  const Material tint = plain(colors[random.below(6)], 0), steel = veiled(paint_of(random), tint);
  Material top = steel;
  top.albedo = random.uniform() < 0.5 ? Vec3f(0.7f * steel.albedo) : Vec3f(0.12f, 0.10f, 0.08f);
  actor.surfaces = {surface(tub, steel), surface(ribs, steel), surface(lid, top)};
  return actor;
}

Actor shed(const Vec3d& size, RandomStream& random) {
  Actor actor;
  const double l = 0.5 * size.x(), w = 0.5 * size.y(), h = size.z() * random.uniform(1.0, 1.35),
               wall = 0.72 * h;
  Mesh walls, roof, door;
  add_box(walls, {-l, -w, 0}, {l, w, wall});
  for (double x : {-l, l}) add_quad(walls, {x, -w, wall}, {x, w, wall}, {x, 0, h}, {x, 0, h});
  for (double side : {-1.0, 1.0})
    add_quad(roof, {-l - 0.1, side * (w + 0.08), wall - 0.04}, {l + 0.1, side * (w + 0.08), wall - 0.04},
             {l + 0.1, 0, h}, {-l - 0.1, 0, h});
  const double x = random.uniform(-0.5, 0.5) * l;
  for (double side : {-1.0, 1.0})
    add_box(door, {x - 0.35, side * w - 0.01, 0.05}, {x + 0.35, side * w + 0.01, 0.95 * wall});
  Material boards = plain(Vec3f(0.28f, 0.18f, 0.10f) * static_cast<float>(random.uniform(0.4, 1.6)), 0);
  boards.pattern = random.uniform() < 0.6 ? Pattern::bark : Pattern::brick;
  boards.second = Vec3f::Constant(0.35f), boards.variant = random.next_u32();
  const Material below = paint_of(random);
  actor.surfaces = {
      surface(walls, veiled(below, boards)), surface(door, veiled(below, plain(0.5f * boards.albedo, 0))),
      surface(roof,
              veiled(below,
                     plain(random.uniform() < 0.5 ? Vec3f(0.2f, 0.07f, 0.04f) : Vec3f::Constant(0.06f), 0)))};
  return actor;
}

/// On its trailer, decked or covered.
Actor boat(const Vec3d& size, RandomStream& random) {
  Actor actor;
  constexpr int stations = 14, ring = 6;
  const double l = size.x(), w = 0.5 * size.y(), h = size.z();
  Mesh hull, deck, trailer;
  const auto point = [&](int k, int i) -> Vec3d {  // i: from the keel up to the deck's ridge
    const double u = static_cast<double>(k) / stations, plan = w * (1 - 0.97 * std::pow(u, 3.2)),
                 rise = 0.25 * std::pow(u, 3);
    const double y[ring] = {0, 0.62, 0.92, 1, 0.6, 0}, z[ring] = {0.26, 0.36, 0.58, 0.72, 0.9, 1};
    return {l * (u - 0.5 + (i > 1 ? 0.04 * u : 0)), plan * y[i], h * std::min(1.0, z[i] + rise * (1 - z[i]))};
  };
  for (int k = 0; k < stations; ++k)
    for (int i = 0; i + 1 < ring; ++i)
      for (int side : {-1, 1}) {
        const Vec3d mirror(1, side, 1);
        const Vec3d a = point(k, i).cwiseProduct(mirror), b = point(k + 1, i).cwiseProduct(mirror),
                    c = point(k + 1, i + 1).cwiseProduct(mirror), d = point(k, i + 1).cwiseProduct(mirror);
        Mesh& part = i < 3 ? hull : deck;
        if (side < 0)
          add_quad(part, a, b, c, d);
        else
          add_quad(part, a, d, c, b);
      }
  for (int i = 0; i + 1 < ring; ++i) {  // transom
    const Vec3d a = point(0, i), b = point(0, i + 1), m(1, -1, 1);
    add_quad(hull, a, a.cwiseProduct(m), b.cwiseProduct(m), b);
  }
  add_box(trailer, {-0.45 * l, -0.03, 0.22}, {0.5 * l + 0.4, 0.03, 0.3});
  for (int side : {-1, 1})
    append(trailer, cylinder(0.26, 0.15, 14),
           Transform(Eigen::Translation3d(-0.12 * l, side * 0.8 * w, 0.26) *
                     Eigen::AngleAxisd(side * 0.5 * std::numbers::pi, Vec3d::UnitX())));
  const Material below = paint_of(random);
  const Vec3f colors[4] = {
      {0.65f, 0.65f, 0.62f}, {0.03f, 0.06f, 0.2f}, {0.3f, 0.05f, 0.03f}, {0.3f, 0.2f, 0.1f}};
  actor.surfaces = {surface(hull, veiled(below, plain(colors[random.below(4)], 0))),
                    surface(deck, veiled(below, tarpaulin(random))),
                    surface(trailer, plain(Vec3f::Constant(0.05f), 0.1f))};
  return actor;
}

Actor of_its_size(const Vec3d& size, RandomStream& random) {
  const int pick = random.below(3);
  Actor actor = pick == 0 ? bin(size, random) : pick == 1 ? shed(size, random) : boat(size, random);
  fit_label_box(actor);
  return actor;
}

}  // namespace

Actor make_look_alike(Actor car, RandomStream& random) {
  const double pick = random.uniform();
  if (pick < 0.2) {
    car = of_its_size(car.size, random);
  } else {
    const bool hedge = pick < 0.45;
    const Material cover = hedge ? green(random) : pick < 0.72 ? tarpaulin(random) : goods(random);
    const Mesh lower = hem(car.surfaces.front().mesh, car.size.z());
    if (hedge) {
      Mesh leaves;
      strew(leaves, lower, 300, random);
      strew(leaves, car.surfaces[0].mesh, 500, random);  // paint, then glass
      strew(leaves, car.surfaces[1].mesh, 200, random);
      Material shade = cover;  // between the leaves
      shade.albedo *= 0.6f, shade.second *= 0.6f;
      for (Surface& s : car.surfaces) s.material = veiled(s.material, shade);
      car.surfaces.push_back(seen_only(lower, shade));
      car.surfaces.push_back(seen_only(std::move(leaves), cover));
    } else {
      for (Surface& s : car.surfaces) s.material = veiled(s.material, cover);
      car.surfaces.push_back(seen_only(lower, cover));
    }
  }
  car.type = "Misc";
  car.kind = "look-alike";
  return car;
}

}  // namespace mirage::generator
