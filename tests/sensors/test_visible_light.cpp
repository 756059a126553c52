// The light model with visibility: known values, gradients with the visibility held fixed, odd meshes.
#include <gtest/gtest.h>

#include <memory>
#include <numeric>

#include "base/error.h"
#include "base/parallel.h"
#include "base/random.h"
#include "base/sizes.h"
#include "geometry/mesh.h"
#include "sensors/light_nodes.h"
#include "sensors/lighting.h"
#include "sensors/material.h"
#include "sensors/visible_light.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

/// A crumpled ball of half a metre around the origin, with random texels.
TexturedMesh ball(std::uint64_t seed, double crumpled, int subdivisions = 1, int resolution = 2) {
  TexturedMesh textured{icosphere(subdivisions), {resolution, {}}};
  RandomStream random(seed, "ball");
  for (Vec3d& v : textured.mesh.vertices) v = v * (0.5 + crumpled * random.uniform(-1, 1)) + Vec3d(0, 0, 0.6);
  textured.atlas.texels.resize(textured.mesh.faces.size() * textured.atlas.per_face());
  for (Vec3d& t : textured.atlas.texels) t = Vec3d{random.uniform(), random.uniform(), random.uniform()};
  return textured;
}

/// The same mesh with every texel as its own face, in the atlas's order.
TexturedMesh texels_as_faces(const TexturedMesh& mesh) {
  TexturedMesh parts{{}, {1, mesh.atlas.texels}};
  parts.mesh.faces.resize(mesh.atlas.texels.size());
  for (std::size_t f = 0; f < mesh.mesh.faces.size(); ++f) {
    const auto [a, b, c] = mesh.mesh.corners(mesh.mesh.faces[f]);
    for (const AtlasTriangle& triangle : atlas_triangles(mesh.atlas.resolution)) {
      const int first = static_cast<int>(parts.mesh.vertices.size());
      for (const Vec2d& corner : triangle.corners)
        parts.mesh.vertices.push_back(corner.x() * a + corner.y() * b + (1 - corner.sum()) * c);
      parts.mesh.faces[f * mesh.atlas.per_face() + as_size(triangle.texel)] = {first, first + 1, first + 2};
    }
  }
  return parts;
}

VisibleLight light_of(const TexturedMesh& mesh, const Lighting& light, const LightSurroundings* around,
                      const VisibleLightSettings& settings = {}) {
  return visible_light(face_normals(mesh.mesh), mesh.atlas.texels, light,
                       find_visibility(mesh, light, around, nullptr, settings), settings.bounces);
}

/// The irradiance from a wide glossy level surface on a face that looks straight down at it: the integral of
/// its radiance n·ω/π over the half space, under an open sky and the sun.
Vec3d light_of_gloss(const Lighting& light) {
  constexpr int kRings = 400, kTurns = 400;
  Vec3d sum = Vec3d::Zero();
  for (int i = 0; i < kRings; ++i) {
    const double z = std::sqrt((i + 0.5) / kRings), r = std::sqrt(1 - z * z);  // cosine-weighted
    const Vec3d mirrored = light.ambient + light.hemisphere / 2 + 0.75 * z * light.hemisphere;
    for (int k = 0; k < kTurns; ++k) {
      const double turn = 2 * M_PI * (k + 0.5) / kTurns;
      const Vec3d up(r * std::cos(turn), r * std::sin(turn), z);
      sum += specular_albedo(z) * mirrored +
             specular_response(Vec3d::UnitZ(), light.to_sun_velo, up) * light.sun;
    }
  }
  return sum / (kRings * kTurns);
}

double largest_difference(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b) {
  EXPECT_EQ(a.size(), b.size());
  double worst = 0;
  for (std::size_t i = 0; i < a.size(); ++i) worst = std::max(worst, (a[i] - b[i]).cwiseAbs().maxCoeff());
  return worst;
}

