// The derivative of LiDAR returns with the silhouette: against differences of the mean over raster offsets.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "base/sizes.h"
#include "simulation/adversary_lidar.h"
#include "support/lidar_world.h"

namespace mirage {
namespace {

using test::dented_ball;
using test::lidar_frame;
using test::lidar_of_32;
using test::point_at;

/// The value of a return; any smooth function of its position.
double worth(const Vec3d& p) {
  return 1 + 0.4 * std::sin(0.7 * p.x()) + 0.5 * std::cos(2 * p.y()) + 0.8 * std::sin(3 * p.z());
}
Vec3d worth_slope(const Vec3d& p) {
  return {0.28 * std::cos(0.7 * p.x()), -std::sin(2 * p.y()), 2.4 * std::cos(3 * p.z())};
}

double worth_of(const Sweep& sweep) {
  double sum = 0;
  for (const LidarPoint& point : sweep) sum += worth(point.position().cast<double>());
  return sum;
}

/// A wall 16 m ahead, to the right of y = 0.3 m; the sky to the left of it.
Sweep wall(const LidarModel& lidar) {
  Sweep sweep;
  for (int beam = 0; beam < 32; ++beam)
    for (int column = 0; column < lidar.azimuth_count(); ++column) {
      const LidarRay ray = lidar.ray(beam, column);
      const double range = (16 - ray.origin.x()) / ray.direction.x();
      if ((ray.origin + range * ray.direction).y() < 0.3) sweep.push_back(point_at(ray, range));
    }
  return sweep;
}

/// The unit at several offsets of its raster, all equally likely: frames of the same world.
std::vector<PreparedFrame> rasters(bool with_wall, int a_side, const LidarModel& unit = lidar_of_32()) {
  std::vector<PreparedFrame> frames;
  for (int row = 0; row < a_side; ++row)
    for (int column = 0; column < a_side; ++column) {
      LidarModel lidar = unit;
      for (LidarBeam& beam : lidar.beams) beam.elevation += (row + 0.5) / a_side * 0.4 * M_PI / 180;
      lidar.azimuth_min += (column + 0.5) / a_side * lidar.azimuth_step;
      lidar.azimuth_max += (column + 0.5) / a_side * lidar.azimuth_step;
      frames.push_back(lidar_frame(lidar, with_wall ? wall(lidar) : Sweep()));
    }
  return frames;
}

double mean_worth(const std::vector<PreparedFrame>& frames, const TexturedMesh& object) {
  double sum = 0;
  for (const PreparedFrame& prepared : frames) {
    Simulated simulated;
    draw_in_lidar(prepared, object, {}, simulated);
    sum += worth_of(simulated.sweep);
  }
  return sum / static_cast<double>(frames.size());
}

/// d mean value / d vertices: the interior part, and with the silhouette's.
struct Slopes {
  std::vector<Vec3d> inner, whole;
};
Slopes mean_slopes(const std::vector<PreparedFrame>& frames, const TexturedMesh& object) {
  SimulationSettings settings;
  settings.grazing_cosine = 1e-9;  // unbounded: the exact derivative
  Slopes slopes;
  slopes.inner.assign(object.mesh.vertices.size(), Vec3d::Zero());
  std::vector<Vec3d> outline = slopes.inner, texels(object.atlas.texels.size(), Vec3d::Zero());
  for (const PreparedFrame& prepared : frames) {
    Simulated simulated;
    const LidarTape tape = draw_in_lidar(prepared, object, settings, simulated);
    std::vector<std::array<double, 4>> d_points(simulated.sweep.size(), {0, 0, 0, 0});
    for (std::size_t i = tape.first; i < d_points.size(); ++i) {
      const Vec3d slope = worth_slope(simulated.sweep[i].position().cast<double>());
      d_points[i] = {slope.x(), slope.y(), slope.z(), 0};
    }
    draw_in_lidar_vjp(tape, object, settings, d_points, slopes.inner, texels);
    const LidarSilhouette silhouette = lidar_silhouette(prepared, object);
    std::vector<double> presence;
    for (const LidarPoint& place : silhouette.places)
      presence.push_back(worth(place.position().cast<double>()));
    lidar_silhouette_vjp(silhouette, presence, outline);
  }
  slopes.whole = slopes.inner;
  for (std::size_t i = 0; i < outline.size(); ++i) {
    slopes.whole[i] = (slopes.inner[i] + outline[i]) / static_cast<double>(frames.size());
    slopes.inner[i] /= static_cast<double>(frames.size());
  }
  return slopes;
}

double along(const std::vector<Vec3d>& slopes, const std::vector<Vec3d>& motion) {
  double sum = 0;
  for (std::size_t i = 0; i < slopes.size(); ++i) sum += slopes[i].dot(motion[i]);
  return sum;
}

/// Scaling, motion to either side, up and away; then random dents.
std::vector<std::vector<Vec3d>> motions(const TexturedMesh& object, int dents) {
  const Vec3d centre = bounds(object.mesh).center();
  std::vector<std::vector<Vec3d>> all(5);
  for (const Vec3d& v : object.mesh.vertices) {
    all[0].push_back(v - centre);
    all[1].push_back(Vec3d(0, 0, v.z() - centre.z()));
    all[2].push_back(Vec3d::UnitX());
    all[3].push_back(Vec3d::UnitY());
    all[4].push_back(Vec3d::UnitZ());
  }
  RandomStream random(5, "dents");
  for (int k = 0; k < dents; ++k) {
    all.emplace_back();
    for (std::size_t i = 0; i < object.mesh.vertices.size(); ++i)
      all.back().push_back(Vec3d{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)});
  }
  return all;
}

/// Over all motions together the derivative is within `tolerance` of the differences. Without the silhouette
/// more than half of it is missing.
void check_motions(const std::vector<PreparedFrame>& frames, const TexturedMesh& object, int dents,
                   double tolerance) {
  const Slopes slopes = mean_slopes(frames, object);
  double difference = 0, norm = 0, without = 0;
  for (const auto& motion : motions(object, dents)) {
    constexpr double step = 0.005;  // m; rays are discrete: a smaller step gives counting noise
    TexturedMesh further = object, nearer = object;
    for (std::size_t i = 0; i < motion.size(); ++i) {
      further.mesh.vertices[i] += step * motion[i];
      nearer.mesh.vertices[i] -= step * motion[i];
    }
    const double slope = (mean_worth(frames, further) - mean_worth(frames, nearer)) / (2 * step);
    const double found = along(slopes.whole, motion), inner = along(slopes.inner, motion);
    difference += (found - slope) * (found - slope), norm += slope * slope;
    without += (inner - slope) * (inner - slope);
  }
  std::printf("[ LIDAR    ] off by %.4f, without the silhouette by %.2f\n", std::sqrt(difference / norm),
              std::sqrt(without / norm));
  EXPECT_LT(std::sqrt(difference / norm), tolerance);
  EXPECT_GT(std::sqrt(without / norm), 0.5);
}

/// Two balls, one half behind the other, as one mesh.
TexturedMesh two_balls() {
  TexturedMesh both = dented_ball({10, 0.4, -0.9}, 0.6, 3);
  const TexturedMesh second = dented_ball({12, 1, -0.8}, 0.7, 4);
  const auto first = static_cast<int>(both.mesh.vertices.size());
  both.mesh.vertices.insert(both.mesh.vertices.end(), second.mesh.vertices.begin(),
                            second.mesh.vertices.end());
  for (const Face& f : second.mesh.faces)
    both.mesh.faces.push_back({f[0] + first, f[1] + first, f[2] + first});
  both.atlas.texels.insert(both.atlas.texels.end(), second.atlas.texels.begin(), second.atlas.texels.end());
  return both;
}

constexpr int kSide = 20;

TEST(LidarSilhouette, IsTheDerivativeOfTheMeanSweep) {
  const auto frames = rasters(false, kSide);
  for (const std::uint64_t ball : {1u, 6u})
    check_motions(frames, dented_ball({10, 0.4, -0.9}, 0.8, ball), 2, 0.015);
}

TEST(LidarSilhouette, KnowsWhatTheObjectHides) {
  check_motions(rasters(true, kSide), dented_ball({10, 0.4, -0.9}, 0.8, 3), 2, 0.015);
}

TEST(LidarSilhouette, KnowsWhichPartOfTheObjectIsBehindAnother) {
  check_motions(rasters(true, kSide), two_balls(), 0, 0.015);
}

// Faces edge-on to the unit appear and vanish with any dent, so here the object only moves and grows.
TEST(LidarSilhouette, EndsWhereTheUnitDoesNotFire) {
  check_motions(rasters(false, kSide), dented_ball({10, 0.4, -0.3}, 0.8, 1), 0, 0.015);
}

TEST(LidarSilhouette, IsHiddenBehindTheScene) {
  const LidarModel lidar = lidar_of_32();
  Sweep near;
  for (int beam = 0; beam < 32; ++beam)
    for (int column = 0; column < lidar.azimuth_count(); ++column)
      near.push_back(point_at(lidar.ray(beam, column), 5));
  const TexturedMesh ball = dented_ball({10, 0.4, -0.9}, 0.8, 3);
  EXPECT_GT(lidar_silhouette(lidar_frame(lidar), ball).samples.size(), 50u);
  EXPECT_TRUE(lidar_silhouette(lidar_frame(lidar, near), ball).samples.empty());
}

// The lasers see over the box's top, but the unit's centre does not.
TEST(LidarSilhouette, IsSeenFromTheLasersAndNotFromTheUnitsCentre) {
  LidarModel above = lidar_of_32(), raised = above;
  for (LidarBeam& beam : above.beams) beam.height = 0.3;
  raised.velo_from_lidar.translation().z() = 0.3;
  TexturedMesh box;
  box.mesh = box_mesh({1, 1.6, 0.8});
  for (Vec3d& v : box.mesh.vertices) v += Vec3d(10, 0, -0.2);  // to 0.2 m
  const LidarSilhouette one = lidar_silhouette(lidar_frame(above), box),
                        same = lidar_silhouette(lidar_frame(raised), box);
  ASSERT_EQ(one.samples.size(), same.samples.size());
  int rear = 0;
  for (std::size_t i = 0; i < one.samples.size(); ++i) {
    EXPECT_EQ(one.samples[i].vertices, same.samples[i].vertices);
    EXPECT_NEAR((one.samples[i].gain - same.samples[i].gain).norm(), 0, 1e-9);
    const auto at = [&](int k) { return box.mesh.vertices[as_size(k)]; };
    const Vec3d a = at(one.samples[i].vertices[0]), b = at(one.samples[i].vertices[1]);
    rear += a.x() > 10.4 && b.x() > 10.4 && a.z() > 0.1 && b.z() > 0.1;
  }
  EXPECT_GT(rear, 10);
}

TEST(LidarSilhouette, OfDegenerateMeshesIsFinite) {
  const PreparedFrame frame = lidar_frame(lidar_of_32());
  const TexturedMesh ball = dented_ball({10, 0.4, -0.9}, 0.8, 3);
  std::vector<TexturedMesh> meshes = {TexturedMesh(), ball, ball, ball, ball, ball};
  for (Vec3d& v : meshes[1].mesh.vertices) v = {10, 0, -1};            // a point
  for (Vec3d& v : meshes[2].mesh.vertices) v = {10, v.y(), -1};        // a line
  for (Vec3d& v : meshes[3].mesh.vertices) v.z() = -1;                 // a plate
  for (Vec3d& v : meshes[4].mesh.vertices) v -= Vec3d(10, 0.4, -0.9);  // around the unit
  meshes[5].mesh.faces.resize(5);                                      // borders
  meshes[5].mesh.faces.push_back(meshes[5].mesh.faces[0]);             // a face twice
  for (const TexturedMesh& mesh : meshes) {
    const LidarSilhouette silhouette = lidar_silhouette(frame, mesh);
    const std::vector<double> presence(silhouette.places.size(), 1.0);
    std::vector<Vec3d> d_vertices(mesh.mesh.vertices.size(), Vec3d::Zero());
    lidar_silhouette_vjp(silhouette, presence, d_vertices);
    for (const Vec3d& d : d_vertices) EXPECT_TRUE(d.allFinite());
    for (const LidarPoint& place : silhouette.places) EXPECT_TRUE(place.position().allFinite());
  }
  EXPECT_TRUE(lidar_silhouette(frame, meshes[1]).samples.empty());
  EXPECT_FALSE(lidar_silhouette(frame, meshes[5]).samples.empty());
}

}  // namespace
}  // namespace mirage
