#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/error.h"
#include "base/files.h"
#include "base/random.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "scene/depth_completion.h"
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
  // No depth is completed far above the topmost return.
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

TEST(SparseDepth, SkipsReturnsThatAreNotFinite) {
  const float nan = std::nanf(""), inf = HUGE_VALF;
  const Sweep sweep = {{nan, 0, 0, 0}, {10, nan, 0, 0}, {10, 0, inf, 0}, {inf, 0, 0, 0}, {12, 0, 0, nan}};
  const ImageF depth = sparse_depth(sweep, looking_along_x());
  EXPECT_FLOAT_EQ(depth.at(50, 30), 12);
  EXPECT_EQ(std::count(depth.data.begin(), depth.data.end(), 0.f), 101 * 61 - 1);
}

std::vector<IpBasic> every_mode() {
  std::vector<IpBasic> modes;
  for (const bool multi_scale : {false, true})
    for (const auto blur : {IpBasicOptions::Blur::gaussian, IpBasicOptions::Blur::bilateral})
      for (const bool extrapolate : {false, true})
        modes.emplace_back(IpBasicOptions{multi_scale, blur, extrapolate});
  return modes;
}

/// A wall of 40 m behind a box of 8 m.
ImageF box_before_wall() {
  ImageF sparse(120, 80, 1);
  for (int v = 20; v < 80; v += 3)
    for (int u = 0; u < 120; u += 3) sparse.at(u, v) = u >= 45 && u < 75 ? 8.f : 40.f;
  return sparse;
}

TEST(IpBasicModes, AreNamedForWhatDiffers) {
  EXPECT_EQ(IpBasic().name(), "ip-basic");
  EXPECT_EQ(IpBasic({true, IpBasicOptions::Blur::bilateral, true}).name(),
            "ip-basic-multiscale-bilateral-extrapolated");
}

TEST(IpBasicModes, AConstantDepthIsFilledWithItself) {
  ImageF sparse(120, 80, 1);
  for (int v = 30; v < 80; v += 4)
    for (int u = 0; u < 120; u += 3) sparse.at(u, v) = 20;
  for (const IpBasic& mode : every_mode()) {
    const ImageF dense = mode.complete({}, sparse);
    for (int v = 34; v < 78; ++v)
      for (int u = 4; u < 116; ++u) EXPECT_NEAR(dense.at(u, v), 20, 1e-3) << mode.name();
    const bool up = mode.name().ends_with("-extrapolated");
    for (int u = 4; u < 116; ++u)
      EXPECT_NEAR(dense.at(u, 3), up ? 20 : kFarDepth, up ? 1e-3 : 0) << mode.name();
  }
}

TEST(IpBasicModes, TheBilateralBlurMixesNoSurfaces) {
  const ImageF sparse = box_before_wall();
  const auto mixed = [&](const IpBasicOptions& options) {
    const ImageF dense = IpBasic(options).complete({}, sparse);
    int count = 0;  // pixels on neither surface
    for (int v = 30; v < 70; ++v)
      for (int u = 10; u < 110; ++u) count += dense.at(u, v) > 9 && dense.at(u, v) < 39;
    return count;
  };
  for (const bool multi_scale : {false, true}) {
    EXPECT_EQ(mixed({multi_scale, IpBasicOptions::Blur::bilateral, false}), 0);
    EXPECT_GT(mixed({multi_scale, IpBasicOptions::Blur::gaussian, false}), 50);
  }
}

TEST(IpBasicModes, WhatIsNoDepthIsNoReturn) {
  const ImageF clean = box_before_wall();
  ImageF dirty = clean;
  const float bad[] = {std::nanf(""), HUGE_VALF, -HUGE_VALF, -3, 1e9f};
  for (int i = 0; i < 5; ++i) dirty.at(10 + 20 * i, 41) = bad[i];
  for (const IpBasic& mode : every_mode())
    EXPECT_EQ(mode.complete({}, dirty).data, mode.complete({}, clean).data) << mode.name();
}

