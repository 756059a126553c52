// Looks, the second rig, and the ground truth of generated frames.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/parallel.h"
#include "base/sizes.h"
#include "generator/dataset.h"
#include "generator/fit.h"
#include "generator/generator.h"
#include "generator/looks/american_parts.h"
#include "generator/street.h"
#include "support/files.h"
#include "support/small_rig.h"

namespace mirage {
namespace {

using test::small_rig;
using testing::HasSubstr;

Rig rig_with(Look look) {
  Rig rig = small_rig();
  rig.look = look;
  return rig;
}

std::filesystem::path shipped_rig(const std::string& name) {
  return std::filesystem::path(MIRAGE_SOURCE) / "scenes/rigs" / (name + ".toml");
}

// Every point of the picture lies in the sweep's field, however near, and beams are not evenly spaced.
TEST(XenithRig, DiffersFromKittiAndItsSweepCoversThePicture) {
  const Rig rig = read_rig(shipped_rig("xenith")), kitti = read_rig(shipped_rig("kitti64"));
  EXPECT_EQ(rig.look, Look::american);
  EXPECT_EQ(kitti.look, Look::european);
  const PinholeCamera& camera = rig.calibration.camera;
  EXPECT_EQ(camera.width, 2048);
  EXPECT_EQ(camera.height, 320);
  EXPECT_NE(rig.lidar.height, kitti.lidar.height);
  EXPECT_NE(rig.lidar.rate, kitti.lidar.rate);
  EXPECT_NE(rig.lidar.azimuth_step, kitti.lidar.azimuth_step);
  EXPECT_NE(rig.lidar.beams.size(), kitti.lidar.beams.size());
  double widest = 0, narrowest = 1, offset = 0;
  for (std::size_t i = 0; i < rig.lidar.beams.size(); ++i) {
    offset = std::max(offset, std::abs(rig.lidar.beams[i].azimuth_offset));
    if (i == 0) continue;
    const double gap = rig.lidar.beams[i - 1].elevation - rig.lidar.beams[i].elevation;
    widest = std::max(widest, gap), narrowest = std::min(narrowest, gap);
  }
  EXPECT_GT(widest, 5 * narrowest);
  const Transform velo_from_camera = rig.calibration.camera_from_velo.inverse();
  for (double u : {0.0, camera.width - 1.0})
    for (double z : {3.0, 10.0, 80.0}) {
      const Vec3d p = velo_from_camera * camera.unproject(u, 0.5 * camera.height, z);
      const double azimuth = std::atan2(p.y(), p.x());
      EXPECT_LT(azimuth, rig.lidar.azimuth_max - offset);
      EXPECT_GT(azimuth, rig.lidar.azimuth_min + offset);
    }
}

TEST(Looks, AreDeterministicBySeedAndDiffer) {
  const auto street = [](std::uint64_t seed, Look look) {
    return generator::make_street(seed, 5, 1.73, look);
  };
  const auto same = [](const generator::Street& a, const generator::Street& b) {
    if (a.surfaces.size() != b.surfaces.size() || a.placed.size() != b.placed.size()) return false;
    for (std::size_t i = 0; i < a.surfaces.size(); ++i)
      if (a.surfaces[i].mesh.vertices != b.surfaces[i].mesh.vertices ||
          a.surfaces[i].material.albedo != b.surfaces[i].material.albedo)
        return false;
    return true;
  };
  for (Look look : {Look::european, Look::american}) {
    EXPECT_TRUE(same(street(3, look), street(3, look))) << name_of(look);
    EXPECT_FALSE(same(street(3, look), street(4, look))) << name_of(look);
  }
  EXPECT_FALSE(same(street(3, Look::european), street(3, Look::american)));
  // A frame of the second look does not depend on the thread count either.
  const Rig rig = rig_with(Look::american);
  set_thread_count(1);
  const Frame one = generate_frame(rig, 2, 1);
  set_thread_count(0);
  const Frame many = generate_frame(rig, 2, 1);
  EXPECT_EQ(one.image.data, many.image.data);
  EXPECT_EQ(one.sweep.size(), many.sweep.size());
}

TEST(Looks, AnUnknownOneIsAClearError) {
  EXPECT_THAT(test::error_text<InputError>([] { parse_look("lunar", "generate", "--look"); }),
              testing::AllOf(HasSubstr("--look"), HasSubstr("lunar"), HasSubstr("use european or american")));
  const test::TemporaryFolder folder;
  std::string text = read_file(shipped_rig("kitti64"));
  write_file(folder / "rig.toml", text.replace(text.find("\"european\""), 10, "\"lunar\""));
  EXPECT_THAT(test::error_text<InputError>([&] { read_rig(folder / "rig.toml"); }),
              testing::AllOf(HasSubstr("rig.toml"), HasSubstr("lunar")));
  const Rig rig = with_look(read_rig(shipped_rig("kitti64")), Look::american);
  write_file(folder / "rig.toml", rig.text);
  EXPECT_EQ(read_rig(folder / "rig.toml").look, Look::american);
}

// Manufacturers' lengths in North America: longer than in Europe, with pick-ups.
TEST(Looks, AmericanCarsAreLarger) {
  RandomStream random(1, "american cars");
  double length = 0, longest = 0;
  constexpr int count = 40;
  for (int i = 0; i < count; ++i) {
    const generator::Actor car = generator::american::make_car(random);
    length += car.size.x() / count, longest = std::max(longest, car.size.x());
    EXPECT_TRUE(car.size.y() > 1.45 && car.size.y() < 2.1) << car.size.transpose();
  }
  EXPECT_GT(length, 4.4);
  EXPECT_GT(longest, 5.2);
  const generator::Actor bus = generator::american::make_school_bus(random);
  EXPECT_EQ(bus.type, "Misc");
  EXPECT_GT(bus.size.x(), 9);
}

constexpr double kRoof = 0.6;  // m that a load stands out of a car's box, upwards and at the ends

/// The box with the space above and beside its roof that a load may take.
Box3 with_roof(Box3 box, const Vec3d& p) {
  if (p.z() < box.bottom + box.height - 0.05) return box;
  box.height += kRoof;
  box.bev.length += 2 * kRoof;
  return box;
}

class FrameTruthTest : public testing::TestWithParam<Look> {};

// Pixels, at their true depth, and returns that are marked as thing k lie on thing k, except for range noise.
// Mirrors stand out of the label box by 0.15 m.
TEST_P(FrameTruthTest, PixelsAndReturnsLieInTheirBoxes) {
  const Rig rig = rig_with(GetParam());
  const Transform velo_from_camera = rig.calibration.camera_from_velo.inverse();
  std::size_t pixels = 0, returns = 0, cars = 0;
  for (std::size_t index = 0; index < 4; ++index) {
    FrameTruth truth;
    const Frame frame = generate_frame(rig, 11, index, &truth);
    ASSERT_EQ(truth.instance.data.size(), truth.depth.data.size());
    ASSERT_EQ(truth.returns.size(), frame.sweep.size());
    std::vector<int> shown(frame.labels.size(), 0);
    for (int v = 0; v < truth.instance.height; ++v)
      for (int u = 0; u < truth.instance.width; ++u) {
        const int k = truth.instance.at(u, v) - 1;
        if (k < 0) continue;
        ASSERT_LT(k, static_cast<int>(frame.labels.size()));
        const Label& label = frame.labels[as_size(k)];
        ++shown[as_size(k)], ++pixels;
        const double z = truth.depth.at(u, v);
        // Roof loads stand out of both boxes.
        const double roof = kRoof * rig.calibration.camera.fx / z;
        EXPECT_TRUE(u >= label.left - 1 - roof && u <= label.right + 1 + roof && v >= label.top - 1 - roof &&
                    v <= label.bottom + 1);
        // A ray somewhere in the pixel: within half a pixel, or more on surfaces at grazing angles.
        const Vec3d p = velo_from_camera * rig.calibration.camera.unproject(u, v, z);
        EXPECT_TRUE(contains(with_roof(label.box, p), p, 0.2 + 1.5 * z / rig.calibration.camera.fx))
            << label.type << " of frame " << index << " at " << u << ", " << v;
      }
    for (std::size_t k = 0; k < shown.size(); ++k) EXPECT_EQ(shown[k] > 0, frame.labels[k].occluded < 3) << k;
    for (std::size_t i = 0; i < frame.sweep.size(); ++i) {
      const std::uint32_t k = truth.returns[i] >> 16, type = truth.returns[i] & 0xffff;
      if (k == 0) continue;
      ASSERT_LE(k, frame.labels.size());
      const Label& label = frame.labels[k - 1];
      ++returns;
      EXPECT_EQ(type, semantic_class(label.type));
      const Vec3d p = frame.sweep[i].position().cast<double>();
      EXPECT_TRUE(contains(with_roof(label.box, p), p, 0.25)) << label.type;
    }
    for (const Label& label : frame.labels) cars += label.type == "Car";
  }
  EXPECT_GT(cars, 8u);
  EXPECT_GT(pixels, 2000u);
  EXPECT_GT(returns, 1000u);
}

INSTANTIATE_TEST_SUITE_P(BothLooks, FrameTruthTest, testing::Values(Look::european, Look::american),
                         [](const auto& look) { return name_of(look.param); });

TEST(GeneratedTruth, CanBeAddedLaterAndIsResumed) {
  const test::TemporaryFolder folder;
  const Rig rig = rig_with(Look::american);
  const auto silent = [](std::size_t) {};
  const auto out = folder.path() / "set";
  EXPECT_EQ(generate_dataset(rig, 3, 0, 2, out, silent).written, 2);
  const std::string picture = read_file(out / "training/image_2/000001.png"),
                    sweep = read_file(out / "training/velodyne/000001.bin");
  EXPECT_FALSE(std::filesystem::exists(instance_file(out, "000001")));
  EXPECT_EQ(generate_dataset(rig, 3, 0, 2, out, silent, Truth::all).written, 2);
  EXPECT_EQ(generate_dataset(rig, 3, 0, 2, out, silent, Truth::all).existing, 2);
  std::filesystem::remove(instance_file(out, "000000"));
  std::filesystem::remove(point_label_file(out, "000001"));
  EXPECT_EQ(generate_dataset(rig, 3, 0, 2, out, silent, Truth::depth).existing, 2);
  EXPECT_EQ(generate_dataset(rig, 3, 0, 2, out, silent, Truth::all).written, 2);
  EXPECT_EQ(read_file(out / "training/image_2/000001.png"), picture);
  EXPECT_EQ(read_file(out / "training/velodyne/000001.bin"), sweep);

  FrameTruth truth;
  const Frame frame = generate_frame(rig, 3, 1, &truth);
  EXPECT_EQ(read_index_png(instance_file(out, "000001")).data, truth.instance.data);
  EXPECT_EQ(read_point_labels(point_label_file(out, "000001"), frame.sweep.size()), truth.returns);
  EXPECT_THAT(test::error_text<InputError>(
                  [&] { read_point_labels(point_label_file(out, "000001"), frame.sweep.size() + 1); }),
              testing::AllOf(HasSubstr("000001.label"), HasSubstr("mirage generate --truth")));
  // The look belongs to the set: another one is refused, and source_of() says which it was.
  EXPECT_THAT(
      test::error_text<InputError>([&] { generate_dataset(rig_with(Look::european), 3, 0, 1, out, silent); }),
      HasSubstr("look"));
  const auto source = generator::source_of(out);
  ASSERT_TRUE(source.has_value());
  EXPECT_EQ(source->seed, 3u);
  EXPECT_EQ(source->look, Look::american);
}

}  // namespace
}  // namespace mirage
