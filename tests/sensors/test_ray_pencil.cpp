// Rays of one pencil against the ray caster (Embree), and cases at edges.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "base/error.h"
#include "base/random.h"
#include "base/sizes.h"
#include "geometry/mesh.h"
#include "sensors/ray_caster.h"
#include "sensors/ray_pencil.h"
#include "support/instruction_sets.h"

namespace mirage {
namespace {

Vec3d random_direction(RandomStream& random) {
  Vec3d direction;
  do direction = Vec3d{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
  while (direction.norm() < 0.1 || direction.norm() > 1);
  return direction.normalized();
}

/// A ball about `centre` with faces that intersect and hide each other.
Mesh crumpled(int subdivisions, std::uint64_t seed, const Vec3d& centre) {
  RandomStream random(seed, "pencil mesh");
  Mesh mesh = icosphere(subdivisions);
  for (Vec3d& v : mesh.vertices) v = random.uniform(0.3, 1) * v + centre;
  return mesh;
}

Vec3f on_face(const Mesh& mesh, int face, double b1, double b2, const Vec3d& centre) {
  const Face& f = mesh.faces[as_size(face)];
  const auto corner = [&](int k) { return mesh.vertices[as_size(f[as_size(k)])]; };
  return ((1 - b1 - b2) * corner(0) + b1 * corner(1) + b2 * corner(2) - centre).cast<float>();
}

struct Count {
  int rays = 0, met = 0, other = 0;
};
/// Compares rays from `starts` along directions[i] between the ray caster and the pencil. Counts hits that
/// differ by more than rounding.
void compare(const Mesh& mesh, const Vec3d& centre, const std::vector<Vec3f>& starts,
             const std::vector<Vec3f>& directions, const std::vector<RayPencil::Met>& met, Count& count) {
  const RayCaster caster(std::span(&mesh, 1), centre);
  for (std::size_t i = 0; i < starts.size(); ++i) {
    const Hit hit = caster.intersect({starts[i], directions[i]});
    ++count.rays;
    count.met += hit.hit();
    if (hit.face < 0 || met[i].face < 0) {
      count.other += hit.face != met[i].face;
      continue;
    }
    const Vec3f there = starts[i] + hit.t * directions[i],
                here = on_face(mesh, met[i].face, met[i].b1, met[i].b2, centre);
    count.other += (there - here).norm() > 1e-3f;
  }
}

void parallel_rays_meet_what_the_ray_caster_says() {
  const Vec3d centre(100, -40, 3);
  Count count;
  for (const int subdivisions : {0, 1, 2, 3, 4}) {
    RandomStream random(static_cast<std::uint64_t>(subdivisions), "parallel rays");
    const Mesh mesh = crumpled(subdivisions, 7, centre);
    RayPencil pencil(mesh, centre);
    for (int k = 0; k < 20; ++k) {
      const Vec3f direction = random_direction(random).cast<float>();
      std::vector<Vec3f> starts;
      for (int i = 0; i < 200; ++i) {
        const int face = static_cast<int>(random.uniform() * static_cast<double>(mesh.faces.size()));
        const double b1 = random.uniform(), b2 = random.uniform() * (1 - b1);
        // From a point just off a face, as rays of light start, or from any point.
        starts.push_back(i % 2 ? Vec3f(on_face(mesh, face, b1, b2, centre) + 1e-4f * direction)
                               : Vec3f(random_direction(random).cast<float>() * 1.5f));
      }
      std::vector<RayPencil::Met> met(starts.size());
      pencil.along(3 * direction);
      pencil.intersect(starts, met);
      compare(mesh, centre, starts, std::vector(starts.size(), direction), met, count);
    }
  }
  std::printf("parallel rays: %d of %d meet a face, %d are not where Embree says\n", count.met, count.rays,
              count.other);
  EXPECT_GT(count.met, count.rays / 4);
  EXPECT_LE(count.other, count.rays / 5000);
}

TEST(RayPencil, ParallelRaysMeetWhatTheRayCasterSays) {
  on_every_instruction_set(parallel_rays_meet_what_the_ray_caster_says);
}

void rays_from_one_point_meet_what_the_ray_caster_says() {
  const Vec3d centre(0, 0, 1);
  Count count;
  for (const int subdivisions : {1, 2, 4}) {
    RandomStream random(static_cast<std::uint64_t>(subdivisions), "rays from a point");
    const Mesh mesh = crumpled(subdivisions, 9, centre);
    RayPencil pencil(mesh, centre);
    for (const float distance : {1.5f, 4.0f, 60.0f}) {
      const Vec3f eye = distance * random_direction(random).cast<float>();
      std::vector<Vec3f> targets, starts, directions;
      for (int i = 0; i < 1000; ++i) {
        targets.push_back(random.uniform(0, 1.2) * random_direction(random).cast<float>());
        starts.push_back(eye);
        directions.push_back(targets.back() - eye);
      }
      std::vector<RayPencil::Met> met(targets.size());
      pencil.from(eye, -eye);
      pencil.intersect(targets, met);
      compare(mesh, centre, starts, directions, met, count);
    }
  }
  std::printf("rays from a point: %d of %d meet a face, %d are not where Embree says\n", count.met,
              count.rays, count.other);
  EXPECT_GT(count.met, count.rays / 4);
  EXPECT_LE(count.other, count.rays / 5000);
}

TEST(RayPencil, RaysFromOnePointMeetWhatTheRayCasterSays) {
  on_every_instruction_set(rays_from_one_point_meet_what_the_ray_caster_says);
}

TEST(RayPencil, BarycentricsInPerspective) {
  Mesh mesh;
  mesh.vertices = {{2, 0, 0}, {6, 1, 0}, {3, 0, 2}};
  mesh.faces = {{0, 1, 2}};
  RayPencil pencil(mesh, Vec3d::Zero());
  const Vec3f eye(-1, 0.2f, 0.1f);
  pencil.from(eye, Vec3f::UnitX());
  const std::vector<Vec3f> targets = {on_face(mesh, 0, 0.6, 0.3, Vec3d::Zero())};
  std::vector<RayPencil::Met> met(1);
  pencil.intersect(targets, met);
  ASSERT_EQ(met[0].face, 0);
  EXPECT_NEAR(met[0].b1, 0.6, 1e-5);
  EXPECT_NEAR(met[0].b2, 0.3, 1e-5);
}

TEST(RayPencil, NothingIsMetWhereNothingIs) {
  constexpr float nan = std::numeric_limits<float>::quiet_NaN();
  Mesh mesh;
  mesh.vertices = {{0, 0, 5}, {2, 0, 5}, {0, 2, 5}};
  mesh.faces = {{0, 1, 2}, {0, 0, 1}};
  RayPencil pencil(mesh, Vec3d::Zero());
  std::vector<RayPencil::Met> met(4);
  const std::vector<Vec3f> points = {{0.5f, 0.5f, 0}, {0.5f, 0.5f, 9}, {3, 3, 0}, {nan, 0, 0}};
  pencil.along(Vec3f::UnitZ());
  pencil.intersect(points, met);
  EXPECT_EQ(met[0].face, 0);
  EXPECT_EQ(met[1].face, -1);  // it starts behind
  EXPECT_EQ(met[2].face, -1);
  EXPECT_EQ(met[3].face, -1);
  pencil.along(-Vec3f::UnitZ());  // the opposite direction
  pencil.intersect(points, met);
  EXPECT_EQ(met[0].face, -1);
  EXPECT_EQ(met[1].face, 0);
  pencil.along(Vec3f::UnitX());  // edge on
  pencil.intersect(points, met);
  for (const RayPencil::Met& none : met) EXPECT_EQ(none.face, -1);
  pencil.from(Vec3f(0.5f, 0.5f, 9), Vec3f::UnitZ());  // all of it is behind the eye
  pencil.intersect(points, met);
  for (const RayPencil::Met& none : met) EXPECT_EQ(none.face, -1);

  RayPencil empty(Mesh(), Vec3d::Zero());
  empty.along(Vec3f::UnitZ());
  empty.intersect(points, met);
  for (const RayPencil::Met& none : met) EXPECT_EQ(none.face, -1);
  mesh.vertices.assign(3, Vec3d::Zero());  // a point
  RayPencil point(mesh, Vec3d::Zero());
  point.along(Vec3f::UnitZ());
  point.intersect(points, met);
  for (const RayPencil::Met& none : met) EXPECT_EQ(none.face, -1);

  mesh.vertices[1].x() = std::numeric_limits<double>::infinity();
  EXPECT_THROW(RayPencil(mesh, Vec3d::Zero()), InputError);
  met.resize(2);
  EXPECT_THROW(pencil.intersect(points, met), Failure);
}

}  // namespace
}  // namespace mirage
