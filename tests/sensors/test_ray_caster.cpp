#include <gtest/gtest.h>

#include <cmath>

#include "base/parallel.h"
#include "base/random.h"
#include "geometry/mesh.h"
#include "sensors/ray_caster.h"

namespace mirage {
namespace {

Mesh triangle() {
  Mesh mesh;
  mesh.vertices = {{0, 0, 5}, {2, 0, 5}, {0, 2, 5}};
  mesh.faces = {{0, 1, 2}};
  return mesh;
}

TEST(RayCaster, BarycentricsDistanceAndNormal) {
  const std::vector<Mesh> meshes = {triangle()};
  const RayCaster caster(meshes);
  const Hit hit = caster.intersect({{0.5f, 1.0f, 1.0f}, {0, 0, 2}});
  ASSERT_TRUE(hit.hit());
  EXPECT_NEAR(hit.t, 2, 1e-6);  // in units of the direction's length
  EXPECT_NEAR(hit.b1, 0.25, 1e-6);
  EXPECT_NEAR(hit.b2, 0.5, 1e-6);
  EXPECT_EQ(hit.mesh, 0);
  EXPECT_EQ(hit.face, 0);
  EXPECT_NEAR((hit.normal - Vec3f(0, 0, 4)).norm(), 0, 1e-6);
}

TEST(RayCaster, BothSidesCount) {
  const std::vector<Mesh> meshes = {triangle()};
  const RayCaster caster(meshes);
  const Hit hit = caster.intersect({{0.5f, 0.5f, 9.0f}, {0, 0, -1}});
  ASSERT_TRUE(hit.hit());
  EXPECT_NEAR(hit.t, 4, 1e-6);
  EXPECT_GT(hit.normal.z(), 0);  // by the winding, not turned towards the ray
}

TEST(RayCaster, RangeLimitsAndOcclusion) {
  const std::vector<Mesh> meshes = {triangle()};
  const RayCaster caster(meshes);
  EXPECT_TRUE(caster.occluded({{0.5f, 0.5f, 0}, {0, 0, 1}}));
  EXPECT_FALSE(caster.occluded({{0.5f, 0.5f, 0}, {0, 0, 1}, 0, 4.9f}));
  EXPECT_FALSE(caster.occluded({{0.5f, 0.5f, 0}, {0, 0, 1}, 5.1f, 100}));
  EXPECT_FALSE(caster.occluded({{3.5f, 0.5f, 0}, {0, 0, 1}}));
  EXPECT_FALSE(caster.intersect({{3.5f, 0.5f, 0}, {0, 0, 1}}).hit());
}

TEST(RayCaster, MeshesKeepTheirOrderEvenIfEmpty) {
  Mesh second = triangle();
  for (Vec3d& v : second.vertices) v.z() = 3;
  const std::vector<Mesh> meshes = {triangle(), Mesh(), second};
  const RayCaster caster(meshes);
  const Hit hit = caster.intersect({{0.5f, 0.5f, 0}, {0, 0, 1}});
  EXPECT_EQ(hit.mesh, 2);
  EXPECT_NEAR(hit.t, 3, 1e-6);
}

TEST(RayCaster, PacketsOfAnyWidthMeetWhatSingleRaysMeet) {
  const std::vector<Mesh> meshes = {icosphere(4)};
  const RayCaster caster(meshes);
  RayTable rays(33, 101);  // 101: the last packet of a row is not full
  EXPECT_EQ(rays.stride, 112u);
  for (std::size_t row = 0; row < rays.rows; ++row)
    for (std::size_t column = 0; column < rays.columns; ++column) {
      const double elevation = 0.02 * (static_cast<double>(row) - 16),
                   azimuth = 0.01 * (static_cast<double>(column) - 50);
      rays.set(row, column, Vec3f(-4, 0.01f, 0),
               Vec3d(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                     std::sin(elevation))
                   .cast<float>());
    }
  rays.direction[1][rays.index(3, 40)] = std::nanf("");  // hits nothing, and does not affect its neighbours
  rays.origin[0][rays.index(4, 41)] = INFINITY;
  HitTable single;
  caster.intersect(rays, 0.5f, 10, single, 1);
  for (int width : {0, 4, 8, 16}) {
    HitTable hits;
    caster.intersect(rays, 0.5f, 10, hits, width);
    int met = 0, other_face = 0, other_bits = 0;
    for (std::size_t row = 0; row < rays.rows; ++row)
      for (std::size_t column = 0; column < rays.columns; ++column) {
        const std::size_t i = rays.index(row, column);
        ASSERT_EQ(hits.mesh[i] < 0, single.mesh[i] < 0);
        ASSERT_EQ(hits.mesh[i] < 0, hits.face[i] < 0);
        ASSERT_EQ(hits.mesh[i] < 0, hits.t[i] < 0);
        ASSERT_NEAR(hits.t[i], single.t[i], 2e-6);
        met += hits.face[i] >= 0;
        other_face += hits.face[i] != single.face[i];
        other_bits += hits.t[i] != single.t[i] || hits.b1[i] != single.b1[i];
      }
    EXPECT_GT(met, 500);
    EXPECT_LE(other_face, met / 100) << width;  // rays through an edge may take either face
    std::printf("width %d: %d hits, %d on another face, %d with other bits\n", width, met, other_face,
                other_bits);
  }
  EXPECT_EQ(single.mesh[rays.index(3, 40)], -1);
  EXPECT_EQ(single.mesh[rays.index(4, 41)], -1);
}

TEST(RayCaster, EmptySceneMisses) {
  const RayCaster caster(std::span<const Mesh>{});
  EXPECT_FALSE(caster.intersect({{0, 0, 0}, {0, 0, 1}}).hit());
}

TEST(RayCaster, BatchEqualsSingleRaysForAnyThreadCount) {
  const std::vector<Mesh> meshes = {icosphere(3)};
  const RayCaster caster(meshes);
  RandomStream random(1, "rays");
  std::vector<Ray> rays;
  for (int i = 0; i < 20000; ++i) {
    const Vec3d from = 3 * Vec3d{random.normal(), random.normal(), random.normal()}.normalized();
    const Vec3d to = 1.2 * Vec3d{random.normal(), random.normal(), random.normal()}.normalized();
    rays.push_back({from.cast<float>(), (to - from).cast<float>()});
  }
  int found = 0;
  for (int threads : {1, 2}) {
    set_thread_count(threads);
    std::vector<Hit> hits(rays.size());
    caster.intersect(rays, hits);
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const Hit one = caster.intersect(rays[i]);
      ASSERT_EQ(hits[i].t, one.t);
      ASSERT_EQ(hits[i].face, one.face);
      if (!one.hit()) continue;
      ++found;
      // The hit point is the barycentric point, and lies close to the unit sphere.
      const Face& f = meshes[0].faces[as_size(one.face)];
      const auto at = [&](int k) { return Vec3f(meshes[0].vertices[as_size(f[as_size(k)])].cast<float>()); };
      const Vec3f p = (1 - one.b1 - one.b2) * at(0) + one.b1 * at(1) + one.b2 * at(2);
      ASSERT_LT((rays[i].origin + one.t * rays[i].direction - p).norm(), 1e-4f);
      ASSERT_NEAR(p.norm(), 1, 0.02);
    }
  }
  set_thread_count(0);
  EXPECT_GT(found, 10000);
}

}  // namespace
}  // namespace mirage
