#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "base/random.h"
#include "scene/depth_completion.h"
#include "scene/kitti.h"
#include "support/files.h"

namespace mirage {
namespace {

Calibration looking_along_x() {
  Calibration calibration;
  calibration.camera = {100, 100, 50, 30, 101, 61};
  calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  return calibration;
}

TEST(SparseDepth, KeepsTheNearestReturnOfAPixel) {
  const Sweep sweep = {{20, 0, 0, 0}, {10, 0, 0, 0},  {30, 0, 0, 0},
                       {-5, 0, 0, 0}, {10, -2, 1, 0}, {10, 50, 0, 0}};
  const ImageF depth = sparse_depth(sweep, looking_along_x());
  ASSERT_EQ(depth.width, 101);
  ASSERT_EQ(depth.height, 61);
  EXPECT_FLOAT_EQ(depth.at(50, 30), 10);
  EXPECT_FLOAT_EQ(depth.at(70, 20), 10);  // right by 2 m and up by 1 m at 10 m
  EXPECT_EQ(std::count_if(depth.data.begin(), depth.data.end(), [](float z) { return z > 0; }), 2);
}

TEST(CompleteDepth, AConstantDepthIsFilledWithItself) {
  ImageF sparse(120, 80, 1);
  for (int v = 30; v < 80; v += 4)
    for (int u = 0; u < 120; u += 3) sparse.at(u, v) = 20;
  const ImageF dense = complete_depth(sparse);
  for (int v = 34; v < 78; ++v)
    for (int u = 4; u < 116; ++u) EXPECT_NEAR(dense.at(u, v), 20, 1e-3) << u << ' ' << v;
  // Nothing is invented far above the topmost return.
  for (int u = 0; u < 120; ++u) EXPECT_EQ(dense.at(u, 10), kFarDepth);
}

TEST(CompleteDepth, NearSurfacesWinOverFarOnes) {
  ImageF sparse(120, 80, 1);
  for (int v = 20; v < 80; v += 3)
    for (int u = 0; u < 120; u += 3) sparse.at(u, v) = u >= 50 && u < 70 && v >= 40 && v < 60 ? 8.f : 50.f;
  const ImageF dense = complete_depth(sparse);
  EXPECT_NEAR(dense.at(60, 50), 8, 0.1);
  EXPECT_NEAR(dense.at(20, 50), 50, 0.5);
}

TEST(CompleteDepth, LargeHolesCloseBelowTheTop) {
  ImageF sparse(120, 80, 1);
  for (int v = 10; v < 80; v += 2)
    for (int u = 0; u < 120; u += 2)
      if (!(u > 50 && u < 70 && v > 35 && v < 55)) sparse.at(u, v) = 15;
  const ImageF dense = complete_depth(sparse);
  EXPECT_NEAR(dense.at(60, 45), 15, 0.5);
}

TEST(CompleteDepth, NothingIsFar) {
  const ImageF dense = complete_depth(ImageF(64, 48, 1));
  EXPECT_TRUE(std::all_of(dense.data.begin(), dense.data.end(), [](float z) { return z == kFarDepth; }));
}

TEST(CompleteDepthRealFrames, HeldBackReturnsAreMet) {
  MIRAGE_NEED_REAL_FRAMES();
  const auto ids = list_frames(test::real_frames());
  std::vector<double> errors;
  for (std::size_t i = 0; i < ids.size(); i += 11) {
    const Frame frame = read_frame(test::real_frames(), ids[i]);
    Sweep kept, held;
    RandomStream random(5, "held back", i);
    for (const LidarPoint& point : frame.sweep) (random.uniform() < 0.1 ? held : kept).push_back(point);
    const ImageF dense = complete_depth(sparse_depth(kept, frame.calibration));
    const ImageF truth = sparse_depth(held, frame.calibration);
    for (std::size_t p = 0; p < truth.data.size(); ++p)
      if (truth.data[p] > 0) errors.push_back(std::abs(double(truth.data[p]) - double(dense.data[p])));
  }
  ASSERT_GT(errors.size(), 1000u);
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[errors.size() / 2], 0.2);
  EXPECT_LT(errors[errors.size() * 9 / 10], 1.5);
  RecordProperty("median_error_m", std::to_string(errors[errors.size() / 2]));
}

}  // namespace
}  // namespace mirage
