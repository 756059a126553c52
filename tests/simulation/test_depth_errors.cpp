// The errors of a dense depth on hand-made pictures, and the comparison of back-ends.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "base/image.h"
#include "scene/data/kitti.h"
#include "simulation/depth_score.h"
#include "support/files.h"

namespace mirage {
namespace {

ImageF row(std::vector<float> values) {
  ImageF image(static_cast<int>(values.size()), 1, 1);
  image.data = std::move(values);
  return image;
}

TEST(DepthErrors, KnownValues) {
  // Errors 1, −2 and 0 m; of inverse depth 1/11 − 1/10, 1/18 − 1/20 and 0.
  const DepthErrors e = depth_errors(row({10, 20, 40, 0, 90}), row({11, 18, 40, 5, 7}), 80);
  EXPECT_EQ(e.pixels, 3u);
  EXPECT_NEAR(e.rmse, 1e3 * std::sqrt(5.0 / 3), 1e-6);
  EXPECT_NEAR(e.mae, 1e3, 1e-6);
  const double a = 1e3 / 110, b = 1e3 / 180;
  EXPECT_NEAR(e.irmse, std::sqrt((a * a + b * b) / 3), 1e-6);
  EXPECT_NEAR(e.imae, (a + b) / 3, 1e-6);
}

TEST(DepthErrors, OnlyChosenPixelsCount) {
  Image<std::uint8_t> where(3, 1, 1);
  EXPECT_EQ(depth_errors(row({1, 2, 3}), row({4, 4, 4}), 80, where).pixels, 0u);
  where.at(1, 0) = 1;
  const DepthErrors e = depth_errors(row({1, 2, 3}), row({4, 4, 4}), 80, where);
  EXPECT_EQ(e.pixels, 1u);
  EXPECT_NEAR(e.rmse, 2000, 1e-6);
}

TEST(DepthErrors, TheMeanIsOverPictures) {
  MeanDepthErrors mean;
  mean.add({1000, 500, 2, 1, 10});
  mean.add({3000, 1500, 4, 3, 90});
  mean.add({});  // no pixel to score
  EXPECT_NEAR(mean.mean().rmse, 2000, 1e-9);
  EXPECT_NEAR(mean.mean().imae, 2, 1e-9);
  EXPECT_EQ(mean.mean().pixels, 100u);
  EXPECT_EQ(MeanDepthErrors().mean().rmse, 0);
}

TEST(DepthErrors, GapsAreFilledAsTheBenchmarkDoes) {
  const float n = kFarDepth;
  ImageF dense(5, 4, 1);
  dense.data = {n, n, n, n, n,  //
                n, 5, n, 3, n,  //
                2, n, 9, n, n,  //
                n, n, n, n, n};
  const ImageF filled = fill_as_benchmark(dense);
  const std::vector<float> expected = {5, 5, 3, 3, 3,  //
                                       5, 5, 3, 3, 3,  //
                                       2, 2, 9, 9, 9,  //
                                       2, 2, 9, 9, 9};
  EXPECT_EQ(filled.data, expected);
  const ImageF nothing(4, 3, 1, kFarDepth);
  EXPECT_EQ(fill_as_benchmark(nothing).data, nothing.data);
}

TEST(DepthErrors, HeldBackReturnsDependOnSeedAndFrame) {
  Sweep sweep(5000);
  for (std::size_t i = 0; i < sweep.size(); ++i) sweep[i].x = static_cast<float>(i);
  const auto held_of = [&](std::uint64_t seed, const char* id) {
    Sweep kept, held;
    withhold(sweep, 0.2, seed, id, kept, held);
    EXPECT_EQ(kept.size() + held.size(), sweep.size());
    std::vector<float> which;
    for (const LidarPoint& point : held) which.push_back(point.x);
    return which;
  };
  const auto held = held_of(1, "000000");
  EXPECT_NEAR(static_cast<double>(held.size()), 1000, 100);
  EXPECT_EQ(held, held_of(1, "000000"));
  EXPECT_NE(held, held_of(2, "000000"));
  EXPECT_NE(held, held_of(1, "000001"));
}

/// A back-end that returns the depth that it was made with.
class Given : public DepthCompletion {
 public:
  explicit Given(ImageF depth) : depth_(std::move(depth)) {}
  std::string name() const override { return "given"; }
  ImageF complete(const ImageF&, const ImageF&) const override { return depth_; }

 private:
  ImageF depth_;
};

/// One car, 15 m ahead, in a small camera; a wall 40 m away fills the picture's left half, the rest is sky.
struct OneCar {
  test::TemporaryFolder folder;
  ImageF truth{320, 120, 1};
  TexturedMesh object;