TEST(VisibleLight, AConvexObjectInFreeSpaceHasThePlainLight) {
  const TexturedMesh convex = ball(1, 0, 2, 5);
  const Lighting light;
  const auto lit = light_of(convex, light, nullptr);
  const auto normals = face_normals(convex.mesh);
  for (std::size_t t = 0; t < lit.factor.size(); ++t)
    ASSERT_LT((lit.factor[t] - shade(normals[t / 25], light)).norm(), 1e-6) << t;
}

/// Bodies beside the object hide sky and sun, and reflect light by their paint.
TEST(VisibleLight, AVehicleBesideItShadesAndReflects) {
  const TexturedMesh mesh = ball(1, 0.1);
  Mesh box = box_mesh(Vec3d(1.5, 6, 2.8));  // higher than the ball: rays that hit it saw the sky before
  for (Vec3d& v : box.vertices) v += Vec3d(2.2, 0, 2.7);
  LightSurroundings open, beside;
  open.roof = open.deck = {Vec2d::Zero(), Vec2d::Zero()};
  beside = open;
  beside.beside = std::make_shared<const Mesh>(box);
  Lighting even;
  even.hemisphere = even.sun = Vec3d::Zero();
  beside.paint = Vec3d::Ones();  // as bright as the sky
  EXPECT_LT(largest_difference(light_of(mesh, even, &open).factor, light_of(mesh, even, &beside).factor),
            1e-5);
  beside.paint = Vec3d::Zero();
  const auto bright = light_of(mesh, even, &open).factor, dark = light_of(mesh, even, &beside).factor;
  double darkest = 1;
  for (std::size_t t = 0; t < bright.size(); ++t) {
    EXPECT_LE(dark[t].x(), bright[t].x() + 1e-5);
    darkest = std::min(darkest, dark[t].x() / bright[t].x());
  }
  EXPECT_LT(darkest, 0.8);

  const auto sunny = [&](const Vec3d& to_sun, const LightSurroundings& around) {
    Lighting light;
    light.to_sun_velo = to_sun.normalized();
    const LightVisibility seen = find_visibility(mesh, light, &around);
    return std::accumulate(seen.sun.begin(), seen.sun.end(), 0.0f);
  };
  const Vec3d towards(2.2, 0, 2.1), away(-2.2, 0, 2.1);
  EXPECT_GT(sunny(towards, open), 10);
  EXPECT_EQ(sunny(towards, beside), 0);
  EXPECT_EQ(sunny(away, beside), sunny(away, open));
}

/// A side is split into parts with their own light where another part of the object is above it.
TEST(VisibleLight, EnclosedSidesHaveMoreNodes) {
  TexturedMesh mesh{{}, {5, {}}};
  mesh.mesh.vertices = {{0, 0, 0}, {.2, 0, 0}, {0, .2, 0}};
  mesh.mesh.faces = {{0, 1, 2}};
  mesh.atlas.texels.assign(mesh.atlas.per_face(), Vec3d::Constant(0.5));
  const Vec3d eye(0.06, 0.06, 30);  // 2.2e-5 sr
  const auto parts = [&](const TexturedMesh& of) {
    const LightVisibility found = find_visibility(of, {}, nullptr, &eye);
    return found.parts[found.side(0)];
  };
  EXPECT_EQ(parts(mesh), 1);
  const auto with_wall = [&](double height) {
    TexturedMesh more = mesh;
    more.mesh.vertices.insert(more.mesh.vertices.end(),
                              {{-.05, -.05, -.1}, {-.05, .25, -.1}, {-.05, 0, height}});
    more.mesh.faces.push_back({3, 4, 5});
    more.atlas.texels.resize(2 * more.atlas.per_face(), Vec3d::Constant(0.5));
    return more;
  };
  EXPECT_EQ(parts(with_wall(0.05)), 1);  // 20 degrees above the middle
  EXPECT_EQ(parts(with_wall(0.5)), 2);   // 75 degrees: parts of no more than 6e-6 sr
  VisibleLightSettings settings;
  settings.open_below = 1;
  const LightVisibility open = find_visibility(with_wall(0.5), {}, nullptr, &eye, settings);
  EXPECT_EQ(open.parts[open.side(0)], 1);
}

