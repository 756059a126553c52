#include <gtest/gtest.h>

#include "geometry/mesh.h"
#include "sensors/projection.h"
#include "support/gradient_check.h"
#include "support/raster_problem.h"

namespace mirage {
namespace {

using test::check_gradient;

constexpr double kNear = 0.5;

const PinholeCamera kCamera{20, 21, 11.5, 7.2, 24, 16};

Vec3d unproject(const Vec3d& on_screen) {
  const double half = std::max(kCamera.width, kCamera.height) / 2.0;
  return kCamera.unproject(on_screen.x() * half + (kCamera.width - 1) / 2.0,
                           (kCamera.height - 1) / 2.0 - on_screen.y() * half, on_screen.z());
}

double area(const Vec3d& a, const Vec3d& b, const Vec3d& c) {
  return (b - a).cross(c - a).norm() / 2;
}

/// A mesh in the camera's frame, with its projection and rendering.
struct Scene {
  std::vector<Vec3d> p_camera;
  std::vector<Face> faces;
  Texture texture = Texture::atlas;
  int resolution = 1;
  std::vector<Vec3d> texels;
  test::RasterProblem drawing;

  ProjectedMesh project() const {
    return project_mesh(p_camera, faces, kCamera, kNear, texture, resolution, texels);
  }
  Image<double> draw() const { return rasterize(project().screen, drawing.settings, drawing.target); }
  double loss() const { return test::dot(draw(), drawing.upstream); }
  std::vector<double> inputs() const {
    std::vector<double> x;
    test::append(x, p_camera);
    test::append(x, texels);
    return x;
  }
  Scene with(const std::vector<double>& x) const {
    Scene scene = *this;
    const double* value = x.data();
    for (auto* list : {&scene.p_camera, &scene.texels})
      for (Vec3d& v : *list)
        for (int c = 0; c < 3; ++c) v[c] = *value++;
    return scene;
  }
  std::vector<double> gradient() const {
    const ProjectedMesh projected = project();
    const auto on_screen =
        rasterize_vjp(projected.screen, drawing.settings, drawing.target, drawing.upstream);
    std::vector<Vec3d> d_p(p_camera.size(), Vec3d::Zero()), d_texels(texels.size(), Vec3d::Zero());
    project_mesh_vjp(projected, p_camera, kCamera, kNear, on_screen, d_p, d_texels);
    std::vector<double> x;
    test::append(x, d_p);
    test::append(x, d_texels);
    return x;
  }
};

/// `behind`: number of the first face's vertices behind the near plane. σ reaches beyond the window, so that
/// no sample crosses the cut-off and differences are smooth.
Scene crossing_scene(std::uint64_t seed, int behind, Texture texture, bool perspective) {
  RandomStream random(seed, "crossing face");
  Scene scene;
  for (int k = 0; k < 3; ++k) {
    const bool seen = k >= behind;
    scene.p_camera.push_back(Vec3d{random.uniform(-1, 1), random.uniform(-1, 1),
                                   seen ? random.uniform(1.5, 3) : random.uniform(-1.5, 0.3)});
  }
  scene.p_camera.push_back(Vec3d{random.uniform(-1, 1), random.uniform(-.5, .5), 2.5});
  scene.faces = {{0, 1, 2}, {2, 1, 3}};
  scene.texture = texture;
  scene.texels = test::random_colors(texture == Texture::atlas ? 2 : 6, random);
  scene.drawing.settings.sigma = 0.5;
  scene.drawing.settings.gamma = 0.1;
  scene.drawing.settings.near = 0.1;
  scene.drawing.settings.far = 5;
  scene.drawing.settings.perspective_texture = perspective;
  test::random_window(kCamera.width, kCamera.height, {1, 2, 22, 15}, random, scene.drawing);
  return scene;
}

TEST(Projection, PartsOfACrossingFaceCoverExactlyWhatIsInFront) {
  RandomStream random(1, "clipped area");
  for (int trial = 0; trial < 200; ++trial) {
    std::vector<Vec3d> p;
    for (int k = 0; k < 3; ++k)
      p.push_back(Vec3d{random.uniform(-2, 2), random.uniform(-2, 2), random.uniform(-2, 3)});
    const Face face{0, 1, 2};
    const ProjectedMesh projected =
        project_mesh(p, {face}, kCamera, kNear, Texture::atlas, 1, {Vec3d::Zero()});
    // Analytic: a plane parallel to z = 0 cuts a corner off a triangle in proportion to the cut lengths.
    std::vector<int> front, back;
    for (int k = 0; k < 3; ++k) (p[as_size(k)].z() >= kNear ? front : back).push_back(k);
    const double whole = area(p[0], p[1], p[2]);
    double expected = front.size() == 3 ? whole : 0;
    if (front.size() == 1 || front.size() == 2) {
      const int apex = front.size() == 1 ? front[0] : back[0];
      double corner = whole;
      for (int k : front.size() == 1 ? back : front)
        corner *= (p[as_size(apex)].z() - kNear) / (p[as_size(apex)].z() - p[as_size(k)].z());
      expected = front.size() == 1 ? corner : whole - corner;
    }
    double sum = 0;
    for (std::size_t part = 0; part < projected.screen.faces.size(); ++part) {
      std::array<Vec3d, 3> corner;
      for (std::size_t k = 0; k < 3; ++k) {
        corner[k] = unproject(projected.screen.faces[part][k]);
        EXPECT_GE(corner[k].z(), kNear);
        if (projected.screen.corner_barycentrics.empty()) continue;
        const Vec3d& b = projected.screen.corner_barycentrics[part][k];
        EXPECT_LT((b[0] * p[0] + b[1] * p[1] + b[2] * p[2] - corner[k]).norm(), 1e-9);
        EXPECT_NEAR(b.sum(), 1, 1e-12);
      }
      sum += area(corner[0], corner[1], corner[2]);
      // Parts keep the winding.
      EXPECT_GT((corner[1] - corner[0]).cross(corner[2] - corner[0]).dot((p[1] - p[0]).cross(p[2] - p[0])),
                0);
    }
    EXPECT_NEAR(sum, expected, 1e-9 * (1 + whole));
  }
}

TEST(Projection, NeighboursAreCutAtTheSamePoint) {
  const std::vector<Vec3d> p = {{-.3, .1, 2}, {.7, -.2, -1}, {0, 1, 3}, {.2, -1, 2.5}};
  const ProjectedMesh projected = project_mesh(p, {{0, 1, 2}, {1, 0, 3}}, kCamera, kNear, Texture::atlas, 1,
                                               {Vec3d::Zero(), Vec3d::Zero()});
  ASSERT_EQ(projected.screen.faces.size(), 4u);
  std::vector<Vec3d> cuts;
  for (std::size_t part = 0; part < 4; ++part)
    for (std::size_t k = 0; k < 3; ++k)
      if (const auto& corner = projected.corners[part][k]; corner.is_cut() && corner.a == 0 && corner.b == 1)
        cuts.push_back(projected.screen.faces[part][k]);
  ASSERT_GE(cuts.size(), 2u);
  for (const Vec3d& cut : cuts) EXPECT_EQ(cut, cuts.front());
}

TEST(Projection, AFaceThatCrossesTheCameraPlaneIsDrawn) {  // pytorch3d #345: such faces vanished
  Scene scene = crossing_scene(3, 1, Texture::atlas, true);
  RandomStream random(4, "ground");
  scene.p_camera = {{-2, .8, -3}, {6, .9, 9}, {-5, .7, 12}};  // ground under the camera
  scene.faces = {{0, 1, 2}};
  scene.resolution = 4;
  scene.texels = test::random_colors(16, random);
  scene.drawing.settings.sigma = 1e-14;
  scene.drawing.settings.far = 20;
  const Image<double> rgba = scene.draw();
  const PixelRect& rect = scene.drawing.target.rect;
  int covered = 0;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u) {
      // The pixel's ray in the basis of the triangle's vertices: ray = Σ m_k p_k; it hits if all m_k > 0.
      Eigen::Matrix3d corners;
      for (int k = 0; k < 3; ++k) corners.col(k) = scene.p_camera[as_size(k)];
      const Vec3d m = corners.inverse() * kCamera.unproject(u, v, 1);
      const bool hit = m.minCoeff() > 0 && 1 / m.sum() >= kNear;
      const double* pixel = rgba.pixel(u - rect.u0, v - rect.v0);
      EXPECT_EQ(pixel[3] > 0.5, hit) << u << ", " << v;
      covered += hit;
      if (!hit) continue;
      const Vec3d& texel = scene.texels[as_size(texel_index(m[0] / m.sum(), m[1] / m.sum(), 4))];
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(pixel[c], texel[c], 1e-6) << u << ", " << v;
    }
  EXPECT_GT(covered, 60);
}

TEST(ProjectionGradient, CrossingFacesAgainstCentralDifferences) {
  double worst = 0;
  for (int behind : {0, 1, 2})
    for (Texture texture : {Texture::atlas, Texture::vertex})
      for (bool perspective : {true, false})
        for (std::uint64_t seed : {1u, 2u, 3u}) {
          SCOPED_TRACE(testing::Message() << behind << " behind, seed " << seed);
          const Scene scene = crossing_scene(seed, behind, texture, perspective);
          const auto result = check_gradient([&](const auto& x) { return scene.with(x).loss(); },
                                             scene.inputs(), scene.gradient(), 1e-6, 2e-5, 1e-1);
          worst = std::max(worst, result.worst);
        }
  std::printf("worst relative gradient error (clipped faces): %.2e\n", worst);
}

TEST(ProjectionGradient, AVertexExactlyOnTheNearPlane) {
  Scene scene = crossing_scene(5, 0, Texture::atlas, true);
  scene.p_camera[0].z() = kNear;
  EXPECT_EQ(scene.project().screen.faces.size(), 2u);  // whole
  const auto f = [&](const std::vector<double>& x) { return scene.with(x).loss(); };
  const auto x = scene.inputs(), gradient = scene.gradient();
  check_gradient(f, x, gradient, 1e-6, 2e-5, 1e-1, [](std::size_t i) { return i != 2; });
  // The derivative to its own depth, from the front, where the face stays whole.
  auto ahead = x;
  ahead[2] += 1e-6;
  EXPECT_NEAR((f(ahead) - f(x)) / 1e-6, gradient[2], 1e-3 * (1 + std::abs(gradient[2])));
}

TEST(ProjectionGradient, CameraInsideTheMesh) {
  Scene scene = crossing_scene(6, 0, Texture::atlas, true);
  const Mesh ball = icosphere(1);
  scene.p_camera.clear();
  for (const Vec3d& v : ball.vertices) scene.p_camera.push_back(2 * v + Vec3d(.11, .07, .13));
  scene.faces = ball.faces;
  RandomStream random(7, "inside");
  scene.texels = test::random_colors(ball.faces.size(), random);
  const Image<double> rgba = scene.draw();
  for (int v = 0; v < rgba.height; ++v)
    for (int u = 0; u < rgba.width; ++u) EXPECT_GT(rgba.at(u, v, 3), 0.99);
  const auto result = check_gradient([&](const auto& x) { return scene.with(x).loss(); }, scene.inputs(),
                                     scene.gradient(), 1e-6, 5e-5, 1e-1);
  std::printf("camera inside the mesh: %d components, worst relative error %.2e\n", result.checked,
              result.worst);
}

TEST(Projection, FacesBehindOrNotFiniteVanish) {
  const double nan = std::nan("");
  const std::vector<Vec3d> p = {{0, 0, -1}, {1, 0, -2}, {0, 1, 0.4}, {0, 0, 2}, {1, 0, 2}, {nan, 0, 2}};
  const ProjectedMesh projected = project_mesh(p, {{0, 1, 2}, {3, 4, 5}}, kCamera, kNear, Texture::atlas, 1,
                                               {Vec3d::Zero(), Vec3d::Zero()});
  EXPECT_TRUE(projected.screen.faces.empty());
  EXPECT_TRUE(touched_pixels(projected.screen, SoftRasterSettings<double>(), 24, 16, {0, 0, 24, 16}).empty());
}

}  // namespace
}  // namespace mirage
