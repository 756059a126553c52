#include <gtest/gtest.h>

#include "base/random.h"
#include "geometry/shapes.h"
#include "geometry/winding_number.h"

namespace mirage {
namespace {

TEST(WindingNumber, OneInsideAndZeroOutsideAClosedMesh) {
  const WindingNumber w(icosphere(3));
  RandomStream random(1, "winding");
  for (int i = 0; i < 300; ++i) {
    const Vec3d p(random.uniform(-2, 2), random.uniform(-2, 2), random.uniform(-2, 2));
    if (std::abs(p.norm() - 1) < 0.02) continue;
    EXPECT_NEAR(w.at(p, true), p.norm() < 1, 1e-9);
    EXPECT_NEAR(w.at(p), p.norm() < 1, 0.03);
  }
}

TEST(WindingNumber, AHoleLeavesTheSignRight) {
  Mesh mesh = icosphere(3);
  // Cut away the cap over z = 0.8: one face in ten.
  std::erase_if(mesh.faces, [&](const Face& f) {
    return (mesh.vertices[f[0]] + mesh.vertices[f[1]] + mesh.vertices[f[2]]).z() > 2.4;
  });
  ASSERT_FALSE(is_watertight(mesh));
  const WindingNumber w(mesh);
  RandomStream random(2, "winding");
  for (int i = 0; i < 300; ++i) {
    const Vec3d p(random.uniform(-1.5, 1.5), random.uniform(-1.5, 1.5), random.uniform(-1.5, 1.5));
    if (std::abs(p.norm() - 1) < 0.05 || p.z() > 0.7) continue;
    EXPECT_EQ(w.at(p) > 0.5, p.norm() < 1) << p.transpose();
  }
  EXPECT_NEAR(w.at({0, 0, 0}), 0.9, 0.02);  // the cap's share of the sphere is (1 − 0.8) / 2
}

TEST(WindingNumber, OverlappingBodiesAndEmptyMeshes) {
  Mesh two = icosphere(2);
  append(two, icosphere(2), Transform(Eigen::Translation3d(0.5, 0, 0)));
  EXPECT_NEAR(WindingNumber(two).at({0.25, 0, 0}, true), 2, 1e-9);
  EXPECT_EQ(WindingNumber(Mesh{}).at({0, 0, 0}), 0);
  Mesh flat;
  flat.vertices = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}};
  flat.faces = {{0, 1, 2}};
  EXPECT_EQ(WindingNumber(flat).at({1, 0, 0}), 0);
}

}  // namespace
}  // namespace mirage