TEST(IpBasicModes, AllReturnsInOnePixel) {
  ImageF sparse(64, 48, 1);
  sparse.at(30, 20) = 12;
  for (const IpBasic& mode : every_mode()) {
    const ImageF dense = mode.complete({}, sparse);
    const bool bilateral = mode.name().find("bilateral") != std::string::npos;
    // The multi-scale variant removes an isolated return as an outlier.
    if (mode.name().find("multiscale") == std::string::npos) {
      EXPECT_NEAR(dense.at(30, 20), 12, 1e-3) << mode.name();
    }
    for (float depth : dense.data) {
      if (depth == kFarDepth) continue;
      EXPECT_GT(depth, 12 - 1e-3) << mode.name();
      EXPECT_LT(depth, bilateral ? 12 + 1e-3 : 100) << mode.name();  // Gaussian: mixed with holes around
    }
  }
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

// Back-ends by name, and every error of a depth completion plugin: one clear line each.

namespace {

using test::error_text;
using testing::HasSubstr;
using testing::Not;

DepthOptions fake(const std::string& kind) {
  DepthOptions options;
  options.backend = std::string(MIRAGE_BUILD) + "/test_plugins/fake_depth_" + kind + ".so";
  options.fresh = true;
  return options;
}

std::string load_error(const DepthOptions& options) {
  const std::string text = error_text<InputError>([&] { load_depth_completion(options); });
  EXPECT_THAT(text, Not(HasSubstr("\n")));
  return text;
}

struct Picture {
  ImageF image{6, 4, 3, 0.5f}, sparse{6, 4, 1};
};

TEST(DepthBackEnds, ClassicalOnesByName) {
  for (const char* name : {"ip-basic", "ip-basic-bilateral", "ip-basic-multiscale",
                           "ip-basic-multiscale-bilateral", "ip-basic-extrapolated"})
    EXPECT_EQ(load_depth_completion({name})->name(), name);
  if (!std::filesystem::exists(MIRAGE_BUILD "/plugins/guided.so"))
    GTEST_SKIP() << "other names are asked of a plugin that was not built";
  EXPECT_THAT(load_error({"magic"}), HasSubstr("magic: unknown; use ip-basic"));
  EXPECT_THAT(load_error({"ip-basic-magic"}), HasSubstr("ip-basic-magic"));
}

TEST(DepthBackEnds, RunsAPluginThatWorks) {
  const auto completion = load_depth_completion(fake("works"));
  EXPECT_EQ(completion->name(), "fake");
  Picture picture;
  picture.sparse.data[3] = 7;
  picture.sparse.data[4] = std::nanf("");
  picture.sparse.data[5] = -2;
  const ImageF dense = completion->complete(picture.image, picture.sparse);
  EXPECT_EQ(dense.data[3], 7);
  for (std::size_t i = 0; i < dense.data.size(); ++i)
    if (i != 3) {
      EXPECT_EQ(dense.data[i], kFarDepth);  // missing, NaN or negative depth: no return
    }
  EXPECT_TRUE(completion->complete({}, {}).empty());
}

TEST(DepthBackEnds, WrongPluginsAreNamed) {
  EXPECT_THAT(load_error({"/nowhere/depth.so"}), HasSubstr("/nowhere/depth.so: no such depth completion"));
  EXPECT_THAT(load_error(fake("no_entry")), HasSubstr("mirage_depth_api: the plugin lacks this entry point"));
  EXPECT_THAT(load_error(fake("wrong_abi")), HasSubstr("abi_version: is 999, this program speaks 1"));
  EXPECT_THAT(load_error(fake("refuses")), HasSubstr("these weights are for another network"));
  EXPECT_THAT(error_text<Failure>([] { load_depth_completion(fake("throws_in_create")); }),
              HasSubstr("create threw an exception (thrown on purpose)"));
  test::TemporaryFolder folder;
  write_file(folder / "text.so", "this is text");
  DepthOptions text;
  text.backend = folder / "text.so";
  text.fresh = true;
  EXPECT_THAT(load_error(text), HasSubstr("not a loadable plugin"));
}

TEST(DepthBackEnds, PluginsThatFailLater) {
  const Picture picture;
  const auto run = [&](const char* kind) {
    const auto completion = load_depth_completion(fake(kind));
    return error_text<Failure>([&] { completion->complete(picture.image, picture.sparse); });
  };
  EXPECT_THAT(run("throws_in_run"), HasSubstr("complete threw an exception (thrown on purpose)"));
  EXPECT_THAT(run("fails_in_run"), HasSubstr("complete failed (out of luck)"));
  EXPECT_THAT(run("not_finite"), HasSubstr("not finite"));
}

TEST(DepthBackEnds, BadPicturesAreReported) {
  const auto completion = load_depth_completion(fake("works"));
  Picture picture;
  picture.image.at(2, 1, 1) = std::nanf("");
  EXPECT_THAT(error_text<InputError>([&] { completion->complete(picture.image, picture.sparse); }),
              HasSubstr("pixel (2, 1)"));
  EXPECT_THAT(error_text<InputError>([&] { completion->complete(ImageF(5, 4, 3), picture.sparse); }),
              HasSubstr("not an RGB picture of the sparse depth's size"));
}

TEST(DepthBackEnds, MissingWeights) {
  DepthOptions options = fake("works");
  options.fresh = false;
  EXPECT_THAT(load_error(options), HasSubstr("shipped weights are missing"));
  options.weights = "/nowhere/my.weights";
  EXPECT_THAT(load_error(options), HasSubstr("/nowhere/my.weights: no such weights file"));
}

}  // namespace
}  // namespace mirage
