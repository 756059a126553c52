// Cars pasted into other frames, against frames rendered with the car in them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numeric>
#include <set>
#include <tuple>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "detection/car_in_picture.h"
#include "detection/ground_truth_sampling.h"
#include "detection/training.h"
#include "generator/dataset.h"
#include "geometry/mesh.h"
#include "scene/data/kitti.h"
#include "sensors/ray_caster.h"
#include "support/files.h"

namespace mirage {
namespace {

using ::testing::HasSubstr;

constexpr std::array<double, 4> kRegion = {0, 70, -40, 40};
constexpr double kGround = -1.73;

struct Block {
  Box3 box;
  Vec3f colour;
  std::string type = "";  // labelled if not empty
};

Block block(double x, double y, double yaw = 0.3) {
  return {{{x, y, 4.2, 1.8, yaw}, kGround, 1.5}, Vec3f(0.7f, 0.1f, 0.1f), "Car"};
}
Block wall(double x, double y, double length, double width) {
  return {{{x, y, length, width, 0}, kGround, 3}, Vec3f(0.2f, 0.4f, 0.2f)};
}

/// A flat road with blocks on it, seen by kitti64's unit and a small camera.
class World {
 public:
  World() : lidar_(read_lidar_model(shipped_file("scenes/rigs/kitti64.toml"))), rays_(ray_table(lidar_)) {
    camera_.camera = {180, 180, 160, 40, 320, 96};
    camera_.camera_from_velo.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
    camera_.camera_from_velo.translation() = Vec3d(0, -0.1, -0.27);
  }
  const LidarModel& lidar() const { return lidar_; }

  Frame frame(const std::string& id, const std::vector<Block>& blocks, double ground = kGround) {
    std::vector<Mesh> meshes(1);
    append(meshes[0], box_mesh({300, 300, 2}), Transform(Eigen::Translation3d(0, 0, ground - 1)));
    for (const Block& block : blocks) {
      const auto& [bev, bottom, height] = block.box;
      meshes.emplace_back();
      append(meshes.back(), box_mesh({bev.length, bev.width, height}),
             velo_from_box(block.box) * Eigen::Translation3d(0, 0, height / 2));
    }
    const RayCaster caster(meshes);
    Frame made;
    made.id = id;
    made.calibration = camera_;
    HitTable hits;
    caster.intersect(rays_, 1, 80, hits);
    owner_.clear();
    for (std::size_t row = 0; row < rays_.rows; ++row)
      for (std::size_t column = 0; column < rays_.columns; ++column) {
        const std::size_t i = rays_.index(row, column);
        if (hits.mesh[i] < 0) continue;
        const Vec3f p = rays_.origin_at(i) + hits.t[i] * rays_.direction_at(i);
        made.sweep.push_back({p.x(), p.y(), p.z(), 0.25f * static_cast<float>(hits.mesh[i] % 4)});
        owner_.push_back(number(blocks, hits.mesh[i]));
      }
    made.image = ImageF(320, 96, 3);
    instances_ = Image<std::uint16_t>(320, 96, 1);
    const Transform velo_from_camera = camera_.camera_from_velo.inverse();
    for (int v = 0; v < 96; ++v)
      for (int u = 0; u < 320; ++u) {
        const Vec3d towards = velo_from_camera.linear() * camera_.camera.unproject(u, v, 1);
        const Hit hit =
            caster.intersect({velo_from_camera.translation().cast<float>(), towards.cast<float>()});
        Vec3f colour(0.5f, 0.7f, 1);
        if (hit.mesh == 0) colour = Vec3f::Constant(0.2f);
        if (hit.mesh > 0) colour = blocks[as_size(hit.mesh - 1)].colour;
        for (int c = 0; c < 3; ++c) made.image.at(u, v, c) = colour[c];
        instances_.at(u, v) = static_cast<std::uint16_t>(number(blocks, hit.mesh));
      }
    for (const Block& block : blocks) {
      if (block.type.empty()) continue;
      Label label;
      label.type = block.type;
      label.left = 10, label.right = 60, label.top = 20, label.bottom = 60;
      label.box = block.box;
      made.labels.push_back(label);
    }
    return made;
  }

  /// Writes the frame that was made last, with the owner of every point and pixel.
  void write(const std::filesystem::path& data, const Frame& made, bool points, bool pixels) const {
    write_frame(data, made);
    if (pixels) write_index_png(instance_file(data, made.id), instances_);
    if (!points) return;
    std::vector<std::uint32_t> words;
    for (const std::uint32_t k : owner_) words.push_back(k << 16 | (k > 0 ? 10u : 0u));
    write_point_labels(point_label_file(data, made.id), words);
  }

