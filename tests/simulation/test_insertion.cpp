#include <gtest/gtest.h>

#include <algorithm>

#include "base/random.h"
#include "base/sizes.h"
#include "scene/depth_completion.h"
#include "simulation/camera_pass.h"
#include "simulation/render_scene.h"
#include "support/gradient_check.h"
#include "support/insertion_world.h"

namespace mirage {
namespace {

using test::check_gradient;
using test::make_world;
using test::smooth_settings;
using test::World;

TexturedMesh with_vertices(const TexturedMesh& like, const std::vector<double>& x) {
  TexturedMesh mesh = like;
  for (std::size_t i = 0; i < mesh.mesh.vertices.size(); ++i)
    mesh.mesh.vertices[i] = Vec3d(x[3 * i], x[3 * i + 1], x[3 * i + 2]);
  return mesh;
}

/// Central differences of the camera's picture, with respect to vertices and texels.
void expect_camera_gradient(const World& world, const SimulationSettings& settings) {
  const Simulated at = simulate(world.prepared, world.placement, world.adversary, settings);
  ASSERT_GT(at.adversary_pixels, 50);
  RandomStream random(2, "upstream");
  ImageF d_image(at.image.width, at.image.height, 3);
  for (float& value : d_image.data) value = static_cast<float>(random.uniform(-1, 1));
  const auto loss = [&](const TexturedMesh& adversary) {
    const Simulated s = simulate(world.prepared, world.placement, adversary, settings);
    double sum = 0;
    for (int v = s.rect.v0; v < s.rect.v1; ++v)
      for (int u = s.rect.u0; u < s.rect.u1; ++u)
        for (int c = 0; c < 3; ++c)  // relative to the background, so that the window's size doesn't matter
          sum += d_image.at(u, v, c) *
                 (s.rgba.at(u - s.rect.u0, v - s.rect.v0, c) - world.prepared.frame.image.at(u, v, c));
    return sum;
  };
  const AdversaryGradient gradient = simulate_vjp(at, d_image, {});
  std::vector<double> d_vertices;
  for (const Vec3d& d : gradient.vertices) d_vertices.insert(d_vertices.end(), d.data(), d.data() + 3);
  const auto on_vertices =
      check_gradient([&](const auto& x) { return loss(with_vertices(world.adversary, x)); },
                     test::flat(world.adversary.mesh.vertices), d_vertices, 1e-7, 1e-4, 1.0);
  std::printf("camera, vertices: %d components, worst relative error %.2e\n", on_vertices.checked,
              on_vertices.worst);

  std::vector<double> texels, d_texels;
  for (const Vec3d& t : world.adversary.atlas.texels) texels.insert(texels.end(), t.data(), t.data() + 3);
  for (const Vec3d& t : gradient.texels) d_texels.insert(d_texels.end(), t.data(), t.data() + 3);
  const auto on_texels = check_gradient(
      [&](const auto& x) {
        TexturedMesh mesh = world.adversary;
        for (std::size_t i = 0; i < mesh.atlas.texels.size(); ++i)
          mesh.atlas.texels[i] = Vec3d(x[3 * i], x[3 * i + 1], x[3 * i + 2]);
        return loss(mesh);
      },
      texels, d_texels, 1e-4, 1e-6, 1e-2);
  std::printf("camera, texels: %d components, worst relative error %.2e\n", on_texels.checked,
              on_texels.worst);
}

TEST(InsertionGradient, VerticesAndTexelsThroughTheCamera) {
  expect_camera_gradient(make_world(1), smooth_settings());
}

TEST(InsertionGradient, ExactAreasThroughTheCamera) {
  SimulationSettings settings;
  settings.exact_coverage = true;
  World world = make_world(1);
  expect_camera_gradient(world, settings);
  // With texels, whose borders move too; and folded, so that faces hide and intersect each other.
  RandomStream random(3, "exact areas");
  test::paint(world.adversary, 3, random);
  test::crumple(world.adversary.mesh, random);
  expect_camera_gradient(world, settings);
}

TEST(InsertionGradient, ThroughLensAndSensor) {
  SimulationSettings soft = smooth_settings(), exact;
  exact.exact_coverage = true;
  for (SimulationSettings* settings : {&soft, &exact}) {
    settings->camera_effects = parse_camera_effects("unit");
    expect_camera_gradient(make_world(1), *settings);
  }
}

void expect_texel_gradient(LightModel light, double step = 1e-4) {
  const World world = make_world(5);
  SimulationSettings settings = smooth_settings();
  settings.light = light;  // rays do not depend on texels
  const auto draw = [&](const TexturedMesh& adversary) {
    return simulate(world.prepared, world.placement, adversary, settings);
  };
  const Simulated at = draw(world.adversary);
  RandomStream random(6, "upstream");
  ImageF d_image(at.image.width, at.image.height, 3);
  for (float& value : d_image.data) value = static_cast<float>(random.uniform(-1, 1));
  std::vector<double> texels, d_texels;
  for (const Vec3d& t : world.adversary.atlas.texels) texels.insert(texels.end(), t.data(), t.data() + 3);
  const AdversaryGradient gradient = simulate_vjp(at, d_image, {});
  for (const Vec3d& t : gradient.texels) d_texels.insert(d_texels.end(), t.data(), t.data() + 3);
  const auto check = check_gradient(
      [&](const auto& x) {
        TexturedMesh mesh = world.adversary;
        for (std::size_t i = 0; i < mesh.atlas.texels.size(); ++i)
          mesh.atlas.texels[i] = Vec3d(x[3 * i], x[3 * i + 1], x[3 * i + 2]);
        const Simulated s = draw(mesh);
        double sum = 0;
        for (int v = s.rect.v0; v < s.rect.v1; ++v)
          for (int u = s.rect.u0; u < s.rect.u1; ++u)
            for (int c = 0; c < 3; ++c)
              sum += d_image.at(u, v, c) * s.rgba.at(u - s.rect.u0, v - s.rect.v0, c);
        return sum;
      },
      texels, d_texels, step, 1e-6, 1e-2);
  std::printf("%s light, texels: %d components, worst relative error %.2e\n", to_word(light), check.checked,
              check.worst);
}

TEST(InsertionGradient, TexelsThroughTheVisibleLight) {
  expect_texel_gradient(LightModel::visible);
}

TEST(InsertionGradient, TexelsThroughTheFineLight) {
  // A node inside the object has almost no light: a larger step would clip it at 0.
  expect_texel_gradient(LightModel::fine, 1e-5);
}

TEST(Insertion, FineLightIsNearerToOneOfManyRays) {
  SimulationSettings visible, fine, many;
  visible.exact_coverage = fine.exact_coverage = many.exact_coverage = true;
  visible.light = many.light = LightModel::visible;
  fine.light = LightModel::fine;
  many.visible_light = {.directions = 2048,
                        .rough_directions = 512,
                        .bounces = 8,
                        .sun_samples = 20,
                        .sun_angle = 1e-8,
                        .cell = 0.1,
                        .node_angle = 0};
  // Fine texels appear only in a camera as fine as KITTI's, with an atlas as an attack's.
  World world = make_world(5);
  const Mesh uncrumpled = world.adversary.mesh;
  Frame frame = world.prepared.frame;
  PinholeCamera& camera = frame.calibration.camera;
  camera = resized(camera, 6 * camera.width, 6 * camera.height);
  frame.image = ImageF(camera.width, camera.height, 3, 0.4f);
  world.prepared = prepare(frame, world.prepared.lidar);
  double coarse = 0, better = 0;
  int nearer = 0;
  for (int k = 0; k < 16; ++k) {
    RandomStream random(static_cast<std::uint64_t>(k), "crumpled");
    world.adversary.mesh = uncrumpled;
    test::paint(world.adversary, 5, random);
    test::crumple(world.adversary.mesh, random);
    const auto picture = [&](const SimulationSettings& settings) {
      return simulate(world.prepared, world.placement, world.adversary, settings).image;
    };
    const ImageF reference = picture(many);
    const auto squares = [&](const SimulationSettings& settings) {
      const ImageF drawn = picture(settings);
      double sum = 0;
      for (std::size_t i = 0; i < drawn.data.size(); ++i)
        sum += std::pow(drawn.data[i] - reference.data[i], 2);
      return sum;
    };
    const double of_visible = squares(visible), of_fine = squares(fine);
    coarse += of_visible, better += of_fine;
    nearer += of_fine < of_visible;
  }
  std::printf("root of squared differences: visible %.3f, fine %.3f, nearer on %d of 16 meshes\n",
              std::sqrt(coarse), std::sqrt(better), nearer);
  EXPECT_GT(better, 0);
  EXPECT_LT(std::sqrt(better), 0.95 * std::sqrt(coarse));
  EXPECT_GE(nearer, 12);
}

void expect_lidar_gradient(const World& world) {
  SimulationSettings settings;
  settings.grazing_cosine = 1e-9;  // unbounded: the exact derivative
  Simulated at;
  const auto d_points_of = [](std::size_t n) {
    std::vector<std::array<float, 4>> d(n);
    RandomStream random(4, "upstream points");
    for (auto& row : d)
      for (float& value : row) value = static_cast<float>(random.uniform(-1, 1));
    return d;
  };
  // The tape keeps the returns in double.
  const auto returns = [&](const TexturedMesh& adversary, Simulated& result) {
    return draw_in_lidar(world.prepared, place(adversary, world.placement), settings, result);
  };
  const LidarTape tape = returns(world.adversary, at);
  ASSERT_GT(tape.returns.size(), 50u);
  const auto d_points = d_points_of(tape.returns.size());
  const auto loss = [&](const std::vector<double>& x) {
    Simulated ignored;
    const LidarTape now = returns(with_vertices(world.adversary, x), ignored);
    EXPECT_EQ(now.returns.size(), tape.returns.size());
    double sum = 0;
    for (std::size_t i = 0; i < std::min(now.returns.size(), tape.returns.size()); ++i) {
      if (now.returns[i].face != tape.returns[i].face) return std::nan("");
      const Vec3d p = now.returns[i].ray.origin + now.returns[i].hit.range * now.returns[i].ray.direction;
      sum += d_points[i][0] * p.x() + d_points[i][1] * p.y() + d_points[i][2] * p.z() +
             d_points[i][3] * now.returns[i].hit.reflectance;
    }
    return sum;
  };
  const Simulated simulated = simulate(world.prepared, world.placement, world.adversary, settings);
  const AdversaryGradient gradient = simulate_vjp(simulated, ImageF(), d_points);
  std::vector<double> d_vertices;
  for (const Vec3d& d : gradient.vertices) d_vertices.insert(d_vertices.end(), d.data(), d.data() + 3);
  // A vertex whose move makes a ray change its face has no derivative there; all others must agree.
  int jumps = 0;
  const auto x0 = test::flat(world.adversary.mesh.vertices);
  const auto smooth = [&](std::size_t i) {
    auto above = x0, below = x0;
    above[i] += 1e-7;
    below[i] -= 1e-7;
    const bool ok = std::isfinite(loss(above)) && std::isfinite(loss(below));
    jumps += !ok;
    return ok;
  };
  const auto result = check_gradient(loss, x0, d_vertices, 1e-7, 1e-4, 1e-1, smooth);
  std::printf("LiDAR, vertices: %d components, worst relative error %.2e, %d at a face change\n",
              result.checked, result.worst, jumps);
  EXPECT_GT(result.checked, 100);
}

TEST(InsertionGradient, VerticesThroughTheLidar) {
  expect_lidar_gradient(make_world(3));
}

// The picture's edge cuts off no part.
TEST(InsertionGradient, OffTheRoof) {
  World world = make_world(3);
  PlaceChoice place;
  for (const char* text : {"-1,2.2,0.5,140", "world:9,-1,-0.2,30"}) {
    set_from_text(text, place);
    world.placement = placement_of(place, *world.placement.carrier, {});
    ASSERT_EQ(world.placement.support, Support::free);
    expect_camera_gradient(world, smooth_settings());
    expect_lidar_gradient(world);
  }
}

TEST(Insertion, TheAdversaryStandsOnTheRoof) {
  const World world = make_world(5);
  const TexturedMesh placed = place(world.adversary, world.placement);
  const Box3& box = world.placement.carrier->label.box;
  EXPECT_NEAR(bounds(placed.mesh).min().z(), box.bottom + box.height, 1e-12);
}

/// The same surface with vertices that no face uses: below, ahead, at the camera and beside. The first of
/// them comes before all other vertices.
TexturedMesh with_unused(TexturedMesh adversary) {
  Mesh& mesh = adversary.mesh;
  mesh.vertices.insert(mesh.vertices.begin(), Vec3d(0, 0, -2));
  for (const Vec3d& v : {Vec3d(900, 0, 0), Vec3d(-12, 0, 0), Vec3d(0, 40, 30)}) mesh.vertices.push_back(v);
  for (Face& face : mesh.faces)
    for (int& corner : face) ++corner;
  return adversary;
}

TEST(Insertion, VerticesThatNoFaceUsesChangeNothing) {
  const World world = make_world(9);
  const TexturedMesh more = with_unused(world.adversary);
  const auto settings_of = [](bool exact, LightModel light) {
    SimulationSettings settings;
    settings.exact_coverage = exact;
    settings.light = light;
    return settings;
  };
  for (const SimulationSettings& settings :
       {smooth_settings(), settings_of(false, LightModel::plain), settings_of(true, LightModel::visible)}) {
    const Simulated plain = simulate(world.prepared, world.placement, world.adversary, settings);
    const Simulated same = simulate(world.prepared, world.placement, more, settings);
    EXPECT_GT(plain.adversary_pixels, 50);
    EXPECT_GT(plain.adversary_points, 10);
    EXPECT_EQ(same.adversary_pixels, plain.adversary_pixels);
    EXPECT_EQ(same.image.data, plain.image.data);
    ASSERT_EQ(same.sweep.size(), plain.sweep.size());
    for (std::size_t i = 0; i < plain.sweep.size(); ++i)
      EXPECT_EQ(same.sweep[i].position(), plain.sweep[i].position()) << i;
    const ImageF d_image(plain.image.width, plain.image.height, 3, 1.f);
    const std::vector<std::array<float, 4>> d_points(plain.sweep.size(), {1, -1, 1, 1});
    const auto of_plain = simulate_vjp(plain, d_image, d_points),
               of_same = simulate_vjp(same, d_image, d_points);
    const std::size_t used = of_plain.vertices.size();
    ASSERT_EQ(of_same.vertices.size(), used + 4);
    for (std::size_t i = 0; i < of_same.vertices.size(); ++i)
      EXPECT_EQ(of_same.vertices[i], i >= 1 && i <= used ? of_plain.vertices[i - 1] : Vec3d(Vec3d::Zero()))
          << i;
    EXPECT_EQ(of_same.texels, of_plain.texels);
  }
}

TEST(Insertion, SensorNoiseIsOfTheFrameAndTheSeed) {
  World world = make_world(9);
  SimulationSettings settings = smooth_settings();
  settings.camera_effects = parse_camera_effects("noise");
  const auto drawn = [&] {
    return simulate(world.prepared, world.placement, world.adversary, settings).image.data;
  };
  const auto first = drawn();
  EXPECT_EQ(drawn(), first);
  settings.camera_effects.seed = 1;
  EXPECT_NE(drawn(), first);
  settings.camera_effects.seed = 0;
  world.prepared.frame.id += "1";
  EXPECT_NE(drawn(), first);
}

TEST(RenderScene, VerticesThatNoFaceUsesChangeNothing) {
  const World world = make_world(9);
  const Calibration& calibration = world.prepared.frame.calibration;
  RenderScene scene;
  scene.camera = calibration.camera;
  scene.camera_from_velo = calibration.camera_from_velo;
  scene.lighting = world.prepared.frame.lighting;
  for (const SceneRenderer renderer : {SceneRenderer::soft, SceneRenderer::traced}) {
    SceneRenderSettings settings;
    settings.renderer = renderer;
    scene.things = {{"object", "", place(world.adversary, world.placement)}};
    const SceneImage plain = render_scene(scene, world.prepared.frame.image, settings);
    EXPECT_GT(plain.covered, 50);
    scene.things = {{"object", "", place(with_unused(world.adversary), world.placement)}};
    const SceneImage same = render_scene(scene, world.prepared.frame.image, settings);
    EXPECT_EQ(same.rgba.data, plain.rgba.data);
    EXPECT_EQ(same.depth.data, plain.depth.data);
    EXPECT_EQ(same.near, plain.near);
    EXPECT_EQ(same.far, plain.far);
  }
}

TEST(Insertion, MeasuredReturnsBehindItGoAndThoseInFrontStay) {
  // A wall 30 m away and a pole 6 m away, both across the object's rays.
  World empty = make_world(6);
  const TexturedMesh placed = place(empty.adversary, empty.placement);
  const Vec3d centre = bounds(placed.mesh).center();
  Sweep sweep;
  const auto at_range = [&](double azimuth, double elevation, double range) {
    sweep.push_back({static_cast<float>(range * std::cos(elevation) * std::cos(azimuth)),
                     static_cast<float>(range * std::cos(elevation) * std::sin(azimuth)),
                     static_cast<float>(range * std::sin(elevation)), 0.3f});
  };
  const double azimuth = std::atan2(centre.y(), centre.x()),
               elevation = std::atan2(centre.z(), centre.head<2>().norm());
  for (int i = -3; i <= 3; ++i) at_range(azimuth + 0.0035 * i, elevation, 30);         // behind
  for (int i = -3; i <= 3; ++i) at_range(azimuth + 0.0035 * i, elevation - 0.014, 6);  // in front
  at_range(azimuth + 0.5, elevation, 20);                                              // elsewhere
  const World world = make_world(6, sweep);
  const Simulated s = simulate(world.prepared, world.placement, world.adversary);
  EXPECT_EQ(s.removed_points, 7);
  EXPECT_EQ(s.occluded_points, 7);
  EXPECT_GT(s.adversary_points, 7);
  EXPECT_EQ(s.sweep.size(), sweep.size() - 7 + as_size(s.adversary_points));
  const auto survives = [&](const LidarPoint& p) {
    return std::any_of(s.sweep.begin(), s.sweep.end(),
                       [&](const LidarPoint& q) { return p.x == q.x && p.y == q.y && p.z == q.z; });
  };
  for (int i = 0; i < 7; ++i) EXPECT_FALSE(survives(sweep[as_size(i)]));
  for (std::size_t i = 7; i < sweep.size(); ++i) EXPECT_TRUE(survives(sweep[i]));
}

TEST(Insertion, AnOccluderInThePhotographHidesItAndSkyDoesNot) {
  World world = make_world(7);
  const Simulated open = simulate(world.prepared, world.placement, world.adversary);
  EXPECT_EQ(open.visible_share, 1);
  for (float& depth : world.prepared.depth.data) depth = 5;  // a surface in every pixel, nearer than the host
  const Simulated hidden = simulate(world.prepared, world.placement, world.adversary);
  EXPECT_EQ(hidden.adversary_pixels, 0);
  EXPECT_EQ(hidden.visible_share, 0);
  EXPECT_EQ(hidden.image.data, world.prepared.frame.image.data);
  for (float& depth : world.prepared.depth.data) depth = 14;  // behind the object
  EXPECT_EQ(simulate(world.prepared, world.placement, world.adversary).adversary_pixels,
            open.adversary_pixels);
}

TEST(Insertion, ACarHidesWhatStandsBehindItAndNotWhatItCarries) {
  World world = make_world(7);
  const Carrier carrier = *world.placement.carrier;
  const auto share = [&](const Vec3d& at, float depth) {
    for (float& value : world.prepared.depth.data) value = depth;
    const Placement placement = placement_of({PlaceChoice::In::vehicle, at, 0}, carrier, {});
    return simulate(world.prepared, placement, world.adversary).visible_share;
  };
  const float rear = 9.7f;                        // m: the car's, 12 m ahead
  EXPECT_EQ(share({0, 0, 1.5}, rear + 0.5f), 1);  // the completed depth smears the car over its roof
  EXPECT_EQ(share({4, 0, 0}, rear + 0.5f), 0);
  // On the ground the picture's lower edge cuts a little off.
  EXPECT_EQ(share({-4, 0, 0}, rear + 0.5f), share({-4, 0, 0}, kFarDepth));
  EXPECT_GT(share({-4, 0, 0}, kFarDepth), 0.9);
  EXPECT_GT(share({4, 0, 0}, kFarDepth), 0.9);
}

TEST(Insertion, ModalityGatingLeavesTheOtherSensorOut) {
  const World world = make_world(8);
  const Simulated s = simulate(world.prepared, world.placement, world.adversary);
  const ImageF d_image(s.image.width, s.image.height, 3, 1.f);
  const std::vector<std::array<float, 4>> d_points(s.sweep.size(), {1, 1, 1, 1});
  const auto image = simulate_vjp(s, d_image, {}), lidar = simulate_vjp(s, ImageF(), d_points),
             both = simulate_vjp(s, d_image, d_points);
  double lidar_texels = 0, lidar_vertices = 0, image_texels = 0;
  for (std::size_t i = 0; i < both.vertices.size(); ++i) {
    EXPECT_LT((both.vertices[i] - image.vertices[i] - lidar.vertices[i]).norm(),
              1e-9 * (1 + both.vertices[i].norm()));
    lidar_vertices += lidar.vertices[i].norm();
  }
  for (std::size_t i = 0; i < both.texels.size(); ++i) {
    lidar_texels += lidar.texels[i].norm();
    image_texels += image.texels[i].norm();
  }
  EXPECT_GT(lidar_vertices, 0);
  EXPECT_GT(image_texels, 0);
  EXPECT_EQ(lidar_texels, 0);  // the LiDAR's reflectivity is the material's, not the paint's
}

}  // namespace
}  // namespace mirage