/// A texel's own light equals that of a face in its place: the light model resolves texels that appear large.
TEST(VisibleLight, ATexelsLightIsThatOfAFaceInItsPlace) {
  // A wall on a plate, with texels of 2 cm to 8 cm: dark in the corner, bright above.
  TexturedMesh whole{{}, {4, {}}};
  whole.mesh.vertices = {{0, -.4, 0}, {0, .4, 0}, {0, 0, .5}, {-.6, -.5, 0}, {-.6, .5, 0}, {.01, 0, -.01}};
  whole.mesh.faces = {{0, 2, 1}, {3, 5, 4}};
  whole.atlas.texels.assign(2 * whole.atlas.per_face(), Vec3d::Constant(0.7));
  Lighting light;
  light.to_sun_velo = Vec3d(-0.3, 0.1, 0.9).normalized();
  const Vec3d eye(-3, 0, 1);
  VisibleLightSettings settings;
  settings.node_angle = 0;
  settings.directions = settings.rough_directions = 4096;
  const auto light_at = [&](const TexturedMesh& mesh) {
    return visible_light(face_normals(mesh.mesh), mesh.atlas.texels, light,
                         find_visibility(mesh, light, nullptr, &eye, settings), settings.bounces);
  };
  const TexturedMesh parts = texels_as_faces(whole);
  const auto by_texel = light_at(whole), by_face = light_at(parts);
  settings.node_angle = settings.enclosed_node_angle = 1;
  const auto coarse = light_at(whole);
  double fine_error = 0, coarse_error = 0;
  for (std::size_t t = 0; t < whole.atlas.per_face(); ++t) {
    const double whole_light = by_face.factor[t].norm();
    fine_error = std::max(fine_error, (by_texel.factor[t] - by_face.factor[t]).norm() / whole_light);
    coarse_error = std::max(coarse_error, (coarse.factor[t] - by_face.factor[t]).norm() / whole_light);
    EXPECT_LT((by_texel.gloss[t] - by_face.gloss[t]).norm(), 0.2 * by_face.gloss[t].norm()) << t;
  }
  std::printf("a texel's light: worst error %.1f %%, of the face's whole %.1f %%\n", 100 * fine_error,
              100 * coarse_error);
  EXPECT_LT(fine_error, 0.03);
  EXPECT_GT(coarse_error, 0.1);
}

/// A wall casts a straight shadow border over a plate in close view. The plate's light is as fine as the
/// camera's resolution, and dark where the wall's plane hides the sun.
TEST(VisibleLight, AShadowsBorderRunsThroughTexels) {
  TexturedMesh scene{{}, {3, {}}};
  scene.mesh.vertices = {{-2, -1, 0}, {2, -1, 0}, {0, 2, 0}, {0.1, -9, 0}, {0.1, 9, 0}, {0.1, 0, 9}};
  scene.mesh.faces = {{0, 1, 2}, {3, 4, 5}};
  scene.atlas.texels.assign(2 * scene.atlas.per_face(), Vec3d::Constant(0.5));
  Lighting light;
  light.to_sun_velo = Vec3d(0.3, 0, 1).normalized();  // behind the wall for x < 0.1
  const Vec3d eye(-1, 0, 12);
  const auto wrong = [&](double sun_angle) {
    VisibleLightSettings settings;
    settings.sun_angle = sun_angle;
    const LightVisibility v = find_visibility(scene, light, nullptr, &eye, settings);
    const std::vector<Vec2d> centroids = texel_centroids(50);
    double mistaken = 0;
    for (const Vec2d& b : centroids) {
      const double x = -2 * b.x() + 2 * b.y();  // of vertices 0, 1 and 2
      const auto part = as_size(texel_index<double>(b.x(), b.y(), v.shown.resolution_of(0)));
      // At that height the wall is as wide as its triangle: it covers all of the plate's shadow.
      mistaken += std::abs(v.sun[part] - (x > 0.1 ? 1.0 : 0.0));
    }
    EXPECT_EQ(v.texels_of_parts(0).size(), v.shown.texels_of(0));
    return mistaken / static_cast<double>(centroids.size());
  };
  const double whole = wrong(1), halves = wrong(1.5e-3), finest = wrong(1e-9);
  std::printf("lit wrongly: %.1f %% by texels, %.1f %% by parts, %.1f %% by 4 x 4\n", 100 * whole,
              100 * halves, 100 * finest);
  EXPECT_LT(finest, 0.4 * whole);
  EXPECT_LT(halves, whole);
  EXPECT_GT(halves, finest);
}

