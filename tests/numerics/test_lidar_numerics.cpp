// The LiDAR at its extremes: no NaN or Inf, no crash, float results within a stated bound of double, and
// bounded gradients.
#include <gmock/gmock.h>

#include <cmath>
#include <limits>

#include "base/error.h"
#include "base/sizes.h"
#include "lidar_extremes.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::dented_ball;
using test::insert;
using test::kGrazing;
using test::kSteepest;
using test::lidar_frame;
using test::lidar_of_32;
using test::Outcome;

Mesh one_face(const Vec3d& a, const Vec3d& b, const Vec3d& c) {
  Mesh mesh;
  mesh.vertices = {a, b, c};
  mesh.faces = {{0, 1, 2}};
  return mesh;
}

std::array<Vec3d, 3> corners_of(const Mesh& mesh, int face) {
  const Face& f = mesh.faces[as_size(face)];
  return {mesh.vertices[as_size(f[0])], mesh.vertices[as_size(f[1])], mesh.vertices[as_size(f[2])]};
}

/// Expects the gradient of one return to be bounded, for a unit upstream gradient.
void expect_bounded(const std::array<Vec3d, 3>& d_face, const FaceReturn<double>& hit, double reflectivity) {
  for (int k = 0; k < 3; ++k) {
    const Vec3d& d = d_face[as_size(k)];
    ASSERT_TRUE(d.allFinite());
    ASSERT_LE(d.norm(),
              (std::abs(hit.barycentric[k]) / kGrazing + 2 * reflectivity / kThinFace) * (1 + 1e-9));
  }
}

TEST(LidarExtremes, NoRayLeaksThroughEdgesAndVerticesOfAClosedMesh) {
  // Rays from inside to points of every edge and to every vertex, on meshes of several sizes and places.
  for (const double radius : {0.3, 1.0, 50.0})
    for (const Vec3d& centre : {Vec3d(0, 0, 0), Vec3d(12, -3, 1)}) {
      Mesh mesh = dented_ball(centre, radius, 5, 2).mesh;
      const RayCaster caster(std::span(&mesh, 1));
      int rays = 0;
      for (const Face& face : mesh.faces)
        for (int k = 0; k < 3; ++k) {
          const Vec3d a = mesh.vertices[as_size(face[as_size(k)])],
                      b = mesh.vertices[as_size(face[as_size((k + 1) % 3)])];
          for (const double s : {0.0, 0.1, 0.37, 0.5, 0.9}) {
            const Vec3d target = a + s * (b - a);
            for (const Vec3d& from : {centre, Vec3d(centre + radius * Vec3d(0.3, -0.2, 0.1))}) {
              const Hit hit =
                  caster.intersect({from.cast<float>(), (target - from).normalized().cast<float>()});
              ++rays;
              ASSERT_TRUE(hit.hit()) << "leak at radius " << radius;
              ASSERT_NEAR(hit.t, (target - from).norm(), 1e-4 * radius);
            }
          }
        }
      EXPECT_EQ(rays, 320 * 3 * 5 * 2);
    }
}

TEST(LidarExtremes, PacketsDoNotLeakEither) {
  Mesh mesh = dented_ball(Vec3d(0, 0, 0), 1, 5, 2).mesh;
  const RayCaster caster(std::span(&mesh, 1));
  RayTable rays(mesh.faces.size(), 16);
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const auto face = corners_of(mesh, static_cast<int>(f));
    for (std::size_t i = 0; i < 16; ++i) {
      const double s = static_cast<double>(i % 8) / 7;
      const Vec3d target = i < 8 ? face[0] + s * (face[1] - face[0]) : face[1] + s * (face[2] - face[1]);
      rays.set(f, i, Vec3f::Zero(), target.normalized().cast<float>());
    }
  }
  for (int width : {1, 4, 8, 16}) {
    HitTable hits;
    caster.intersect(rays, 0, 10, hits, width);
    for (int face : hits.face) ASSERT_GE(face, 0) << width;
  }
}

