#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/parallel.h"
#include "generator/car_body.h"
#include "generator/dataset.h"
#include "generator/fit.h"
#include "generator/generator.h"
#include "generator/looks/american_parts.h"
#include "generator/parts.h"
#include "generator/street.h"
#include "geometry/box.h"
#include "geometry/mesh.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/depth_completion.h"
#include "sensors/lidar_sweep.h"
#include "support/files.h"
#include "support/small_rig.h"

namespace mirage {
namespace {

using test::small_rig;

bool same(const Frame& a, const Frame& b) {
  if (a.image.data != b.image.data || a.sweep.size() != b.sweep.size() || a.labels.size() != b.labels.size())
    return false;
  for (std::size_t i = 0; i < a.sweep.size(); ++i)
    if (a.sweep[i].position() != b.sweep[i].position() || a.sweep[i].reflectance != b.sweep[i].reflectance)
      return false;
  for (std::size_t i = 0; i < a.labels.size(); ++i)
    if (a.labels[i].type != b.labels[i].type || a.labels[i].left != b.labels[i].left ||
        a.labels[i].box.bev.x != b.labels[i].box.bev.x)
      return false;
  return true;
}

TEST(Generator, DependsOnSeedAndIndexOnly) {
  const Rig rig = small_rig();
  set_thread_count(1);
  const Frame one = generate_frame(rig, 7, 3);
  set_thread_count(0);
  EXPECT_TRUE(same(one, generate_frame(rig, 7, 3)));
  EXPECT_FALSE(same(one, generate_frame(rig, 7, 4)));
  EXPECT_FALSE(same(one, generate_frame(rig, 8, 3)));
}

PictureBox labelled_box(const Label& label) {
  return {label.left, label.top, label.right, label.bottom};
}

/// The rectangle around a label's 3-D box in the picture.
PictureBox around_box(const Label& label, const Calibration& calibration) {
  PictureBox around{1e9, 1e9, -1e9, -1e9};
  for (const Vec3d& corner : corners(label.box)) {
    const Vec2d pixel = calibration.camera.project<double>(calibration.camera_from_velo * corner);
    around = united(around, {pixel.x(), pixel.y(), pixel.x(), pixel.y()});
  }
  return around;
}

// The convention of generated labels: boxes around the bodies' outlines would overlap KITTI's by 0.93.
TEST(Generator, RealBoxesInThePictureAreThoseAroundTheBoxesInSpace) {
  MIRAGE_NEED_REAL_FRAMES();
  const std::filesystem::path kitti = test::real_frames();
  std::vector<double> overlaps;
  for (const std::string& id : list_frames(kitti)) {
    const Frame frame = read_frame(kitti, id);
    for (const Label& label : frame.labels)
      if (label.type == "Car" && label.truncated == 0 && label.occluded == 0 &&
          label.bottom - label.top >= 25)
        overlaps.push_back(iou(labelled_box(label), around_box(label, frame.calibration)));
  }
  ASSERT_GT(overlaps.size(), 20u);
  const auto middle = overlaps.begin() + std::ssize(overlaps) / 2;
  std::nth_element(overlaps.begin(), middle, overlaps.end());
  EXPECT_GT(*middle, 0.97);
}

TEST(Generator, LabelsFitImageAndPoints) {
  const Rig rig = small_rig();
  int cars = 0;
  for (std::size_t index = 0; index < 6; ++index) {
    FrameTruth truth;
    const Frame frame = generate_frame(rig, 1, index, &truth);
    EXPECT_GT(frame.sweep.size(), 3000u);
    for (const LidarPoint& p : frame.sweep) {
      ASSERT_TRUE(p.position().allFinite());
      ASSERT_GE(p.reflectance, 0);
      ASSERT_LE(p.reflectance, 1);
    }
    for (float value : frame.image.data) ASSERT_TRUE(std::isfinite(value) && value >= 0);
    for (const Label& label : frame.labels) {
      EXPECT_GE(label.left, 0);
      EXPECT_GE(label.top, 0);
      EXPECT_LE(label.right, frame.image.width - 1);
      EXPECT_LE(label.bottom, frame.image.height - 1);
      EXPECT_LT(label.left, label.right);
      EXPECT_LT(label.top, label.bottom);
      EXPECT_GE(label.truncated, 0);
      EXPECT_LE(label.truncated, 1);
      EXPECT_TRUE(label.occluded >= 0 && label.occluded <= 3);
      const auto line = static_cast<std::uint32_t>(&label - frame.labels.data()) + 1;
      const bool returned = std::any_of(truth.returns.begin(), truth.returns.end(),
                                        [&](std::uint32_t word) { return word >> 16 == line; });
      EXPECT_TRUE(returned || label.bottom - label.top >= 23) << label.type;
      if (label.type != "Car") continue;
      ++cars;
      if (label.truncated > 0) continue;
      EXPECT_GT(iou(labelled_box(label), around_box(label, frame.calibration)), 0.9999);
    }
  }
  EXPECT_GT(cars, 12);
}

TEST(Generator, DatasetGoesOnWhereItStopped) {
  const std::filesystem::path out = std::filesystem::path(testing::TempDir()) / "mirage_generated";
  std::filesystem::remove_all(out);
  const auto silent = [](std::size_t) {};
  DatasetSummary sum = generate_dataset(small_rig(), 3, 0, 2, out, silent);
  EXPECT_EQ(sum.written, 2);
  EXPECT_GT(sum.points, 6000u);
  std::filesystem::remove(out / "training/label_2/000001.txt");
  sum = generate_dataset(small_rig(), 3, 0, 3, out, silent);
  EXPECT_EQ(sum.written, 2);
  EXPECT_EQ(sum.existing, 1);
  EXPECT_EQ(list_frames(out).size(), 3u);
  const Frame frame = read_frame(out, "000002"), made = generate_frame(small_rig(), 3, 2);
  EXPECT_EQ(frame.sweep.size(), made.sweep.size());
  EXPECT_EQ(frame.labels.size(), made.labels.size());
  EXPECT_NEAR((frame.lighting.sun - made.lighting.sun).norm(), 0, 1e-6);
  EXPECT_THROW(generate_dataset(small_rig(), 4, 0, 1, out, silent), InputError);
  for (const std::string& text : {std::string("[]"), std::string("3"), std::string(600000, ' ') + "{}"}) {
    write_file(out / "dataset.json", text);
    EXPECT_THROW(generate_dataset(small_rig(), 3, 0, 1, out, silent), InputError) << text.substr(0, 9);
  }
  std::filesystem::remove_all(out);
}

TEST(Generator, TrueDepthChangesNothingElseAndMeetsTheSweep) {
  const Rig rig = small_rig();
  FrameTruth truth;
  const Frame with = generate_frame(rig, 7, 3, &truth);
  const ImageF& depth = truth.depth;
  EXPECT_TRUE(same(with, generate_frame(rig, 7, 3)));
  const ImageF sparse = sparse_depth(with.sweep, with.calibration);
  ASSERT_EQ(depth.data.size(), sparse.data.size());
  std::size_t returns = 0, close = 0;
  for (std::size_t i = 0; i < depth.data.size(); ++i) {
    if (!(sparse.data[i] > 0)) continue;
    ++returns;
    close += std::abs(depth.data[i] - sparse.data[i]) < 0.05f * sparse.data[i] + 0.1f;
  }
  ASSERT_GT(returns, 2000u);
  EXPECT_GT(static_cast<double>(close), 0.8 * static_cast<double>(returns));  // the rest sees past edges
  EXPECT_GT(std::count(depth.data.begin(), depth.data.end(), 0.f), 500);      // sky
}

TEST(Generator, ADatasetCanBeGivenItsTrueDepthLater) {
  const std::filesystem::path out = std::filesystem::path(testing::TempDir()) / "mirage_generated_depth";
  std::filesystem::remove_all(out);
  const auto silent = [](std::size_t) {};
  generate_dataset(small_rig(), 3, 0, 1, out, silent);
  const std::string picture = read_file(out / "training/image_2/000000.png");
  EXPECT_FALSE(std::filesystem::exists(true_depth_file(out, "000000")));
  EXPECT_EQ(generate_dataset(small_rig(), 3, 0, 1, out, silent, Truth::depth).written, 1);
  EXPECT_EQ(generate_dataset(small_rig(), 3, 0, 1, out, silent, Truth::depth).existing, 1);
  EXPECT_EQ(read_file(out / "training/image_2/000000.png"), picture);
  FrameTruth truth;
  generate_frame(small_rig(), 3, 0, &truth);
  const ImageF& depth = truth.depth;
  const ImageF stored = read_depth_png(true_depth_file(out, "000000"));
  for (std::size_t i = 0; i < depth.data.size(); ++i)
    ASSERT_NEAR(stored.data[i], std::min(depth.data[i], 65535.f / 256), 1.f / 511);
  std::filesystem::remove_all(out);
}

TEST(Generator, RigFilesAreReadStrictly) {
  const std::filesystem::path shipped = std::filesystem::path(MIRAGE_SOURCE) / "scenes/rigs/kitti64.toml";
  const Rig rig = read_rig(shipped);
  EXPECT_EQ(rig.name, "kitti64");
  EXPECT_EQ(rig.calibration.camera.width, 1242);
  EXPECT_EQ(rig.lidar.beams.size(), 64u);
  EXPECT_NEAR(rig.calibration.camera_from_velo.linear().determinant(), 1, 1e-4);
  const std::filesystem::path bad = std::filesystem::path(testing::TempDir()) / "bad_rig.toml";
  std::string text = read_file(shipped);
  write_file(bad, text.substr(0, text.find("fx =")) + "zoom = 3\n" + text.substr(text.find("fx =")));
  EXPECT_THROW(read_rig(bad), InputError);
  const auto at = text.find("-0.999944177");
  write_file(bad, text.replace(at, 12, "-0.899944177"));
  EXPECT_THROW(read_rig(bad), InputError);
  std::filesystem::remove(bad);
}

// Returns on a car must neither stick out of its box nor leave a side of it without returns.
TEST(Generator, CarsFillTheirBoxes) {
  RandomStream random(5, "test cars");
  Vec3d mean = Vec3d::Zero();
  constexpr int count = 60;
  int loaded = 0;
  for (int i = 0; i < count; ++i) {
    const generator::Actor car = generator::make_car(random);
    EXPECT_TRUE(car.size.x() > 3.0 && car.size.x() < 5.6) << car.size.transpose();
    EXPECT_TRUE(car.size.y() > 1.4 && car.size.y() < 2.0) << car.size.transpose();
    EXPECT_TRUE(car.size.z() > 1.2 && car.size.z() < 2.0) << car.size.transpose();
    mean += car.size / count;
    Eigen::AlignedBox3d box;  // all surfaces but the mirrors, which come last
    for (std::size_t s = 0; s + 1 < car.surfaces.size(); ++s) box.extend(bounds(car.surfaces[s].mesh));
    if (box.max().z() > car.size.z() + 1e-6) {  // a roof load, which is not part of the box
      ++loaded;
      continue;
    }
    EXPECT_LT((box.sizes() - car.size).cwiseAbs().maxCoeff(), 1e-9);
    EXPECT_NEAR(box.center().x(), 0, 1e-9);
    EXPECT_NEAR(box.center().y(), 0, 1e-9);
    EXPECT_NEAR(box.min().z(), 0, 1e-9);
  }
  EXPECT_LT(loaded, count / 5);
  // KITTI's mean car: 3.88 × 1.63 × 1.53 m.
  EXPECT_NEAR(mean.x(), 3.9, 0.2);
  EXPECT_NEAR(mean.y(), 1.63, 0.07);
  EXPECT_NEAR(mean.z(), 1.53, 0.06);
}

TEST(Generator, HullsAreClosedAndWoundOutwards) {
  for (double roof_rear : {0.70, 0.86, 0.92}) {
    generator::BodyShape shape;
    shape.roof_rear_u = roof_rear;
    if (roof_rear < 0.8) shape.window_foot_u = 0.84;
    const generator::Hull hull = generator::loft(shape);
    EXPECT_TRUE(is_watertight(hull.all));
    EXPECT_GT(signed_volume(hull.all), 0.4 * shape.length * shape.width * shape.height);
    EXPECT_LT(signed_volume(hull.all), 0.9 * shape.length * shape.width * shape.height);
    EXPECT_EQ(hull.paint.faces.size() + hull.glass.faces.size() + hull.trim.faces.size(),
              hull.all.faces.size());
    EXPECT_GT(hull.glass.faces.size(), 50u);
  }
}

}  // namespace

// Look-alikes and roof loads, in the camera and in the LiDAR.

namespace {

using generator::Actor;

/// The sweep of one thing 12 m ahead on open ground.
Sweep seen_by_lidar(Actor actor, std::vector<int>* objects) {
  std::vector<Surface> surfaces;
  Mesh ground;
  generator::add_quad(ground, {-80, -80, -1.73}, {80, -80, -1.73}, {80, 80, -1.73}, {-80, 80, -1.73});
  surfaces.push_back(generator::surface(ground, generator::plain(Vec3f::Constant(0.1f), 0.3f)));
  for (Surface& s : actor.surfaces) {
    for (Vec3d& v : s.mesh.vertices) v = generator::at(12, 2, -1.73, 0.4) * v;
    s.object = 0;
    surfaces.push_back(std::move(s));
  }
  return simulate_sweep(RayScene(surfaces), test::small_rig().lidar, 5, generated_sweep_effects(), objects);
}

// The same mesh with the same panes and reflectivities: the LiDAR gets the same returns, except on the
// pattern of a car's grille. The camera sees no part of a car: no pane, no gloss, no light.
TEST(LookAlikes, DifferFromCarsInPixelsOnly) {
  int covered = 0;
  for (std::uint64_t i = 0; i < 12; ++i) {
    RandomStream random(3, "look-alike", i);
    const Actor car = i % 2 ? generator::american::make_car(random) : generator::make_car(random);
    const Actor alike = generator::make_look_alike(car, random);
    EXPECT_EQ(alike.type, "Misc");
    EXPECT_EQ(alike.kind, "look-alike");
    for (const Surface& s : alike.surfaces) {
      if (!s.material.veiled) continue;  // a boat's trailer
      EXPECT_EQ(seen_through(s.material), 0);
      EXPECT_EQ(surface_gloss(s.material, {1, 2, 3}, Vec3f::UnitX()), 0);
      EXPECT_EQ(s.material.emission, Vec3f::Zero());
    }
    if (alike.surfaces.size() <= car.surfaces.size()) continue;  // a bin, a shed, a boat
    ++covered;
    EXPECT_EQ(alike.size, car.size);
    std::vector<int> of_car, of_alike;
    const Sweep a = seen_by_lidar(car, &of_car), b = seen_by_lidar(alike, &of_alike);
    const auto hits = [](const std::vector<int>& objects) {
      return static_cast<double>(std::count(objects.begin(), objects.end(), 0));
    };
    ASSERT_GT(hits(of_car), 60);
    EXPECT_NEAR(hits(of_alike), hits(of_car), 0.02 * hits(of_car) + 2);
    ASSERT_NEAR(static_cast<double>(a.size()), static_cast<double>(b.size()), 6);
    std::size_t same = 0, j = 0;
    for (const LidarPoint& p : a) {  // both in firing order
      std::size_t k = j;
      while (k < std::min(b.size(), j + 8) && b[k].position() != p.position()) ++k;
      if (k == std::min(b.size(), j + 8)) continue;
      same += b[k].reflectance == p.reflectance;
      j = k + 1;
    }
    EXPECT_GT(static_cast<double>(same), 0.995 * static_cast<double>(a.size())) << i;
  }
  EXPECT_GE(covered, 6);
}

// They stand where cars stand, at any distance, and have their own labels.
TEST(LookAlikes, AreInEveryStreet) {
  for (Look look : {Look::european, Look::american}) {
    int cars = 0, alikes = 0, far_cars = 0, far_alikes = 0;
    for (std::uint64_t index = 0; index < 20; ++index) {
      int here = 0;
      for (const auto& placed : generator::make_street(4, index, 1.73, look).placed) {
        const bool far_away = placed.box.bev.x > 35;
        if (placed.type == "Car") ++cars, far_cars += far_away;
        if (placed.kind == "look-alike") ++alikes, ++here, far_alikes += far_away;
      }
      EXPECT_GE(here, 1) << name_of(look) << ' ' << index;
    }
    EXPECT_GT(alikes, 0.55 * cars) << name_of(look);
    EXPECT_LT(alikes, 1.1 * cars) << name_of(look);
    EXPECT_GT(far_alikes, 0.5 * far_cars) << name_of(look);
  }
  Rig rig = test::small_rig();
  FrameTruth truth;
  const Frame frame = generate_frame(rig, 4, 0, &truth);
  int labelled = 0;
  for (std::size_t k = 0; k < frame.labels.size(); ++k) {
    if (frame.labels[k].type != "Misc") continue;
    ++labelled;
    const auto of_it = [&](std::uint32_t word) { return word >> 16 == k + 1; };
    EXPECT_TRUE(std::any_of(truth.returns.begin(), truth.returns.end(), of_it) ||
                std::count(truth.instance.data.begin(), truth.instance.data.end(), k + 1) > 0);
  }
  EXPECT_GE(labelled, 1);
}

// One car in ten carries a load. Box and true shape remain those of the car alone.
TEST(RoofLoads, BelongToTheCarButNotToItsBox) {
  int loaded = 0;
  constexpr int count = 300;
  for (std::uint64_t i = 0; i < count; ++i) {
    RandomStream random(9, "roof load", i);
    const Actor car = i % 2 ? generator::american::make_car(random) : generator::make_car(random);
    const generator::Placed placed{"Car", {{0, 0, car.size.x(), car.size.y(), 0}, 0, car.size.z()}, car.kind};
    std::size_t on = 0;
    for (const Surface& s : car.surfaces) {
      if (!generator::on_roof(s, placed)) continue;
      ++on;
      const Eigen::AlignedBox3d box = bounds(s.mesh);
      EXPECT_GT(box.min().z(), 0.6 * car.size.z());  // nothing hangs below the roof
      EXPECT_LT(box.max().z(), car.size.z() + 0.6);
      EXPECT_LT(std::max(box.max().y(), -box.min().y()), 0.5 * car.size.y());
    }
    loaded += on > 0;
    EXPECT_FALSE(generator::on_roof(car.surfaces.front(), placed));
  }
  EXPECT_GT(loaded, 0.06 * count);
  EXPECT_LT(loaded, 0.15 * count);
  // A street's true shapes end at their boxes' tops.
  for (std::uint64_t index = 0; index < 6; ++index)
    for (const auto& vehicle : generator::true_vehicles({.seed = 4}, index, 1.73))
      EXPECT_LT(bounds(vehicle.mesh).max().z(), vehicle.box.bottom + vehicle.box.height + 0.02);
}

}  // namespace
}  // namespace mirage
