#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "base/error.h"
#include "base/files.h"
#include "generator/car_family.h"
#include "geometry/shapes.h"
#include "scene/shape/shape_fit.h"
#include "shape_fixture.h"
#include "support/files.h"
#include "support/gradient_check.h"

namespace mirage {
namespace {

using test::error_text;
using testing::HasSubstr;

TEST(CarFamily, EveryStyleGivesClosedCarsOfItsProportions) {
  for (BodyStyle style : kBodyStyles)
    for (int i = 0; i < 3; ++i) {
      RandomStream random(3, "family test", i);
      const Mesh mesh = car_mesh(draw_body(style, random));
      EXPECT_TRUE(is_watertight(mesh)) << name_of(style);
      const Vec3d size = bounds(mesh).sizes();
      EXPECT_GT(signed_volume(mesh), 0.4 * size.prod()) << name_of(style);
      EXPECT_LT(signed_volume(mesh), 0.95 * size.prod()) << name_of(style);
      EXPECT_NEAR(bounds(mesh).min().z(), 0, 1e-12);
      EXPECT_GT(size.x(), 3.2);
      EXPECT_LT(size.x(), 6.1);
      // The roof is over the cabin: a pick-up's lies before the middle, a van's is long.
      const Vec3d roof = roof_point(mesh);
      EXPECT_GT(roof.z(), 0.97 * size.z());
      EXPECT_LT(std::abs(roof.x()), 0.25 * size.x());
    }
}

TEST(ShapeModel, ProjectionRebuildsAnUnseenVehicle) {
  const ShapeModel& model = test::small_shape_model();
  EXPECT_GT(model.explained.back(), 0.9);
  for (int k = 1; k < model.dimension; ++k) EXPECT_GE(model.explained[k], model.explained[k - 1]);
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
  // The prior's block of the codes is the unit matrix, its means 0.
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
    const Vec3d p(random.uniform(-2, 2), random.uniform(-1, 1), random.uniform(0, 1.7));
    // Trilinear slopes jump at the cells' faces and at the mirror: keep off them.
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
  // Far outside the grid nothing changes any more: all derivatives but the code's are zero, and finite.
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
