#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "generator/car_body.h"
#include "generator/fit.h"
#include "generator/street.h"
#include "geometry/mesh.h"
#include "scene/shape/shape_fit.h"
#include "sensors/ray_caster.h"
#include "shape_fixture.h"
#include "support/files.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

const LidarModel& lidar() {
  static const LidarModel model = read_lidar_model(shipped_file("scenes/rigs/kitti64.toml"));
  return model;
}

/// A shape of the model that stands on a flat road, and its LiDAR returns with 1 cm of range noise.
struct Scene {
  ShapeParameters shape;
  Label label;
  Mesh mesh;  // `velo`
  Frame frame;
};

Scene scene_at(double x, double y, double yaw, double code) {
  const ShapeModel& model = test::small_shape_model();
  Scene s;
  s.shape.code = Eigen::VectorXd::Zero(model.dimension);
  s.shape.code[0] = code;
  s.shape.code[1] = -0.5 * code;
  s.shape.log_size = model.prior_mean.head<3>();
  const Vec3d size = model.size(s.shape);
  s.label.type = "Car";
  s.label.box = {{x, y, size.x(), size.y(), yaw}, -lidar().height, size.z()};
  s.mesh = model.mesh(s.shape);
  for (Vec3d& v : s.mesh.vertices) v = velo_from_box(s.label.box) * v;
  Mesh road;
  road.vertices = {{-5, -60, -lidar().height},
                   {90, -60, -lidar().height},
                   {90, 60, -lidar().height},
                   {-5, 60, -lidar().height}};
  road.faces = {{0, 1, 2}, {0, 2, 3}};
  const Mesh meshes[] = {s.mesh, road};
  const RayCaster caster(meshes);
  RandomStream random(1, "fit test");
  for (std::size_t beam = 0; beam < lidar().beams.size(); ++beam)
    for (int column = 0; column < lidar().azimuth_count(); ++column) {
      const LidarRay ray = lidar().ray(static_cast<int>(beam), column);
      const Hit hit = caster.intersect({ray.origin.cast<float>(), ray.direction.cast<float>()});
      if (!hit.hit() || hit.t > lidar().range_max) continue;
      const Vec3d p = ray.origin + (hit.t + 0.01 * random.normal()) * ray.direction;
      s.frame.sweep.push_back({float(p.x()), float(p.y()), float(p.z()), 0.3f});
    }
  s.frame.labels = {s.label};
  return s;
}

Vec3d true_roof(const Scene& s) {
  Mesh mesh = s.mesh;
  const Transform box_from_velo = velo_from_box(s.label.box).inverse();
  for (Vec3d& v : mesh.vertices) v = box_from_velo * v;
  return velo_from_box(s.label.box) * roof_point(mesh);
}

TEST(ShapeFit, FindsAShapeOfItsOwnFromADisturbedBox) {
  for (double yaw : {0.2, 1.7, std::numbers::pi - 0.3}) {
    const Scene s = scene_at(12, 3, yaw, 1.0);
    Label label = s.label;
    label.box.bev.x += 0.08;
    label.box.bev.y -= 0.06;
    label.box.bottom += 0.05;
    label.box.bev.yaw += 0.02;
    label.box.bev.length *= 1.03;
    label.box.height *= 0.97;
    const SweepIndex index(s.frame.sweep, lidar());
    const ShapeFit fit = ShapeRoofFinder(test::small_shape_model(), lidar()).fit(index, label);
    ASSERT_TRUE(fit.fitted) << fit.reason;
    EXPECT_TRUE(is_watertight(fit.mesh));
    EXPECT_GT(signed_volume(fit.mesh), 0);
    EXPECT_LT((Vec3d(fit.velo_from_roof.translation()) - true_roof(s)).norm(), 0.08);
    const Vec3d heading = fit.velo_from_vehicle.linear().col(0);
    EXPECT_NEAR(std::remainder(std::atan2(heading.y(), heading.x()) - yaw, 2 * std::numbers::pi), 0, 0.01);
    EXPECT_NEAR(fit.size.x(), s.label.box.bev.length, 0.15);
  }
}