  static CompactFrame compact(const Frame& made) {
    CompactFrame small;
    small.width = made.image.width;
    small.height = made.image.height;
    for (const float value : made.image.data)
      small.srgb.push_back(static_cast<std::uint8_t>(std::lround(255 * srgb_from_linear(value))));
    small.points = points_in_view(made.sweep, made.calibration);
    small.calibration = made.calibration;
    small.truth = ground_truth(made, kRegion);
    return small;
  }

 private:
  /// 1 + k for label k, that of mesh `mesh` (0 is the road); 0 without a label.
  static std::uint32_t number(const std::vector<Block>& blocks, int mesh) {
    if (mesh < 1 || blocks[as_size(mesh - 1)].type.empty()) return 0;
    std::uint32_t labels = 0;
    for (int i = 0; i < mesh; ++i) labels += !blocks[as_size(i)].type.empty();
    return labels;
  }

  LidarModel lidar_;
  RayTable rays_;
  Calibration camera_;
  std::vector<std::uint32_t> owner_;
  Image<std::uint16_t> instances_;
};

using Place = std::tuple<float, float, float>;
std::multiset<Place> places(const std::vector<LidarPoint>& points) {
  std::multiset<Place> set;
  for (const LidarPoint& p : points) set.emplace(p.x, p.y, p.z);
  return set;
}

/// Number of points in only one of the two sets, as a share of those in `a`.
double difference(const std::vector<LidarPoint>& a, const std::vector<LidarPoint>& b) {
  const auto first = places(a), second = places(b);
  std::vector<Place> apart;
  std::set_symmetric_difference(first.begin(), first.end(), second.begin(), second.end(),
                                std::back_inserter(apart));
  return static_cast<double>(apart.size()) / static_cast<double>(first.size());
}

class GroundTruthSampling : public ::testing::Test {
 protected:
  CutOut cut(const std::vector<Block>& blocks, bool points = true, bool pixels = true) {
    const Frame made = world.frame("000000", blocks);
    const test::TemporaryFolder data;
    world.write(data.path(), made, points, pixels);
    const auto cars = cut_out_cars(data.path(), "000000", kRegion, pixels);
    EXPECT_EQ(cars.size(), 1u);
    return cars.empty() ? CutOut() : cars[0];
  }
  CompactFrame scene(const std::vector<Block>& blocks, double ground = kGround) {
    return World::compact(world.frame("000001", blocks, ground));
  }
  World world;
  SamplingUnit unit = sampling_unit(world.lidar());
};

TEST_F(GroundTruthSampling, ACutOutIsTheCarAndNothingElse) {
  const CutOut exact = cut({wall(40, 0, 1, 60), block(15, 2)});
  std::size_t of_car = 0;
  for (const LidarPoint& p : exact.points) of_car += p.reflectance == 0.5f;  // mesh 2
  EXPECT_EQ(of_car, exact.points.size());
  EXPECT_GT(exact.points.size(), 300u);
  const auto pixels = std::accumulate(exact.mask.data.begin(), exact.mask.data.end(), 0);
  EXPECT_GT(pixels, 0.5 * exact.rect.width() * exact.rect.height());
  // Without point owners the box decides; only the lowest 0.1 m is missing.
  const CutOut by_box = cut({wall(40, 0, 1, 60), block(15, 2)}, false);
  EXPECT_LE(by_box.points.size(), exact.points.size());
  EXPECT_GT(by_box.points.size(), 0.85 * static_cast<double>(exact.points.size()));
  for (const LidarPoint& p : by_box.points) EXPECT_EQ(p.reflectance, 0.5f);
}

TEST_F(GroundTruthSampling, APastedCarIsAsIfItHadBeenThere) {
  for (const auto& [x, y] : {std::pair(12., 3.), std::pair(25., -4.), std::pair(45., 6.)}) {
    const std::vector<Block> street = {wall(60, 0, 1, 80), wall(30, 9, 20, 1), block(18, -8, 0.1)};
    std::vector<Block> with_car = street;
    with_car.push_back(block(x, y));
    CompactFrame pasted = scene(street);
    const CompactFrame before = pasted, made = scene(with_car);
    ASSERT_TRUE(paste(pasted, cut({block(x, y)}), unit));
    EXPECT_LT(difference(made.points, pasted.points), 0.02) << x;
    EXPECT_GT(difference(before.points, pasted.points), 3 * difference(made.points, pasted.points)) << x;
    EXPECT_EQ(pasted.truth.space.boxes.size(), 2u);
    int apart = 0, changed = 0;
    for (std::size_t i = 0; i < made.srgb.size(); i += 3) {
      apart += std::abs(made.srgb[i] - pasted.srgb[i]) > 1;
      changed += before.srgb[i] != pasted.srgb[i];
    }
    // All pixels agree, except at the outline, where colours mix.
    EXPECT_LT(apart, 0.05 * changed + 12 * std::sqrt(changed)) << x;
    EXPECT_GT(changed, 50);
  }
}

TEST_F(GroundTruthSampling, ThePicturesTruthHasThePastedCar) {
  const test::TemporaryFolder data;
  Frame street = world.frame("000001", {block(18, -8, 0.1), wall(30, 9, 20, 1)});
  street.labels[0].left = 200, street.labels[0].right = 300;  // beside the car that comes
  Label hidden = street.labels[0];                            // behind it, too far for a return
  hidden.left = 12, hidden.right = 58, hidden.top = 25, hidden.bottom = 55;
  hidden.box.bev.x = 90;
  street.labels.push_back(hidden);
  world.write(data.path(), street, true, true);
  const CompactFrame before = read_compact(data.path(), "000001", kRegion);
  EXPECT_NE(before.picture_key, 0u);
  EXPECT_EQ(before.picture_key, read_compact(data.path(), "000001", kRegion).picture_key);
  ASSERT_EQ(before.vehicle_mask.size(), before.srgb.size() / 3);
  EXPECT_EQ(before.truth.picture.boxes.size(), 2u);

  CompactFrame pasted = before;
  CutOut cut_out = cut({block(20, 3)});
  EXPECT_EQ(cut_out.picture.right, 60);
  ASSERT_TRUE(paste(pasted, cut_out, unit));
  EXPECT_EQ(pasted.picture_key, 0u);
  const TruthBoxes& truth = pasted.truth.picture;
  ASSERT_EQ(truth.boxes.size(), 2u);
  EXPECT_EQ(truth.boxes[0].label, 0u);
  EXPECT_EQ(truth.boxes[1].label, TruthBox::kPasted);
  EXPECT_EQ(truth.boxes[1].picture.right, 60);
  EXPECT_DOUBLE_EQ(truth.boxes[1].distance, horizontal_distance(cut_out.box.bev));
  ASSERT_EQ(truth.ignore.size(), 1u);
  EXPECT_EQ(truth.ignore[0].picture.right, 58);

  Frame made = world.frame("000002", {block(18, -8, 0.1), wall(30, 9, 20, 1), block(20, 3)});
  world.write(data.path(), made, true, true);
  const CompactFrame there = read_compact(data.path(), "000002", kRegion);
  EXPECT_NE(there.picture_key, before.picture_key);
  EXPECT_GT(std::count(there.vehicle_mask.begin(), there.vehicle_mask.end(), true),
            std::count(before.vehicle_mask.begin(), before.vehicle_mask.end(), true) + 100);
  EXPECT_EQ(pasted.vehicle_mask, there.vehicle_mask);

  const PreparedSample sample = prepared_sample(pasted, Eigen::Affine3d::Identity(), kRegion);
  const TrainingSample view = sample.view();
  EXPECT_EQ(view.picture_boxes.size(), 2u);
  EXPECT_EQ(view.picture_ignore.size(), 1u);
  EXPECT_EQ(view.vehicle_mask.size(), pasted.vehicle_mask.size());
  EXPECT_EQ(view.picture_key, 0u);

  // Only points: the picture does not change.
  CompactFrame points_only = before;
  ASSERT_TRUE(paste(points_only, cut({block(20, 3)}, true, false), unit));
  EXPECT_EQ(points_only.picture_key, before.picture_key);
  EXPECT_EQ(points_only.truth.picture.boxes.size(), 2u);
  EXPECT_EQ(points_only.vehicle_mask, before.vehicle_mask);
  std::filesystem::remove(instance_file(data.path(), "000001"));
  EXPECT_TRUE(read_compact(data.path(), "000001", kRegion).vehicle_mask.empty());
}

TEST_F(GroundTruthSampling, WhatIsNearerHides) {
  // A post hides a strip of the car's points and pixels.
  const std::vector<Block> street = {wall(60, 0, 1, 80), wall(10, 1.6, 0.15, 0.15)};
  std::vector<Block> with_car = street;
  with_car.push_back(block(20, 3));
  CompactFrame pasted = scene(street);
  const CutOut cut_out = cut({block(20, 3)});
  ASSERT_TRUE(paste(pasted, cut_out, unit));
  const CompactFrame made = scene(with_car);
  EXPECT_LT(difference(made.points, pasted.points), 0.03);
  // A wall hides all of it.
  CompactFrame walled = scene({wall(12, 3, 0.5, 8)});
  const CompactFrame untouched = walled;
  EXPECT_FALSE(paste(walled, cut_out, unit));
  EXPECT_EQ(places(walled.points), places(untouched.points));
  EXPECT_EQ(walled.srgb, untouched.srgb);
}

TEST_F(GroundTruthSampling, TakenPlacesAreRefused) {
  const CutOut cut_out = cut({block(20, 3)});
  CompactFrame taken = scene({block(21, 5)});
  EXPECT_FALSE(paste(taken, cut_out, unit));
  CompactFrame bush = scene({wall(20.5, 3, 0.6, 0.6)});
  EXPECT_FALSE(paste(bush, cut_out, unit));
  CompactFrame behind = scene({block(27, 4.5)});  // it would vanish behind the pasted car
  EXPECT_EQ(behind.truth.space.boxes.size(), 1u);
  EXPECT_FALSE(paste(behind, cut_out, unit));
}

TEST_F(GroundTruthSampling, TheCarStandsOnTheGroundThatIsThere) {
  const CutOut cut_out = cut({block(20, 3)});
  CompactFrame low = scene({}, kGround - 0.12);
  ASSERT_TRUE(paste(low, cut_out, unit));
  float lowest = 10, lowest_of_car = 10;
  for (const LidarPoint& p : low.points)
    if (p.reflectance == 0.25f) lowest = std::min(lowest, p.z);
  for (const LidarPoint& p : cut_out.points) lowest_of_car = std::min(lowest_of_car, p.z);
  EXPECT_NEAR(lowest, lowest_of_car - 0.12, 0.02);
  CompactFrame deep = scene({}, kGround - 0.4);
  EXPECT_FALSE(paste(deep, cut_out, unit));
}

TEST_F(GroundTruthSampling, DependsOnSeedAndIndexAlone) {
  const test::TemporaryFolder data;
  world.write(data.path(), world.frame("000000", {block(20, 3), block(35, -5)}), true, true);
  world.write(data.path(), world.frame("000001", {wall(50, 0, 1, 60)}), true, true);
  world.write(data.path(), world.frame("000002", {block(12, -6), block(28, 5)}), true, true);
  const std::vector<std::string> ids = {"000000", "000001", "000002"};
  const CompactFrame empty = scene({wall(50, 0, 1, 60)});
  GroundTruthSampler first(data.path(), ids, kRegion, 5, 2, true),
      second(data.path(), ids, kRegion, 5, 2, true);
  EXPECT_EQ(first.size(), 4u);
  double pasted = 0;
  for (std::uint64_t i = 0; i < 40; ++i) {
    CompactFrame a = empty, b = empty;
    pasted += first.augment(a, i);
    second.augment(b, 39 - i);
    CompactFrame c = empty;
    second.augment(c, i);
    ASSERT_EQ(places(a.points), places(c.points));
    ASSERT_EQ(a.srgb, c.srgb);
  }
  EXPECT_GT(pasted / 40, 1.2);
  EXPECT_LT(pasted / 40, 2.6);
}

TEST_F(GroundTruthSampling, WithoutInstancesOnlyPointsArePasted) {
  const test::TemporaryFolder data;
  world.write(data.path(), world.frame("000000", {block(20, 3)}), false, false);
  const CompactFrame empty = scene({wall(50, 0, 1, 60)});
  CompactFrame frame = empty;
  EXPECT_EQ(GroundTruthSampler(data.path(), {"000000"}, kRegion, 1, 20, true).augment(frame, 0), 0);
  EXPECT_EQ(GroundTruthSampler(data.path(), {"000000"}, kRegion, 1, 20, false).augment(frame, 0), 1);
  EXPECT_EQ(frame.srgb, empty.srgb);
  EXPECT_EQ(frame.truth.space.boxes.size(), 1u);
}

TEST_F(GroundTruthSampling, APointLabelFileOfAnotherSweepIsNamed) {
  const test::TemporaryFolder data;
  world.write(data.path(), world.frame("000000", {block(20, 3)}), true, true);
  write_file(point_label_file(data.path(), "000000"), "abcd");
  const auto read = [&] { cut_out_cars(data.path(), "000000", kRegion, true); };
  EXPECT_THAT(test::error_text<InputError>(read), HasSubstr("000000.label"));
}

}  // namespace
}  // namespace mirage