  OneCar() {
    Frame frame;
    frame.id = "000000";
    frame.calibration.camera = {200, 200, 160, 60, 320, 120};
    frame.calibration.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
    frame.calibration.rect_from_cam0 = Eigen::Matrix3d::Identity();
    frame.image = ImageF(320, 120, 3, 0.3f);
    frame.sweep = {{40, 5, 0, 0.1f}, {15, 0, -1, 0.2f}};
    Label car;
    car.type = "Car";
    car.right = 10;
    car.bottom = 10;
    car.box = {{15, 0, 4, 1.8, 0}, -0.9, 1.5};
    frame.labels = {car};
    for (int v = 0; v < 120; ++v)
      for (int u = 0; u < 160; ++u) truth.at(u, v) = 40;
    write_depth_png(true_depth_file(folder.path(), frame.id), truth);
    write_frame(folder.path(), frame);
    // A box of 1 m on the roof.
    for (int i = 0; i < 8; ++i)
      object.mesh.vertices.emplace_back(i & 1 ? 0.5 : -0.5, i & 2 ? 0.5 : -0.5, i & 4 ? 1 : 0);
    object.mesh.faces = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                         {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
    object.atlas.texels.assign(object.mesh.faces.size() * object.atlas.per_face(), Vec3d(0.5, 0.5, 0.5));
  }
  std::vector<DepthScore> score(std::vector<ImageF> given) const {
    std::vector<std::unique_ptr<DepthCompletion>> backends;
    for (ImageF& depth : given) backends.push_back(std::make_unique<Given>(std::move(depth)));
    DepthScoreOptions options;
    options.data = folder.path();
    return score_depth(options, backends, object, [](std::size_t, std::size_t) {});
  }
};

TEST(DepthScores, TheTruthItselfIsRightAndANearVeilDropsEveryPixel) {
  const OneCar scene;
  ImageF right = scene.truth;
  for (float& depth : right.data)
    if (!(depth > 0)) depth = kFarDepth;
  const ImageF veil(320, 120, 1, 5);
  const auto scores = scene.score({right, veil});
  EXPECT_EQ(scores[0].coverage, 1);
  EXPECT_EQ(scores[0].sky_filled, 0);
  EXPECT_EQ(scores[0].common.rmse, 0);
  EXPECT_NEAR(scores[1].common.rmse, 35000, 1);
  EXPECT_EQ(scores[1].sky_filled, 1);
  EXPECT_GT(scores[0].roof.pixels, 100u);
  EXPECT_GT(scores[0].sky.pixels, 50u);
  EXPECT_LT(scores[0].sky.pixels, scores[0].roof.pixels);
  EXPECT_GT(scores[0].border.pixels, 10u);
  EXPECT_LT(scores[0].border.pixels, scores[0].sky.pixels);
  EXPECT_EQ(scores[0].roof.wrongly_kept + scores[0].roof.wrongly_dropped, 0u);
  EXPECT_EQ(scores[1].roof.wrongly_dropped, scores[1].roof.pixels);
  EXPECT_EQ(scores[1].border.wrongly_dropped, scores[1].border.pixels);
}

TEST(DepthScores, APostBeforeTheObjectThatWasMissedIsWronglyKept) {
  OneCar scene;
  for (int v = 0; v < 120; ++v)
    for (int u = 158; u < 163; ++u) scene.truth.at(u, v) = 6;
  write_depth_png(true_depth_file(scene.folder.path(), "000000"), scene.truth);
  const ImageF far(320, 120, 1, kFarDepth);
  const auto scores = scene.score({far});
  EXPECT_GT(scores[0].roof.wrongly_kept, 20u);
  EXPECT_EQ(scores[0].roof.wrongly_dropped, 0u);
  EXPECT_EQ(scores[0].coverage, 0);
  EXPECT_EQ(scores[0].common.pixels, 0u);
}

TEST(DepthScores, NothingToScoreOnIsNoPerfectScore) {
  OneCar scene;
  write_depth_png(true_depth_file(scene.folder.path(), "000000"), ImageF(320, 120, 1));
  EXPECT_THAT(test::error_text<InputError>([&] { scene.score({scene.truth}); }),
              testing::HasSubstr("no pixel has a depth to score on"));
}

TEST(DepthScores, WithoutTrueDepthTheFixIsNamed) {
  OneCar scene;
  std::filesystem::remove(true_depth_file(scene.folder.path(), "000000"));
  const std::string text = test::error_text<InputError>([&] { scene.score({scene.truth}); });
  EXPECT_THAT(text, testing::HasSubstr("--hide 0.2"));
  EXPECT_THAT(text, testing::HasSubstr("000000.png"));
}

}  // namespace
}  // namespace mirage