/// White furnace: under uniform light a convex object has the lobes' whole shares, for any raster of rays.
TEST(VisibleLight, InAnEvenLightTheGlossIsItsShareOfIt) {
  const TexturedMesh convex = ball(1, 0, 2, 1);
  Lighting even;
  even.ambient = Vec3d(1, 2, 3);
  even.hemisphere = even.sun = Vec3d::Zero();
  const Vec3d eye(-6, 1, 0.8);
  const auto normals = face_normals(convex.mesh);
  int seen = 0;
  for (const int directions : {32, 512}) {
    VisibleLightSettings settings;
    settings.directions = directions;
    const auto light_with = [&](bool glossy) {
      settings.glossy = glossy;
      const LightVisibility visibility = find_visibility(convex, even, nullptr, &eye, settings);
      return visible_light(normals, convex.atlas.texels, even, visibility, 2);
    };
    const auto matt = light_with(false), lit = light_with(true);
    for (std::size_t f = 0; f < normals.size(); ++f) {
      const Face& face = convex.mesh.faces[f];
      Vec3d centre = Vec3d::Zero();
      for (const int v : face) centre += convex.mesh.vertices[as_size(v)] / 3;
      const double cosine = normals[f].normalized().dot((eye - centre).normalized());
      if (cosine < 0.1) continue;
      ++seen;
      ASSERT_LT((lit.gloss[f] - specular_albedo(cosine) * even.ambient).norm(), 1e-4) << f;
      ASSERT_NEAR(lit.factor[f].x(), 1, 0.25);  // Burley's lobe at grazing views
      ASSERT_LT((lit.factor[f] - lit.factor[f].x() * even.ambient).norm(), 1e-6) << f;
      ASSERT_EQ(matt.gloss[f], Vec3d::Zero());
      ASSERT_LT((matt.factor[f] - even.ambient).norm(), 1e-6);
    }
  }
  EXPECT_GT(seen, 100);
}

/// Two parallel plates: the lower one sees the sky past the upper one, but not the sun.
TEST(VisibleLight, APlateOverAnotherHidesSkyAndSunByItsFormFactor) {
  const auto plate = [](double z, double half, bool up) {
    Mesh mesh;
    mesh.vertices = {{-half, -half, z}, {half, -half, z}, {half, half, z}, {-half, half, z}};
    mesh.faces = {{0, 1, 2}, {0, 2, 3}};
    if (!up) mesh.faces = {{0, 2, 1}, {0, 3, 2}};
    return mesh;
  };
  TexturedMesh plates{plate(0, 0.01, true), {1, {}}};
  append(plates.mesh, plate(0.5, 0.5, false), Transform::Identity());
  plates.atlas.texels.assign(4, Vec3d::Zero());
  Lighting light;
  light.to_sun_velo = Vec3d::UnitZ();
  light.ambient = Vec3d::Ones();
  light.hemisphere = Vec3d::Zero();
  VisibleLightSettings settings;
  settings.directions = 16384;
  // Form factor from a small plate to a parallel square of side 2a at distance a over its middle (Howell's
  // catalogue, B-3): 4 quarters with X = Y = 1.
  const double quarter = 2 / std::sqrt(2.0) * std::atan(1 / std::sqrt(2.0)) / (2 * M_PI);
  EXPECT_NEAR(light_of(plates, light, nullptr, settings).factor[0].x(), 1 - 4 * quarter, 2e-3);
  // An upper plate of albedo ρ without its own light reflects ρ times the incoming light.
  plates.atlas.texels.assign(4, Vec3d::Constant(0.5));
  const double lit_from_below = light_of(plates, light, nullptr, settings).factor[2].x();
  EXPECT_NEAR(light_of(plates, light, nullptr, settings).factor[0].x(),
              1 - 4 * quarter + 4 * quarter * 0.5 * lit_from_below, 3e-3);
  settings.directions = VisibleLightSettings().directions;
  EXPECT_NEAR(light_of(plates, light, nullptr, settings).factor[0].x(),
              1 - 4 * quarter + 4 * quarter * 0.5 * lit_from_below, 0.04);
}

