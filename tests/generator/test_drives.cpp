// Moving streets, and drives on disk.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "base/error.h"
#include "base/files.h"
#include "base/parallel.h"
#include "base/sizes.h"
#include "base/types.h"
#include "generator/dataset.h"
#include "generator/street.h"
#include "geometry/box.h"
#include "scene/data/read_frames.h"
#include "support/files.h"
#include "support/small_rig.h"

namespace mirage {
namespace {

using generator::make_moving_street;
using generator::Mover;
using generator::MovingStreet;
using generator::Waypoint;
using test::small_rig;
using testing::HasSubstr;

TEST(MovingStreet, EveryRoleIsThereAndNothingMeetsAnything) {
  std::map<std::string, int> roles;
  for (const Look look : {Look::european, Look::american})
    for (std::uint64_t index = 0; index < 6; ++index) {
      const MovingStreet street = make_moving_street(5, index, 1.73, look, 5);
      std::set<std::string> here;
      for (const Mover& mover : street.movers) here.insert(mover.role);
      for (const std::string& role : here) ++roles[role];
      for (const double time : {0.0, 1.7, 3.3, 5.0}) {
        const generator::Street now = street.at(time);
        const Waypoint& own = street.own[street.step(time)];
        std::vector<BevBox> boxes = {{own.position.x(), own.position.y(), 4.5, 1.8, own.yaw}};
        for (std::size_t k = 0; k < now.placed.size(); ++k) {
          for (const BevBox& other : boxes)
            EXPECT_EQ(intersection_area(now.placed[k].box.bev, other), 0)
                << name_of(look) << " " << index << " at " << time << ": " << now.placed[k].type;
          if (k >= street.standing.placed.size() || k % 7 == 0) boxes.push_back(now.placed[k].box.bev);
        }
      }
    }
  for (const char* role : {"brakes", "overtakes", "towards", "crosses"}) EXPECT_GE(roles[role], 10) << role;
}

TEST(MovingStreet, WaysAreSmoothAndDoWhatTheyAreCalled) {
  const MovingStreet street = make_moving_street(5, 1, 1.73, Look::european, 5);
  EXPECT_LT(street.own.front().pose().translation().norm(), 1e-9);
  EXPECT_LT(std::abs(street.own.front().yaw), 1e-9);
  const auto last = street.own.size() - 1;
  const auto check = [&](const generator::Way& way) {
    for (std::size_t k = 1; k < last; ++k) {
      EXPECT_LT((way[k].velocity - way[k - 1].velocity).norm(), 12 * generator::kWayStep);
      EXPECT_LT(std::abs(wrap_angle(way[k].yaw - way[k - 1].yaw)), 0.6 * generator::kWayStep);
      EXPECT_LT((way[k].position + generator::kWayStep * way[k].velocity - way[k + 1].position).norm(), 0.01);
    }
  };
  check(street.own);
  for (const Mover& mover : street.movers) {
    check(mover.way);
    const Waypoint &first = mover.way.front(), &end = mover.way[last];
    const auto ahead = [&](std::size_t k) { return mover.way[k].position.x() - street.own[k].position.x(); };
    if (mover.role == "brakes") {
      EXPECT_LT(end.velocity.norm(), first.velocity.norm() - 1);
      EXPECT_GT(ahead(last), 4);
    }
    if (mover.role == "overtakes") {
      EXPECT_LT(ahead(0), -5);
      EXPECT_GT(ahead(last), 2);
    }
    if (mover.role == "towards") {
      EXPECT_LT(first.velocity.x(), -4);
    }
    if (mover.role == "crosses") {
      EXPECT_GT(std::abs(first.velocity.y()), 3);
    }
  }
}

/// A thing's returns lie in its box, although both have moved by then.
TEST(MovingStreet, ReturnsLieOnWhatMoves) {
  const Rig rig = small_rig();
  const MovingStreet street = make_moving_street(5, 1, rig.lidar.height, Look::european, 2);
  const Frame frame = generate_drive_frame(rig, street, RayScene(street.standing.surfaces), 5, 1, 1.0);
  EXPECT_EQ(frame.id, "0001_000010");
  int moving = 0;
  for (const Label& label : frame.labels) {
    ASSERT_GE(label.track, 0);
    if (label.track < static_cast<int>(street.standing.placed.size())) continue;
    ++moving;
    const auto inside = [&](double margin, const LidarPoint& point) {
      const Vec3d p = velo_from_box(label.box).inverse() * point.position().cast<double>();
      return std::abs(p.x()) < 0.5 * label.box.bev.length + margin &&
             std::abs(p.y()) < 0.5 * label.box.bev.width + margin && p.z() > 0.3 &&
             p.z() < label.box.height + 0.1;
    };
    int near = 0, on = 0;
    for (const LidarPoint& point : frame.sweep) near += inside(0.5, point), on += inside(0.3, point);
    EXPECT_GE(on, 0.9 * near) << label.type << " at " << label.box.bev.x;
  }
  EXPECT_GE(moving, 2);
}

TEST(GenerateDrives, AreReadAsDrivesWithTheirPosesAndIdentities) {
  const test::TemporaryFolder folder;
  const std::filesystem::path out = folder / "drives";
  const auto silent = [](std::size_t) {};
  DatasetSummary sum = generate_drives(small_rig(), 5, 1, 1, 0.4, out, silent);
  EXPECT_EQ(sum.written, 4);
  const std::vector<Sequence> sequences = read_sequences(out);
  ASSERT_EQ(sequences.size(), 1u);
  ASSERT_EQ(sequences[0].frames.size(), 4u);
  const MovingStreet street =
      make_moving_street(5, 1, small_rig().lidar.height, Look::european, 0.4 + 2 * generator::kWayStep);
  for (const SequenceFrame& at : sequences[0].frames) {
    EXPECT_NEAR(at.moment.time, 0.1 * at.moment.index, 1e-6);
    const Transform own = street.own[street.step(at.moment.time)].pose();
    EXPECT_LT((at.moment.world_from_ego.matrix() - own.matrix()).cwiseAbs().maxCoeff(), 1e-5);
    const Frame frame = read_frame(out, at.id);
    EXPECT_GT(frame.sweep.size(), 3000u);
    const Lighting light = generator::make_light(5, 1).lighting;
    EXPECT_LT((frame.lighting.sun - light.sun).norm(), 1e-6);
    EXPECT_LT((own.linear() * frame.lighting.to_sun_velo - light.to_sun_velo).norm(), 1e-5);
    ASSERT_FALSE(frame.labels.empty());
    for (const Label& label : frame.labels) {
      ASSERT_GE(label.track, 0);
      const int number = label.track % 100000;
      if (number >= static_cast<int>(street.standing.placed.size())) continue;
      const Vec3d world =
          at.moment.world_from_ego * Vec3d(label.box.bev.x, label.box.bev.y, label.box.bottom);
      const Box3& box = street.standing.placed[as_size(number)].box;
      EXPECT_LT((world - Vec3d(box.bev.x, box.bev.y, box.bottom)).norm(), 0.03);
    }
  }
  const auto rows = [&](const char* file) {
    const std::string text = read_file(out / "training" / file);
    return std::count(text.begin(), text.end(), '\n');
  };
  EXPECT_GT(rows("label_02/0001.txt"), 4);
  EXPECT_EQ(rows("motion_02/0001.txt"), rows("label_02/0001.txt"));
  // Files that are as they were written stay; the files of the sequence come out the same.
  const std::string labels = read_file(out / "training/label_02/0001.txt"),
                    picture = read_file(out / "training/image_02/0001/000002.png");
  write_file(out / "training/image_02/0001/000002.png", "cut");
  std::filesystem::remove(out / "training/label_02/0001.txt");
  set_thread_count(1);
  sum = generate_drives(small_rig(), 5, 1, 1, 0.4, out, silent);
  set_thread_count(0);
  EXPECT_EQ(sum.written, 1);
  EXPECT_EQ(sum.existing, 3);
  EXPECT_EQ(read_file(out / "training/label_02/0001.txt"), labels);
  EXPECT_EQ(read_file(out / "training/image_02/0001/000002.png"), picture);
  EXPECT_THAT(test::error_text<InputError>([&] { generate_drives(small_rig(), 5, 1, 1, 2, out, silent); }),
              HasSubstr("drives_of_s"));
  EXPECT_THAT(test::error_text<InputError>([&] { generate_dataset(small_rig(), 5, 0, 1, out, silent); }),
              HasSubstr("holds drives"));
}

}  // namespace
}  // namespace mirage