TEST(LidarExtremes, RaysInTheFacesPlaneAlongEdgesAndThroughVertices) {
  const Mesh mesh = one_face(Vec3d(5, 0, 0), Vec3d(6, 0, 0), Vec3d(5, 1, 0));
  const RayCaster caster(std::span(&mesh, 1));
  const auto face = corners_of(mesh, 0);
  // In the plane: along the first edge, across the face, through a vertex.
  for (const auto& [from, towards] :
       {std::pair(Vec3d(0, 0, 0), Vec3d(1, 0, 0)), std::pair(Vec3d(0, 0.3, 0), Vec3d(1, 0, 0)),
        std::pair(Vec3d(5, -3, 0), Vec3d(0, 1, 0)),
        std::pair(Vec3d(7, 0, 0), Vec3d(-1, 0.5, 0).normalized())}) {
    const Hit hit = caster.intersect({from.cast<float>(), towards.cast<float>()});
    EXPECT_TRUE(!hit.hit() || std::isfinite(hit.t));
    const auto exact = intersect_face<double>(from, towards, face, 0.5);
    EXPECT_FALSE(exact.valid);
    for (const Vec3d& d :
         intersect_face_vjp<double>(towards, face, exact, 0.5, kGrazing, Vec3d(1, 1, 1), 1.0))
      EXPECT_TRUE(d.isZero());
  }
  // Out of the plane by ever smaller angles.
  for (double tilt = 1e-1; tilt > 1e-300; tilt *= 1e-3) {
    const Vec3d towards = Vec3d(1, 0.02, -tilt).normalized();
    const Vec3d from = Vec3d(5.2, 0.2, 0) - 5 * towards;
    const auto exact = intersect_face<double>(from, towards, face, 0.5);
    if (!exact.valid) continue;
    expect_bounded(intersect_face_vjp<double>(towards, face, exact, 0.5, kGrazing, Vec3d(1, 0, 0), 0.0),
                   exact, 0.5);
    EXPECT_TRUE(std::isfinite(exact.range)) << tilt;
    EXPECT_TRUE(exact.reflectance >= 0 && exact.reflectance <= 0.5) << tilt;
  }
}

TEST(LidarExtremes, FacesWithoutAreaAndNeedles) {
  const PreparedFrame prepared = lidar_frame(lidar_of_32());
  TexturedMesh odd;
  odd.atlas.resolution = 1;
  const Vec3d at(8, 0.1, -0.5);
  odd.mesh.vertices = {at,
                       at,
                       at + Vec3d(0, 1, 0),
                       at + Vec3d(0, 0.5, 0),  // repeated, collinear
                       at + Vec3d(0.1, 0, 0.3),
                       at + Vec3d(0.1, 1, 0.3),
                       at + Vec3d(0.1, 0.5, 0.3 + 1e-6),
                       at + Vec3d(0.2, 0, -0.3),
                       at + Vec3d(0.2, 1, -0.3),
                       at + Vec3d(0.2, 0.5, 0.3)};
  odd.mesh.faces = {{0, 1, 2}, {0, 0, 0}, {1, 2, 3}, {4, 5, 6}, {7, 8, 9}};
  odd.atlas.texels.assign(odd.mesh.faces.size(), Vec3d::Constant(0.5));
  const Outcome outcome = insert(prepared, odd);
  EXPECT_GT(outcome.tape.returns.size(), 10u);  // on the last, ordinary face
  EXPECT_LE(outcome.steepest, kSteepest);
  // Needles of 1e6 : 1 straight in front of a ray, turned to all sides.
  RandomStream random(1, "needles");
  for (int i = 0; i < 300; ++i) {
    const LidarRay ray = [&](int beam) {
      return prepared.lidar.ray(beam, random.below(400) + 40);
    }(random.below(32));
    const Vec3d centre = ray.origin + random.uniform(2, 60) * ray.direction;
    const Vec3d along = Vec3d{random.normal(), random.normal(), random.normal()}.normalized(),
                side = along.unitOrthogonal();
    TexturedMesh needle;
    needle.mesh = one_face(centre - along, centre + along, centre + 2e-6 * side);
    needle.atlas.resolution = 1;
    needle.atlas.texels = {Vec3d::Constant(0.5)};
    const Outcome one = insert(prepared, needle);
    EXPECT_LE(one.steepest, kSteepest);
    for (const auto& back : one.tape.returns) {
      const Vec3d p = back.ray.origin + back.range * back.ray.direction;
      EXPECT_LT((p - centre).norm(), 1.1);  // on the needle, however its plane is rounded
    }
  }
}