TEST(VisibleLight, RoofAndRoadLightAFaceFromBelow) {
  // A small plate facing down over the middle of a wide roof receives the roof's whole radiance.
  TexturedMesh plate;
  plate.mesh.vertices = {{-0.01, -0.01, 0.3}, {0.01, 0, 0.3}, {0, 0.01, 0.3}};
  plate.mesh.faces = {{0, 2, 1}};
  plate.atlas = {1, {Vec3d::Zero()}};
  Lighting light;
  LightSurroundings around;
  around.roof = {Vec2d(-30, -30), Vec2d(30, 30)};
  around.paint = Vec3d(0.6, 0.3, 0.1);
  VisibleLightSettings settings;
  settings.directions = 4096;
  const auto direct = [&](const Lighting& by, const Vec3d& albedo) {
    const Vec3d colour =
        albedo.cwiseProduct(by.ambient + by.hemisphere + std::max(0.0, by.to_sun_velo.z()) * by.sun);
    return Vec3d(colour + light_of_gloss(by));
  };
  EXPECT_LT((light_of(plate, light, &around, settings).factor[0] - direct(light, around.paint)).norm(), 5e-3);
  // A low sun: most of the light from below is its glint.
  Lighting low = light;
  low.to_sun_velo = Vec3d(1, 0, 0.15).normalized();
  const Vec3d glinting = light_of(plate, low, &around, settings).factor[0];
  EXPECT_LT((glinting - direct(low, around.paint)).norm(), 5e-3);
  around.roof = {Vec2d(-1e-3, -1e-3), Vec2d(1e-3, 1e-3)};  // no roof, no deck: the road
  around.deck = around.roof;
  // Under a uniform sky the road's gloss reflects its share upwards, and so does its colour.
  Lighting even = light;
  even.hemisphere = even.sun = Vec3d::Zero();
  EXPECT_LT((light_of(plate, even, &around, settings).factor[0] - direct(even, around.road)).norm(),
            5e-3 * even.ambient.norm());
  // The sun's part is more than the diffuse share alone, and less than twice that.
  const Vec3d sunlit = light_of(plate, light, &around, settings).factor[0];
  for (int c = 0; c < 3; ++c) {
    EXPECT_GT(sunlit[c], direct(light, Vec3d::Zero())[c]);
    EXPECT_NEAR(sunlit[c] / direct(light, around.road)[c], 1, 0.05);  // Burley's lobe for Lambert's
  }
}