TEST(ShapeFit, ReturnsInTheCabinDoNotPullTheRoofDown) {
  Scene s = scene_at(10, 2, 0.3, 0.5);
  RandomStream random(2, "cabin");
  // A tenth as many returns on seats as on the body.
  for (int i = 0; i < 200; ++i) {
    const Vec3d p = velo_from_box(s.label.box) *
                    Vec3d{random.uniform(-1, 0.4), random.uniform(-0.5, 0.5), random.uniform(0.6, 1.1)};
    s.frame.sweep.push_back({float(p.x()), float(p.y()), float(p.z()), 0.1f});
  }
  const Carrier roof = ShapeRoofFinder(test::small_shape_model(), lidar()).find(s.frame, s.label);
  EXPECT_FALSE(roof.from_box);
  EXPECT_LT((Vec3d(roof.velo_from_roof.translation()) - true_roof(s)).norm(), 0.1);
}

TEST(ShapeRoofFinder, TooFewReturnsAndOtherTypesFallBackToTheBox) {
  Scene s = scene_at(12, 3, 0.2, 0);
  const ShapeRoofFinder finder(test::small_shape_model(), lidar());
  const Transform box = BoxRoofFinder().find(s.frame, s.label).velo_from_roof;
  Label truck = s.label;
  truck.type = "Truck";
  EXPECT_TRUE(finder.find(s.frame, truck).from_box);
  EXPECT_THAT(finder.fit(SweepIndex(s.frame.sweep, lidar()), truck).reason, testing::HasSubstr("Truck"));

  // The same frame without the vehicle: only road.
  std::erase_if(s.frame.sweep, [](const LidarPoint& p) { return p.z > -lidar().height + 0.1; });
  const Carrier roof = finder.find(s.frame, s.label);
  EXPECT_TRUE(roof.from_box);
  EXPECT_TRUE(roof.velo_from_roof.isApprox(box));
  const ShapeFit none = finder.fit(SweepIndex(s.frame.sweep, lidar()), s.label);
  EXPECT_FALSE(none.fitted);
  EXPECT_THAT(none.reason, testing::HasSubstr("fewer than"));

  s.frame.sweep.clear();
  EXPECT_TRUE(finder.find(s.frame, s.label).from_box);
}

TEST(ShapeFit, IsDeterministic) {
  const Scene s = scene_at(15, -4, 2.5, -0.8);
  const ShapeRoofFinder a(test::small_shape_model(), lidar()), b(test::small_shape_model(), lidar());
  EXPECT_EQ(a.find(s.frame, s.label).velo_from_roof.matrix(),
            b.find(s.frame, s.label).velo_from_roof.matrix());
}

TEST(VehicleEvidence, SeesTheGroundAndLeavesItsReturnsOut) {
  const Scene s = scene_at(12, 3, 0.2, 0);
  const VehicleEvidence evidence = gather_evidence(SweepIndex(s.frame.sweep, lidar()), s.label.box);
  ASSERT_TRUE(evidence.ground.has_value());
  EXPECT_NEAR(evidence.ground->at(0, 0), 0, 0.02);
  EXPECT_LT(evidence.ground->slope.norm(), 0.02);
  EXPECT_GT(evidence.points, 200);
  for (const Vec3d& p : evidence.surface) EXPECT_GT(p.z(), 0.09);
  // A ray that is recorded as empty does not end behind the surface that it met.
  const ShapeModel& model = test::small_shape_model();
  const Eigen::VectorXd q = s.shape.packed();
  for (const Segment& e : evidence.empty) EXPECT_GT(model.distance(q.data(), e.to), -0.05);
}

TEST(RoofPoint, BoxWedgeAndEmptyMesh) {
  Mesh box = box_mesh({4, 2, 1});
  EXPECT_LT((roof_point(box) - Vec3d(0, 0, 0.5)).norm(), 0.03);
  // A cabin of 2 m × 1.4 m behind the middle, 0.5 m above the body: only its top is the roof.
  append(box, box_mesh({2, 1.4, 0.5}), Transform(Eigen::Translation3d(-0.6, 0, 0.75)));
  EXPECT_LT((roof_point(box) - Vec3d(-0.6, 0, 1.0)).norm(), 0.03);
  EXPECT_NE(test::error_text<InputError>([] { roof_point({}); }).find("faces"), std::string::npos);
}

