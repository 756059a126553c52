// What is said of the fits of a data set, and how files hold it.
#include <gtest/gtest.h>

#include <cmath>

#include "generator/fit_summary.h"

namespace mirage {
namespace {

/// At `range` m; `points` returns, of which a fit is made from 20 on. The truth is known up to 20 m.
FittedVehicle vehicle(double range, int points) {
  FittedVehicle v;
  v.range = range;
  v.fit.points = points;
  v.fit.fitted = points >= 20;
  v.residual = range / 1000;
  v.seconds = 0.5;
  if (v.fit.fitted && range < 20)
    v.error = FitError{Vec3d(-0.1, 0.2, 0), Vec3d(0, 0, -0.3), -0.01, 0.02, 0.03};
  return v;
}

TEST(FitSummary, CountsByRangeAndByReturns) {
  const FitReport report =
      summarise_fits({vehicle(5, 500), vehicle(15, 50), vehicle(25, 25), vehicle(45, 10), vehicle(60, 2000)});
  EXPECT_EQ(report.all.vehicles, 5u);
  EXPECT_EQ(report.all.fitted, 4u);
  EXPECT_EQ(report.within_30_m.vehicles, 3u);
  EXPECT_DOUBLE_EQ(report.all.residual.median, 0.025);
  ASSERT_EQ(report.by_range.size(), 5u);
  ASSERT_EQ(report.by_returns.size(), 6u);
  for (const auto& [classes, expected] :
       {std::pair(&report.by_range, std::vector<std::size_t>{1, 1, 1, 0, 2}),
        std::pair(&report.by_returns, std::vector<std::size_t>{1, 1, 1, 0, 1, 1})})
    for (std::size_t i = 0; i < expected.size(); ++i)
      EXPECT_EQ((*classes)[i].fits.vehicles, expected[i]) << (*classes)[i].low;
  EXPECT_TRUE(std::isinf(report.by_range.back().high));
  ASSERT_TRUE(report.all.error);
  EXPECT_EQ(report.all.error->vehicles, 2u);
  EXPECT_DOUBLE_EQ(report.all.error->roof[0].median, 0.1);  // without its sign
  EXPECT_DOUBLE_EQ(report.all.error->distance.p95, std::hypot(0.1, 0.2));
  EXPECT_FALSE(report.by_range.back().fits.error);
}

TEST(FitSummary, AsFilesHoldIt) {
  const nlohmann::json json = to_json(summarise_fits({vehicle(5, 500), vehicle(45, 10)}));
  EXPECT_EQ(json.at("by_range").at(0).at("range_m"), (nlohmann::json{0.0, 10.0}));
  EXPECT_EQ(json.at("by_range").at(4).at("range_m"), (nlohmann::json{40.0, nullptr}));
  EXPECT_EQ(json.at("by_returns").at(0).at("returns").dump(), "[0,20]");
  EXPECT_EQ(json.at("by_returns").at(5).at("returns").dump(), "[1000,null]");
  const auto& all = json.at("all");
  EXPECT_EQ(all.at("vehicles"), 2);
  EXPECT_EQ(all.at("fitted"), 1);
  EXPECT_EQ(all.at("from_box"), 1);
  EXPECT_EQ(all.at("residual_m"), (nlohmann::json{{"median", 0.005}, {"p95", 0.005}}));
  EXPECT_EQ(all.at("roof_over_box_m"), (nlohmann::json{{"p05", 0.0}, {"median", 0.0}, {"p95", 0.0}}));
  const auto& error = all.at("error");
  EXPECT_EQ(error.at("vehicles"), 1);
  EXPECT_EQ(error.at("roof_y_m").at("median"), 0.2);
  EXPECT_EQ(error.at("box_z_m").at("median"), 0.3);
  EXPECT_EQ(error.at("yaw_rad").at("median"), 0.01);
  EXPECT_EQ(error.at("fitted_to_true_m").at("median"), 0.02);
  EXPECT_EQ(error.at("true_to_fitted_m").at("median"), 0.03);
  EXPECT_FALSE(json.at("by_range").at(4).contains("error"));
}

}  // namespace
}  // namespace mirage