TEST(LidarExtremes, ObjectsFromNearToFar) {
  for (const double range : {0.3, 1.0, 10.0, 100.0, 500.0}) {
    const PreparedFrame prepared = lidar_frame(lidar_of_32());
    const LidarRay ray = prepared.lidar.ray(6, 230);
    const TexturedMesh object =
        dented_ball(ray.origin + range * ray.direction, std::min(0.8, range / 2), 7, 2);
    const Outcome outcome = insert(prepared, object);
    EXPECT_GT(outcome.tape.returns.size(), 0u) << range;
    EXPECT_LE(outcome.steepest, kSteepest);
    // Float tracing selects the face, double computes the point: within 1e-9 of the face, and within 1e-4 of
    // float alone.
    const RayCaster caster(std::span(&object.mesh, 1));
    for (const auto& back : outcome.tape.returns) {
      Vec3d on_face = Vec3d::Zero();
      const auto face = corners_of(object.mesh, back.face);
      for (int k = 0; k < 3; ++k) on_face += back.hit.barycentric[k] * face[as_size(k)];
      ASSERT_LT((back.ray.origin + back.hit.range * back.ray.direction - on_face).norm(), 1e-8 * (1 + range));
      const Hit hit = caster.intersect({back.ray.origin.cast<float>(), back.ray.direction.cast<float>()});
      if (hit.hit() && hit.face == back.face) {
        ASSERT_NEAR(hit.t, back.hit.range, 1e-5 * (1 + range) / std::max(0.01, back.hit.reflectance / 0.5));
      }
    }
  }
}

TEST(LidarExtremes, CoordinatesFarFromTheOrigin) {
  // The unit and the object 1e5 m away: the same returns as at the origin, within double precision there.
  const TexturedMesh near_object = dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 1, 2);
  const Outcome near_outcome = insert(lidar_frame(lidar_of_32()), near_object);
  const Vec3d offset(1e5, -1e5, 1e5);
  LidarModel lidar = lidar_of_32();
  lidar.velo_from_lidar.translation() = offset;
  TexturedMesh object = near_object;
  for (Vec3d& v : object.mesh.vertices) v += offset;
  const Outcome outcome = insert(lidar_frame(lidar), object);
  ASSERT_EQ(outcome.tape.returns.size(), near_outcome.tape.returns.size());
  for (std::size_t i = 0; i < outcome.tape.returns.size(); ++i) {
    const auto &a = near_outcome.tape.returns[i], &b = outcome.tape.returns[i];
    ASSERT_NEAR(a.range, b.range, 1e-6);
    ASSERT_NEAR(a.hit.reflectance, b.hit.reflectance, 1e-6);
  }
  EXPECT_LE(outcome.steepest, kSteepest);
  // A scene traced in float there has float's resolution of 1/128 m.
  const RayCaster shifted(std::span(&object.mesh, 1));
  const Vec3d from = offset, towards = (Vec3d(9, 0.6, -0.4)).normalized();
  const Hit rough = shifted.intersect({from.cast<float>(), towards.cast<float>()});
  const RayCaster local(std::span(&object.mesh, 1), offset);
  const Hit fine = local.intersect({Vec3f::Zero(), towards.cast<float>()});
  ASSERT_TRUE(rough.hit() && fine.hit());
  EXPECT_NEAR(rough.t, fine.t, 0.05);
}