TEST(VehicleTruth, GivesTheBoxesThatTheFrameWasMadeWith) {
  const auto vehicles = generator::true_vehicles({.seed = 2}, 3, 1.73);
  ASSERT_FALSE(vehicles.empty());
  int cars = 0;
  for (const auto& v : vehicles) {
    if (v.type != "Car") continue;
    ++cars;
    Mesh mesh = v.mesh;
    for (Vec3d& p : mesh.vertices) p = velo_from_box(v.box).inverse() * p;
    const Vec3d size = bounds(mesh).sizes();
    EXPECT_NEAR(size.x(), v.box.bev.length, 0.02);
    EXPECT_GE(size.y(), v.box.bev.width - 0.01);  // mirrors stand out
    EXPECT_NEAR(bounds(mesh).max().z(), v.box.height, 0.02);
    EXPECT_NEAR(roof_point(mesh).z(), v.box.height, 0.05);
    const auto* found = generator::find_vehicle(vehicles, "Car", v.box);
    ASSERT_NE(found, nullptr);
    EXPECT_EQ(found, &v);
  }
  EXPECT_GT(cars, 0);
  EXPECT_EQ(generator::find_vehicle(vehicles, "Car", {{500, 0, 4, 2, 0}, 0, 1.5}), nullptr);
}

using test::error_text;
using testing::HasSubstr;

TEST(CarFamily, EveryStyleGivesClosedCarsOfItsProportions) {
  for (BodyStyle style : kBodyStyles)
    for (std::size_t i = 0; i < 3; ++i) {
      RandomStream random(3, "family test", i);
      const Mesh mesh = car_mesh(draw_body(style, random));
      EXPECT_TRUE(is_watertight(mesh)) << name_of(style);
      const Vec3d size = bounds(mesh).sizes();
      EXPECT_GT(signed_volume(mesh), 0.4 * size.prod()) << name_of(style);
      EXPECT_LT(signed_volume(mesh), 0.95 * size.prod()) << name_of(style);
      EXPECT_NEAR(bounds(mesh).min().z(), 0, 1e-12);
      EXPECT_GT(size.x(), 3.2);
      EXPECT_LT(size.x(), 6.1);
      // The roof is above the cabin: a pick-up's is before the middle, a van's is long.
      const Vec3d roof = roof_point(mesh);
      EXPECT_GT(roof.z(), 0.97 * size.z());
      EXPECT_LT(std::abs(roof.x()), 0.25 * size.x());
    }
}

TEST(ShapeModel, ProjectionRebuildsAnUnseenVehicle) {
  const ShapeModel& model = test::small_shape_model();
  EXPECT_GT(model.explained.back(), 0.9);
  for (int k = 1; k < model.dimension; ++k)
    EXPECT_GE(model.explained[as_size(k)], model.explained[as_size(k - 1)]);
  RandomStream random(99, "unseen");
  const Mesh car = car_mesh(draw_body(BodyStyle::saloon, random));
  const ShapeParameters q = project(model, car);
  const Mesh rebuilt = model.mesh(q);
  EXPECT_TRUE(is_watertight(rebuilt));
  EXPECT_NEAR(signed_volume(rebuilt) / signed_volume(car), 1, 0.05);
  EXPECT_LT((roof_point(rebuilt) - roof_point(car)).norm(), 0.12);
  for (int a = 0; a < 3; ++a) EXPECT_NEAR(bounds(rebuilt).sizes()[a], bounds(car).sizes()[a], 0.12);
}

TEST(ShapeModel, CodesHaveVarianceOneAndNoMean) {
  // The code's block of the prior is the unit matrix, its means are 0.
  const ShapeModel& model = test::small_shape_model();
  const int k = model.dimension;
  EXPECT_LT(model.prior_mean.tail(k).norm(), 1e-3);
  EXPECT_LT((model.prior_covariance.bottomRightCorner(k, k) - Eigen::MatrixXd::Identity(k, k)).norm(), 1e-2);
}

