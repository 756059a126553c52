// Extremes of a whole insertion, both sensors with occlusion and VJP: the object's position, and the
// magnitudes of photograph and coordinates.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "attack/objective.h"
#include "base/random.h"
#include "support/insertion_world.h"

namespace mirage {
namespace {

using test::make_world;
using test::World;

/// Simulates, checks that the result and its VJP are finite, and returns the result.
Simulated expect_finite(const World& world) {
  const Simulated s = simulate(world.prepared, world.placement, world.adversary);
  for (float value : s.image.data) {
    if (!(value >= 0 && value <= 1)) ADD_FAILURE() << "image value " << value;
  }
  for (const LidarPoint& p : s.sweep) EXPECT_TRUE(p.position().allFinite() && std::isfinite(p.reflectance));
  EXPECT_TRUE(s.visible_share >= 0 && s.visible_share <= 1) << s.visible_share;
  const ImageF d_image(s.image.width, s.image.height, 3, 1.f);
  const std::vector<std::array<float, 4>> d_points(s.sweep.size(), {1, 1, 1, 1});
  const AdversaryGradient gradient = simulate_vjp(s, d_image, d_points);
  for (const auto* list : {&gradient.vertices, &gradient.texels})
    for (const Vec3d& d : *list)
      if (!d.allFinite()) ADD_FAILURE() << "gradient " << d.transpose();
  return s;
}

/// The world with its host's roof point at `at` (`velo`).
World moved_to(const Vec3d& at) {
  World world = make_world(1);
  world.placement.velo_from_adversary.translation() = at;
  BevBox& box = world.placement.carrier->label.box.bev;
  box.x = at.x();
  box.y = at.y();
  return world;
}

TEST(InsertionExtremes, ObjectFrom30CentimetresTo500Metres) {
  for (double distance : {.3, 1., 2., 5., 20., 60., 150., 500.}) {
    SCOPED_TRACE(distance);
    const Simulated s = expect_finite(moved_to({distance + .7, 0, -.4}));
    EXPECT_GT(s.rect.width() * s.rect.height(), 0);
  }
}

TEST(InsertionExtremes, PartlyBehindTheCameraIsDrawn) {
  const Simulated s = expect_finite(moved_to({.6, -.55, -.5}));  // its far side reaches 1.3 m ahead
  EXPECT_GT(s.adversary_pixels, 20);
}

TEST(InsertionExtremes, CameraInsideTheMesh) {
  const Simulated s = expect_finite(moved_to({.27, 0, -.5}));
  EXPECT_EQ(s.adversary_pixels, s.image.width * s.image.height);
}

TEST(InsertionExtremes, WhollyBehindTheCameraChangesNothing) {
  const World world = moved_to({-8, 0, -.2});
  const Simulated s = expect_finite(world);
  EXPECT_TRUE(s.rect.empty());
  EXPECT_EQ(s.image.data, world.prepared.frame.image.data);
}

TEST(InsertionExtremes, CoordinatesOffsetBy1e5Metres) {
  const Vec3d offset(1e5, -1e5, 0);
  const World here = make_world(1);
  World there = here;
  Frame frame = here.prepared.frame;
  frame.calibration.camera_from_velo = frame.calibration.camera_from_velo * Eigen::Translation3d(-offset);
  LidarModel lidar = here.prepared.lidar;
  lidar.velo_from_lidar = Eigen::Translation3d(offset) * lidar.velo_from_lidar;
  there.placement.velo_from_adversary = Eigen::Translation3d(offset) * there.placement.velo_from_adversary;
  Label& host = there.placement.carrier->label;
  host.box.bev.x += offset.x();
  host.box.bev.y += offset.y();
  frame.labels = {host};
  there.prepared = prepare(frame, lidar);
  const Simulated a = expect_finite(here), b = expect_finite(there);
  ASSERT_EQ(a.rect.width(), b.rect.width());
  double worst = 0;
  for (std::size_t i = 0; i < a.image.data.size(); ++i)
    worst = std::max(worst, static_cast<double>(std::abs(a.image.data[i] - b.image.data[i])));
  EXPECT_LE(worst, 1e-4);
  // The sweep's coordinates are floats: 8 mm apart there.
  EXPECT_NEAR(b.adversary_points, a.adversary_points, 0.05 * a.adversary_points);
  std::printf("offset of 1e5 m: image moves by %.1e, returns %d and %d\n", worst, a.adversary_points,
              b.adversary_points);
}

World with_camera(const PinholeCamera& camera) {
  World world = make_world(1);
  Frame frame = world.prepared.frame;
  frame.calibration.camera = camera;
  frame.image = ImageF(camera.width, camera.height, 3, 0.4f);
  world.prepared = prepare(frame, world.prepared.lidar);
  return world;
}

TEST(InsertionExtremes, PhotographOfOnePixel) {
  const Simulated s = expect_finite(with_camera({.5, .5, 0, 0, 1, 1}));
  EXPECT_EQ(s.image.data.size(), 3u);
}

TEST(InsertionExtremes, PhotographOf8192By4096) {
  const Simulated s = expect_finite(with_camera({4800, 4800, 4090, 2040, 8192, 4096}));
  EXPECT_LT(s.rect.width(), 1000);
  EXPECT_GT(s.adversary_pixels, 50000);
}

TEST(InsertionExtremes, AnEmptySweep) {
  World world = make_world(1);
  world.prepared = prepare(world.prepared.frame, world.prepared.lidar);  // the frame without returns
  EXPECT_GT(expect_finite(world).adversary_points, 0);
}

TEST(InsertionExtremes, DegenerateAdversaries) {
  for (int kind = 0; kind < 5; ++kind) {
    SCOPED_TRACE(kind);
    World world = make_world(1);
    auto& mesh = world.adversary.mesh;
    for (Vec3d& v : mesh.vertices) {
      if (kind == 0) v.setZero();                                    // a point
      if (kind == 1) v = Vec3d(v.x(), 0, 0);                         // a line
      if (kind == 2) v.z() = 0;                                      // flat, both sides in one plane
      if (kind == 3) v = Vec3d(v.x() * 1e-6, v.y(), v.z());          // 1e6 : 1
      if (kind == 4) v = Vec3d(-v.x(), v.y(), std::abs(v.z()) / 2);  // inside out and folded
    }
    expect_finite(world);
  }
}

TEST(InsertionExtremes, TexelsZeroOrOne) {
  for (double value : {0., 1.}) {
    World world = make_world(1);
    for (Vec3d& texel : world.adversary.atlas.texels) texel.setConstant(value);
    expect_finite(world);
  }
}

}  // namespace

// Extremes of the attack's objective: logits, overlaps, and the number of proposals.

namespace {

const BevBox kHost{10, 0, 4, 2, 0.3};

TEST(ObjectiveExtremes, LogitsOfPlusMinus1e4) {
  const BevBox elsewhere{40, 8, 4, 2, 0};
  for (double logit : {1e4, 1e300, -1e4, -1e300, 0.}) {
    const std::vector<Detection> proposals{{kHost, logit}, {elsewhere, logit}};
    const ObjectiveValue value = objective(proposals, {kHost, {kHost}}, {});
    EXPECT_TRUE(std::isfinite(value.hide));
    EXPECT_TRUE(std::isfinite(value.false_positive));
    const double score = logit > 0 ? 1 : logit < 0 ? 0 : 0.5;
    EXPECT_NEAR(value.hide, logit > 0 ? logit : logit < 0 ? 0 : std::log(2.), 1e-12 * (1 + std::abs(logit)));
    EXPECT_NEAR(value.d_logits[0], score, 1e-12);
    EXPECT_NEAR(value.d_logits[1], -ObjectiveSettings().lambda_fp * score, 1e-12);
    EXPECT_EQ(proposals[0].score(), score);
  }
  // The derivative of softplus on both sides of where exp overflows and underflows.
  for (double x : {-745., -40., -1., 0., 1., 40., 745.}) {
    const double h = 1e-4, numeric = (softplus(x + h) - softplus(x - h)) / (2 * h);
    EXPECT_NEAR(numeric, Detection({kHost, x}).score(), 1e-7) << x;
  }
}

TEST(ObjectiveExtremes, IouExactlyZeroAndOne) {
  EXPECT_NEAR(iou(kHost, kHost), 1, 1e-15);
  EXPECT_EQ(iou(kHost, {200, 0, 4, 2, 0.3}), 0);
  const BevBox square{0, 0, 2, 2, 0};
  EXPECT_EQ(iou(square, {2, 0, 2, 2, 0}), 0);  // edge to edge
  EXPECT_EQ(iou(square, {2, 2, 2, 2, 0}), 0);  // corner to corner
  EXPECT_EQ(iou(square, {0, 0, 0, 2, 0}), 0);  // no area
  double worst = 0;
  RandomStream random(1, "iou one");
  for (int i = 0; i < 20000; ++i) {
    const double scale = std::pow(10, random.uniform(-6, 4)), far = std::pow(10, random.uniform(-3, 5));
    const BevBox box{random.uniform(-far, far), random.uniform(-far, far), scale * random.uniform(.1, 5),
                     scale * random.uniform(.1, 5), random.uniform(-7, 7)};
    const double same = iou(box, box);
    worst = std::max(worst, std::abs(same - 1));
    ASSERT_LE(same, 1);
    if (std::max(box.length, box.width) > 1000 || std::hypot(box.x, box.y) > 1e5)
      continue;  // not a box that a detector would return
    ASSERT_GT(objective(std::vector<Detection>{{box, 2}}, {box, {box}}, {}).hide, 0);
  }
  EXPECT_LE(worst, 1e-12);
  std::printf("IoU of a box with itself: 1 to %.1e\n", worst);
}

TEST(ObjectiveExtremes, NoProposalAtAll) {
  const ObjectiveValue value = objective({}, {kHost, {kHost}}, {});
  EXPECT_EQ(value.hide, 0);
  EXPECT_EQ(value.false_positive, 0);
  EXPECT_TRUE(value.d_logits.empty());
  EXPECT_TRUE(suppress({}).empty());
}

TEST(ObjectiveExtremes, TenThousandProposals) {
  RandomStream random(2, "ten thousand proposals");
  std::vector<Detection> proposals;
  for (int i = 0; i < 10000; ++i)
    proposals.push_back({{random.uniform(0, 70), random.uniform(-40, 40), random.uniform(3, 5),
                          random.uniform(1, 2), random.uniform(-3, 3)},
                         random.uniform(-20, 20)});
  std::vector<ObjectBoxes> truth{kHost};
  for (int i = 0; i < 40; ++i)
    truth.push_back(BevBox{random.uniform(0, 70), random.uniform(-40, 40), 4, 2, 0});
  ObjectiveSettings by_score;
  by_score.fp_top_k = 0;  // the loss per score does not depend on the others
  const ObjectiveValue value = objective(proposals, {kHost, truth}, by_score);
  EXPECT_TRUE(std::isfinite(value.hide + value.false_positive));
  EXPECT_GT(value.hide, 0);
  EXPECT_LT(value.false_positive, 0);
  // Processing them one after the other gives the same.
  double hide = 0;
  for (std::size_t i = 0; i < proposals.size(); ++i) {
    const auto one = objective({&proposals[i], 1}, {kHost, truth}, by_score);
    hide += one.hide;
    EXPECT_EQ(one.d_logits[0], value.d_logits[i]);
  }
  EXPECT_NEAR(hide, value.hide, 1e-9 * value.hide);
  const auto kept = suppress(proposals, 0.1);
  EXPECT_GT(kept.size(), 100u);
  for (std::size_t i = 0; i + 1 < kept.size(); ++i) EXPECT_GE(kept[i].logit, kept[i + 1].logit);
  // All proposals at one place: the best remains.
  for (Detection& proposal : proposals) proposal.box.bev = kHost;
  EXPECT_EQ(suppress(proposals).size(), 1u);
}

}  // namespace
}  // namespace mirage