TEST(LidarExtremes, UnitInsideTheMesh) {
  const PreparedFrame prepared = lidar_frame(lidar_of_32());
  TexturedMesh around = dented_ball(Vec3d(0, 0, 0), 4, 2, 2);
  const Outcome outcome = insert(prepared, around);
  EXPECT_EQ(outcome.tape.returns.size(), 32u * as_size(prepared.lidar.azimuth_count()));
  EXPECT_LE(outcome.steepest, kSteepest);
}

TEST(LidarExtremes, EmptySweepsOddSweepsAndPointsThatAreNotFinite) {
  const LidarModel lidar = lidar_of_32();
  const TexturedMesh object = dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 1);
  const std::size_t alone = insert(lidar_frame(lidar), object).tape.returns.size();
  EXPECT_GT(alone, 50u);
  const float nan = std::nanf(""), inf = std::numeric_limits<float>::infinity(), big = 3e38f;
  Sweep sweep = {{nan, 0, 0, 0},     {0, inf, 0, 0},  {0, 0, -inf, 0.5f}, {0, 0, 0, 0},
                 {big, big, big, 1}, {-big, 1, 0, 1}, {1e-30f, 0, 0, 0},  {5, 5, 0, nan}};
  for (int i = 0; i < 10; ++i) sweep.push_back({20, 1, -0.5f, 0.3f});
  const PreparedFrame prepared = lidar_frame(lidar, sweep);
  EXPECT_EQ(prepared.index.skipped(), 3);
  EXPECT_TRUE(std::isfinite(prepared.index.assigned_share()));
  LidarEffects effects;
  effects.divergence = Vec2d(3e-3, 3e-3);
  for (const LidarEffects& e : {LidarEffects(), effects}) {
    const Outcome outcome = insert(prepared, object, e);
    EXPECT_GT(outcome.tape.returns.size(), alone / 2);
  }
  EXPECT_EQ(SweepIndex(Sweep(), lidar).skipped(), 0);
  EXPECT_EQ(SweepIndex(sweep, LidarModel()).rays_through(Vec3d(9, 0, 0), 1).size(),
            0u);  // a unit without beams
}

TEST(LidarExtremes, MeshesThatAreNotFiniteAreRefused) {
  const TexturedMesh object = dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 1);
  using testing::AllOf;
  using testing::HasSubstr;
  for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity()}) {
    Mesh mesh = object.mesh;
    mesh.vertices[7].y() = bad;
    EXPECT_THAT(test::error_text<InputError>([&] { RayCaster(std::span(&mesh, 1)); }),
                AllOf(HasSubstr("vertex 7"), HasSubstr("not finite")));
  }
  Mesh mesh = object.mesh;
  mesh.faces[3][1] = 42;
  EXPECT_THAT(test::error_text<InputError>([&] { RayCaster(std::span(&mesh, 1)); }), HasSubstr("face 3"));
  mesh.faces[3][1] = -1;
  EXPECT_THAT(test::error_text<InputError>([&] { RayCaster(std::span(&mesh, 1)); }), HasSubstr("face 3"));
}

TEST(LidarExtremes, UpstreamGradientsAreNotAmplifiedByEffects) {
  LidarEffects effects;
  effects.range_sigma = 0.02;
  effects.divergence = Vec2d(3e-3, 3e-3);
  effects.albedo = true;
  effects.velocity = Vec3d(20, 0, 0);
  effects.yaw_rate = 1;
  TexturedMesh object = dented_ball(Vec3d(9, 0.6, -0.4), 0.8, 1);
  for (const double shade : {0.0, 1.0}) {  // all texels black or white
    object.atlas.texels.assign(object.mesh.faces.size(), Vec3d::Constant(shade));
    const Outcome outcome = insert(lidar_frame(lidar_of_32(10)), object, effects);
    EXPECT_LE(outcome.steepest, kSteepest);
    if (shade > 0) {
      EXPECT_GT(outcome.tape.returns.size(), 50u);
    }
  }
}

}  // namespace
}  // namespace mirage