/// A roof that is part of the object lights a face above it as the vehicle's roof does, under sky and sun.
TEST(VisibleLight, ThePartsOfAnObjectMirrorLightToEachOther) {
  TexturedMesh plates;
  plates.mesh.vertices = {{-0.01, -0.01, 0.3}, {0.01, 0, 0.3}, {0, 0.01, 0.3},
                          {-60, -60, 0},       {60, -60, 0},   {0, 90, 0}};
  plates.mesh.faces = {{0, 2, 1}, {3, 4, 5}};
  plates.atlas = {1, {Vec3d::Zero(), Vec3d(0.6, 0.3, 0.1)}};
  Lighting light;
  light.ambient = Vec3d(0.2, 0.3, 0.4);
  light.hemisphere.setZero();
  VisibleLightSettings settings;
  settings.directions = 4096;
  settings.rough_directions = 1024;
  const Vec3d eye(0.1, 0, 0.1);  // between the two: it sees both
  for (const double height : {0.15, 1.0}) {
    light.to_sun_velo = Vec3d(1, 0, height).normalized();
    const auto lit = visible_light(face_normals(plates.mesh), plates.atlas.texels, light,
                                   find_visibility(plates, light, nullptr, &eye, settings), 2);
    const Vec3d colour =
        plates.atlas.texels[1].cwiseProduct(light.ambient + light.to_sun_velo.z() * light.sun);
    EXPECT_LT((lit.sky[0] - colour - light_of_gloss(light)).norm(), 1e-2) << height;
  }
}

TEST(VisibleLight, GradientAgainstCentralDifferencesWithVisibilityFixed) {
  Lighting light;
  light.to_sun_velo = Vec3d(-0.5, 0.2, 0.6).normalized();
  const LightSurroundings around;
  double worst = 0;
  int checked = 0;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const TexturedMesh at = ball(seed, seed == 1 ? 0 : 0.25);
    const Vec3d eye(-6, 1, 0.8);  // seed 3: without a camera
    VisibleLightSettings settings;
    settings.node_angle = seed == 4 ? 0 : seed == 1 ? 5e-4 : 1;    // all, some or none of the sides
    settings.sun_angle = seed == 4 ? 1e-4 : seed == 5 ? 1e-6 : 1;  // texels in parts: some, as many as can be
    const LightVisibility visibility =
        find_visibility(at, light, seed == 2 ? nullptr : &around, seed == 3 ? nullptr : &eye, settings);
    ASSERT_GT(visibility.reflections.size(), 0u + (seed == 1 ? 0 : 100));
    const std::size_t texels = at.atlas.texels.size(), shown = visibility.sun.size();
    ASSERT_EQ(shown > texels, seed >= 4);
    RandomStream random(seed, "upstream");
    std::vector<Vec3d> d_factor(shown), d_gloss(shown);
    for (auto* list : {&d_factor, &d_gloss})
      for (Vec3d& d : *list) d = Vec3d{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
    const auto loss = [&](const std::vector<double>& x) {
      std::vector<Vec3d> normals, albedo;
      for (std::size_t i = 0; 3 * i < x.size(); ++i)
        (i < visibility.faces ? normals : albedo).emplace_back(x[3 * i], x[3 * i + 1], x[3 * i + 2]);
      const auto lit = visible_light(normals, albedo, light, visibility, 3);
      double sum = 0;
      for (std::size_t k = 0; k < shown; ++k)
        sum += d_factor[k].dot(lit.factor[k]) + d_gloss[k].dot(lit.gloss[k]);
      return sum;
    };
    const std::vector<Vec3d> normals = face_normals(at.mesh);
    std::vector<double> x, gradient;
    for (const auto* list : {&normals, &at.atlas.texels})
      for (const Vec3d& v : *list) x.insert(x.end(), v.data(), v.data() + 3);
    std::vector<Vec3d> d_normals(normals.size(), Vec3d::Zero()), d_texels(texels, Vec3d::Zero());
    visible_light_vjp(normals, at.atlas.texels, light, visibility,
                      visible_light(normals, at.atlas.texels, light, visibility, 3), d_factor, d_gloss,
                      d_normals, d_texels);
    for (const auto* list : {&d_normals, &d_texels})
      for (const Vec3d& v : *list) gradient.insert(gradient.end(), v.data(), v.data() + 3);
    const auto check = test::check_gradient(loss, x, gradient, 1e-7, 1e-5, 0.1);
    worst = std::max(worst, check.worst);
    checked += check.checked;
  }
  std::printf("visible light: %d components, worst relative error %.2e\n", checked, worst);
}