TEST(ShapeModel, DerivativesAgreeWithCentralDifferences) {
  const ShapeModel& model = test::small_shape_model();
  RandomStream random(4, "shape gradient");
  const auto check = [&](const Eigen::VectorXd& q, const Vec3d& p) {
    const std::vector<double> x(q.data(), q.data() + q.size());
    std::vector<double> gradient(x.size());
    model.distance(x.data(), p, gradient.data());
    test::check_gradient([&](const std::vector<double>& at) { return model.distance(at.data(), p); }, x,
                         gradient, 1e-6, 1e-5, 1e-2);
  };
  int checked = 0;
  for (int i = 0; i < 60; ++i) {
    Eigen::VectorXd q(7 + model.dimension);
    for (double& value : q) value = random.normal();
    q.head<3>() *= 0.1;
    q[3] *= 0.2;
    q.segment<3>(4) *= 0.05;
    const Vec3d p{random.uniform(-2, 2), random.uniform(-1, 1), random.uniform(0, 1.7)};
    // Trilinear slopes jump at the cells' faces and at the mirror plane: the points avoid them.
    const ShapeParameters s = ShapeParameters::unpacked(q);
    const Vec3d x = (-s.log_size.array())
                        .exp()
                        .matrix()
                        .cwiseProduct(Eigen::AngleAxisd(-s.yaw, Vec3d::UnitZ()) * (p - s.offset));
    const Vec3d cell =
        (Vec3d(x.x(), std::abs(x.y()), x.z()) - model.layout.origin).cwiseQuotient(model.layout.spacing);
    const Vec3d off = (cell.array() - cell.array().round()).abs();
    if (off.minCoeff() < 1e-3) continue;
    check(q, p);
    ++checked;
  }
  EXPECT_GT(checked, 40);
  // Far outside the grid the field is constant: all derivatives except the code's are zero, and finite.
  Eigen::VectorXd q = Eigen::VectorXd::Zero(7 + model.dimension);
  check(q, {50.01, 30.02, 20.03});
}

TEST(ShapeModel, FileKeepsTheModel) {
  const test::TemporaryFolder folder;
  const ShapeModel& model = test::small_shape_model();
  write_shape_model(folder / "a.shape", model);
  const ShapeModel back = read_shape_model(folder / "a.shape");
  EXPECT_EQ(back.dimension, model.dimension);
  EXPECT_EQ(back.layout.count, model.layout.count);
  EXPECT_EQ(back.sources, model.sources);
  EXPECT_EQ(back.vehicles, model.vehicles);
  ASSERT_EQ(back.values.size(), model.values.size());
  for (std::size_t i = 0; i < model.values.size(); ++i) EXPECT_NEAR(back.values[i], model.values[i], 2e-5);
  EXPECT_LT((back.prior_covariance - model.prior_covariance).norm(), 1e-9);
}

TEST(ShapeModel, BrokenFilesGiveOneClearLine) {
  const test::TemporaryFolder folder;
  const auto file = folder / "a.shape";
  write_shape_model(file, test::small_shape_model());
  const std::string good = read_file(file);
  const auto complaint = [&](const std::string& bytes) {
    write_file(file, bytes);
    const std::string text = error_text<InputError>([&] { read_shape_model(file); });
    EXPECT_THAT(text, HasSubstr("a.shape"));
    EXPECT_EQ(text.find('\n'), std::string::npos);
    return text;
  };
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string bytes = good;
    const auto at = bytes.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    return bytes.replace(at, from.size(), to);
  };
  EXPECT_THAT(complaint("not a model"), HasSubstr("first line"));
  EXPECT_THAT(complaint(""), HasSubstr("first line"));
  EXPECT_THAT(complaint("MIRAGE-SHAPE 1\n{oh\n"), HasSubstr("second line"));
  EXPECT_THAT(complaint(good.substr(0, good.size() - 10)), HasSubstr("numbers"));
  EXPECT_THAT(complaint(with("\"dimension\":", "\"dimensions\":")), HasSubstr("dimension"));
  EXPECT_THAT(complaint(with("\"cut\":", "\"cut\":-")), HasSubstr("cut"));
  EXPECT_THAT(complaint(with("\"scales\":[", "\"scales\":[1,")), HasSubstr("scales"));
  EXPECT_THAT(complaint(with("\"spacing\":[", "\"spacing\":[-")), HasSubstr("spacing"));
}

TEST(ShapeModel, TooFewVehicles) {
  const auto samples = family_samples(1, 1);
  ShapeModelSettings settings;
  settings.dimension = 6;
  EXPECT_THAT(error_text<InputError>([&] { build_shape_model(samples, settings); }), HasSubstr("too few"));
}

TEST(ShapeModel, DoesNotDependOnTheOrderOfThreads) {
  ShapeModelSettings settings;
  settings.dimension = 3;
  settings.spacing = 0.25;
  const auto samples = family_samples(1, 5);
  const ShapeModel a = build_shape_model(samples, settings), b = build_shape_model(samples, settings);
  EXPECT_EQ(a.values, b.values);
  EXPECT_EQ(a.explained, b.explained);
}

}  // namespace
}  // namespace mirage
