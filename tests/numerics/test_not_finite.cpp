// A NaN or an Inf put into each input in turn: one InputError that names it, and no result.
#include <gtest/gtest.h>

#include <functional>
#include <limits>

#include "attack/objective.h"
#include "base/error.h"
#include "raster_extremes.h"
#include "support/files.h"
#include "support/insertion_world.h"

namespace mirage {
namespace {

using test::make_world;
using test::World;

const double kBad[] = {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(),
                       -std::numeric_limits<double>::infinity()};

/// All inputs of the simulation.
struct Inputs {
  Frame frame;
  LidarModel lidar;
  Placement placement;
  TexturedMesh adversary;
  SimulationSettings settings;
  std::function<void(PreparedFrame&)> spoil_prepared;
  std::function<void(ImageF&, std::vector<std::array<float, 4>>&)> spoil_upstream;
};

Inputs good_inputs() {
  Sweep ground;
  for (float x = 5; x < 30; x += 1)
    for (float y = -5; y < 6; y += 1) ground.push_back({x, y, -1.7f, .2f});
  const World world = make_world(1, ground);
  return {world.prepared.frame, world.prepared.lidar, world.placement, world.adversary, {}, {}, {}};
}

void run(const Inputs& inputs) {
  PreparedFrame prepared = prepare(inputs.frame, inputs.lidar);
  if (inputs.spoil_prepared) inputs.spoil_prepared(prepared);
  const Simulated simulated = simulate(prepared, inputs.placement, inputs.adversary, inputs.settings);
  ImageF d_image(simulated.image.width, simulated.image.height, 3, 1.f);
  std::vector<std::array<float, 4>> d_points(simulated.sweep.size(), {1, 1, 1, 1});
  if (inputs.spoil_upstream) inputs.spoil_upstream(d_image, d_points);
  const AdversaryGradient gradient = simulate_vjp(simulated, d_image, d_points);
  for (float value : simulated.image.data) ASSERT_TRUE(std::isfinite(value));
  for (const auto* list : {&gradient.vertices, &gradient.texels})
    for (const Vec3d& d : *list) ASSERT_TRUE(d.allFinite());
}

/// `spoil` puts a bad value into one input; expects an error of one line that contains `name`.
template <class Error = InputError>
void expect_reported(const std::string& name, const std::function<void(Inputs&, double)>& spoil) {
  for (double bad : kBad) {
    SCOPED_TRACE(name + " = " + std::to_string(bad));
    Inputs inputs = good_inputs();
    spoil(inputs, bad);
    const std::string text = test::error_text<Error>([&] { run(inputs); });
    EXPECT_NE(text.find(name), std::string::npos) << text;
    EXPECT_EQ(text.find('\n'), std::string::npos) << text;
  }
}

TEST(NotFinite, GoodInputsPass) {
  run(good_inputs());
}

TEST(NotFinite, MeshVertex) {
  expect_reported("vertex 5", [](Inputs& in, double bad) { in.adversary.mesh.vertices[5].y() = bad; });
}

TEST(NotFinite, Texel) {
  expect_reported("texel 7", [](Inputs& in, double bad) { in.adversary.atlas.texels[7].z() = bad; });
}

TEST(NotFinite, Photograph) {
  expect_reported("pixel (20, 3)",
                  [](Inputs& in, double bad) { in.frame.image.at(20, 3, 1) = static_cast<float>(bad); });
}

TEST(NotFinite, PhotographOfAPreparedFrame) {
  expect_reported("image pixel", [](Inputs& in, double bad) {
    in.spoil_prepared = [bad](PreparedFrame& prepared) {
      for (float& value : prepared.frame.image.data) value = static_cast<float>(bad);
    };
  });
}

/// An infinite depth means far away; a NaN is an error.
TEST(NotFinite, Depth) {
  Inputs inputs = good_inputs();
  inputs.spoil_prepared = [](PreparedFrame& prepared) {
    for (float& depth : prepared.depth.data) depth = std::nanf("");
  };
  EXPECT_NE(test::error_text<InputError>([&] { run(inputs); }).find("depth pixel"), std::string::npos);
  inputs.spoil_prepared = [](PreparedFrame& prepared) {
    for (float& depth : prepared.depth.data) depth = std::numeric_limits<float>::infinity();
  };
  run(inputs);
}

TEST(NotFinite, Sweep) {
  expect_reported("sweep point 9",
                  [](Inputs& in, double bad) { in.frame.sweep[9].z = static_cast<float>(bad); });
  expect_reported("sweep point 3",
                  [](Inputs& in, double bad) { in.frame.sweep[3].reflectance = static_cast<float>(bad); });
}

TEST(NotFinite, Calibration) {
  expect_reported("camera fx", [](Inputs& in, double bad) { in.frame.calibration.camera.fx = bad; });
  expect_reported("camera cx", [](Inputs& in, double bad) { in.frame.calibration.camera.cy = bad; });
  expect_reported("calibration", [](Inputs& in, double bad) {
    in.frame.calibration.camera_from_velo.translation().x() = bad;
  });
}

TEST(NotFinite, LidarModel) {
  expect_reported("beam 2", [](Inputs& in, double bad) { in.lidar.beams[2].elevation = bad; });
  expect_reported("azimuths", [](Inputs& in, double bad) { in.lidar.azimuth_step = bad; });
  expect_reported("mount pose", [](Inputs& in, double bad) { in.lidar.velo_from_lidar(0, 3) = bad; });
}

TEST(NotFinite, Lighting) {
  expect_reported("lighting", [](Inputs& in, double bad) { in.frame.lighting.sun.x() = bad; });
}

TEST(NotFinite, LabelBox) {
  expect_reported("label 0", [](Inputs& in, double bad) { in.frame.labels[0].box.bev.yaw = bad; });
  expect_reported("host label", [](Inputs& in, double bad) { in.placement.carrier->label.box.bev.x = bad; });
}

TEST(NotFinite, Placement) {
  expect_reported("placement", [](Inputs& in, double bad) { in.placement.velo_from_adversary(1, 3) = bad; });
}

TEST(NotFinite, Settings) {
  expect_reported("sigma", [](Inputs& in, double bad) { in.settings.raster.sigma = bad; });
  expect_reported("gamma", [](Inputs& in, double bad) { in.settings.raster.gamma = bad; });
  expect_reported("epsilon", [](Inputs& in, double bad) { in.settings.raster.epsilon = bad; });
  expect_reported("dist_eps", [](Inputs& in, double bad) { in.settings.raster.dist_eps = bad; });
  expect_reported("edge_on_altitude",
                  [](Inputs& in, double bad) { in.settings.raster.edge_on_altitude = bad; });
  expect_reported("lidar_reflectivity", [](Inputs& in, double bad) { in.settings.lidar_reflectivity = bad; });
  expect_reported("occlusion_margin", [](Inputs& in, double bad) { in.settings.occlusion_margin = bad; });
  expect_reported("grazing_cosine", [](Inputs& in, double bad) { in.settings.grazing_cosine = bad; });
  Inputs inputs = good_inputs();
  inputs.settings.supersampling = 0;
  EXPECT_NE(test::error_text<InputError>([&] { run(inputs); }).find("supersampling"), std::string::npos);
}

TEST(NotFinite, SettingsOfBothRasterisers) {
  const auto spoilers = {+[](SoftRasterSettings<double>& s, double bad) { s.sigma = bad; },
                         +[](SoftRasterSettings<double>& s, double bad) { s.gamma = bad; },
                         +[](SoftRasterSettings<double>& s, double bad) { s.near = bad; },
                         +[](SoftRasterSettings<double>& s, double bad) { s.far = bad; }};
  for (const auto spoil : spoilers)
    for (double bad : kBad) {
      test::RasterProblem problem = test::random_problem(1, 2, 1e-4, 1e-2);
      spoil(problem.settings, bad);
      test::error_text<InputError>([&] { rasterize(problem.mesh, problem.settings, problem.target); });
      RasterTarget<float> target;
      target.width = problem.target.width;
      target.height = problem.target.height;
      target.rect = problem.target.rect;
      target.background = ImageF(target.rect.width(), target.rect.height(), 3);
      const RasterJob job{&problem.mesh, &problem.settings, &target};
      RasterTape tape;
      test::error_text<InputError>([&] { rasterize_batch({&job, 1}, {&tape, 1}); });
    }
}

/// Both rasterisers skip a face that is not finite or not in front of the camera, as soft_rasterizer.h says.
TEST(NotFinite, FacesOnScreenAreSkipped) {
  for (double bad : kBad)
    for (int c = 0; c < 3; ++c) {
      RandomStream random(5, "spoilt face");
      const test::RasterProblem problem = test::random_problem(2, 4, 1e-4, 1e-2);
      test::Extreme extreme;
      extreme.mesh = problem.mesh;
      extreme.settings = problem.settings;
      extreme.mesh.resolution = 1;
      extreme.mesh.texels.resize(4);
      test::Extreme without = extreme;
      extreme.mesh.faces[1][2][c] = bad;
      without.mesh.faces[1][2].z() = -1;
      test::fit_window(30, 16, {0, 0, 30, 16}, random, extreme);
      without.target = extreme.target;
      without.upstream = extreme.upstream;
      const auto a = test::draw_fast(extreme), b = test::draw_fast(without);
      EXPECT_EQ(a.image, b.image);
      EXPECT_EQ(a.vertices, b.vertices);
      test::expect_stable(extreme);
    }
}

TEST(NotFinite, UpstreamGradientOfTheImage) {
  expect_reported<Failure>("d_image pixel", [](Inputs& in, double bad) {
    in.spoil_upstream = [bad](ImageF& d_image, auto&) {
      for (float& d : d_image.data) d = static_cast<float>(bad);
    };
  });
}

TEST(NotFinite, UpstreamGradientOfThePoints) {
  expect_reported<Failure>("d_points point", [](Inputs& in, double bad) {
    in.spoil_upstream = [bad](ImageF&, auto& d_points) { d_points.back()[1] = static_cast<float>(bad); };
  });
}

TEST(NotFinite, ProposalsOfADetector) {
  const BevBox host{10, 0, 4, 2, 0};
  for (double bad : kBad) {
    const std::vector<Detection> logit{{host, 1}, {host, bad}};
    BevBox nowhere = host;
    nowhere.x = bad;
    const std::vector<Detection> box{{nowhere, 1}};
    for (const auto& [proposals, name] : {std::pair{logit, "box 1 of 2"}, std::pair{box, "box 0 of 1"}}) {
      EXPECT_NE(test::error_text<InputError>([&] {
                  objective(proposals, {host, {}}, {});
                }).find(name),
                std::string::npos);
      EXPECT_NE(test::error_text<InputError>([&] { suppress(proposals); }).find(name), std::string::npos);
    }
  }
}

}  // namespace
}  // namespace mirage