TEST(VisibleLight, DegenerateMeshesGiveNumbers) {
  const Lighting light;
  const LightSurroundings around;
  for (int kind = 0; kind < 5; ++kind) {
    TexturedMesh mesh = ball(7, 0.2);
    for (Vec3d& v : mesh.mesh.vertices) {
      if (kind == 0) v = Vec3d(1, 2, 3);          // a point
      if (kind == 1) v = Vec3d(v.x(), 0, 0);      // a line
      if (kind == 2) v = Vec3d(v.x(), v.y(), 0);  // flat, on the roof itself
      if (kind == 3) v.z() *= 1e-7;               // needles
    }
    if (kind == 4)
      for (Face& f : mesh.mesh.faces) std::swap(f[1], f[2]);  // inside out
    const auto normals = face_normals(mesh.mesh);
    const Vec3d eye(-6, 1, 0.8);
    const auto visibility = find_visibility(mesh, light, &around, &eye);
    const auto lit = visible_light(normals, mesh.atlas.texels, light, visibility, 3);
    std::vector<Vec3d> d_normals(normals.size(), Vec3d::Zero()),
        d_texels(mesh.atlas.texels.size(), Vec3d::Zero());
    const std::vector<Vec3d> ones(lit.factor.size(), Vec3d::Ones());
    visible_light_vjp(normals, mesh.atlas.texels, light, visibility, lit, ones, ones, d_normals, d_texels);
    for (const std::vector<Vec3d>* list :
         {&lit.factor, &lit.gloss, &std::as_const(d_normals), &std::as_const(d_texels)})
      for (const Vec3d& v : *list) ASSERT_TRUE(v.allFinite()) << "kind " << kind;
    for (const Vec3d& v : lit.factor) ASSERT_GE(v.minCoeff(), 0);
    for (const Vec3d& v : lit.factor) {
      ASSERT_TRUE(kind >= 2 || (v - light.ambient).norm() < 1e-12) << "kind " << kind;
    }
  }
}

TEST(VisibleLight, DoesNotDependOnTheThreadCount) {
  const TexturedMesh mesh = ball(3, 0.3, 2, 5);
  const LightSurroundings around;
  const int before = thread_count();
  set_thread_count(1);
  const auto one = light_of(mesh, Lighting(), &around);
  set_thread_count(3);
  const auto three = light_of(mesh, Lighting(), &around);
  set_thread_count(before);
  EXPECT_EQ(largest_difference(one.factor, three.factor), 0);
}

TEST(VisibleLight, FewerDirectionsStayNearMany) {
  const TexturedMesh mesh = ball(5, 0.2, 2, 5);
  const LightSurroundings around;
  VisibleLightSettings many;
  many.directions = 8192;
  many.rough_directions = 2048;
  const auto reference = light_of(mesh, Lighting(), &around, many);
  for (int directions : {32, 64, 128, 256}) {
    VisibleLightSettings few;
    few.directions = directions;
    const auto lit = light_of(mesh, Lighting(), &around, few);
    double error = 0, mean = 0;
    for (std::size_t t = 0; t < lit.factor.size(); ++t) {
      error += (lit.factor[t] - reference.factor[t]).cwiseAbs().sum();
      mean += reference.factor[t].sum();
    }
    std::printf("%d directions: mean error %.2f %% of the mean light\n", directions, 100 * error / mean);
    EXPECT_LT(error / mean, 1.0 / std::sqrt(directions));
  }
}

TEST(VisibleLight, UnknownWordsAreRefused) {
  EXPECT_EQ(parse_word<LightModel>("plain", "light"), LightModel::plain);
  EXPECT_EQ(parse_word<LightModel>(to_word(LightModel::visible), "light"), LightModel::visible);
  EXPECT_EQ(parse_word<LightModel>("fine", "light"), LightModel::fine);
  EXPECT_THROW(parse_word<LightModel>("radiosity", "light"), InputError);
}

}  // namespace
}  // namespace mirage
