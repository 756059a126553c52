// The audit: planted detectors that read one input, and networks mixed from a real one that use their picture
// always, in half of the frames, or never.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <set>

#include "base/random.h"
#include "base/types.h"
#include "detection/audit.h"
#include "generator/dataset.h"
#include "generator/generator.h"
#include "scene/data/read_frames.h"
#include "scene/occlusion.h"
#include "support/files.h"
#include "support/layouts.h"
#include "support/planted.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using Kind = AuditChange::Kind;
using test::Eyes;
using test::kPlaces;
using test::place;
using test::Planted;
using test::write_planted;
using testing::HasSubstr;

Audit audit_of(Detector& detector, const fs::path& data, const std::vector<AuditChange>& changes,
               const std::optional<LidarModel>& lidar = {}) {
  Detector* const only[] = {&detector};
  return run_audit(only, data, list_frames(data), changes, lidar);
}

/// Returns a given function's detections.
class Answering : public Planted {
 public:
  using Answer = std::function<std::vector<Detection>(const SensorView&)>;
  explicit Answering(Answer answer) : Planted(Eyes::ignores), answer_(std::move(answer)) {}
  std::vector<Detection> forward(const SensorView& input, double, bool) override { return answer_(input); }

 private:
  Answer answer_;
};

Detection car_at(double x) {
  return {{x, 0, 4, 2, 0}, 3};
}

double mean_x(std::span<const LidarPoint> points) {
  double sum = 0;
  for (const LidarPoint& point : points) sum += point.x;
  return sum / static_cast<double>(points.size());
}

TEST(Audit, TellsWhichInputADetectorUses) {
  test::TemporaryFolder folder;
  write_planted(folder.path());
  const std::vector<AuditChange> both = {{Kind::other_picture}, {Kind::other_sweep}};
  Planted eyes(Eyes::sees), ears(Eyes::ignores);
  const Audit seen = audit_of(eyes, folder.path(), both), heard = audit_of(ears, folder.path(), both);
  EXPECT_EQ(seen.row(Kind::other_picture)->use(), InputUse::used);
  EXPECT_EQ(seen.row(Kind::other_sweep)->use(), InputUse::ignored);
  EXPECT_EQ(heard.row(Kind::other_picture)->use(), InputUse::ignored);
  EXPECT_EQ(heard.row(Kind::other_sweep)->use(), InputUse::used);
  const AuditRow& row = *heard.row(Kind::other_sweep);
  EXPECT_EQ(row.vehicles, kPlaces);
  EXPECT_DOUBLE_EQ(row.right70, 1);
  EXPECT_EQ(row.ap70, 0);
  ASSERT_FALSE(row.lost.empty());
  EXPECT_EQ(row.lost[0].stratum, "all");
  EXPECT_DOUBLE_EQ(row.lost[0].share.value, 1);
  int vehicles = 0;
  for (std::size_t i = 1; i < row.lost.size(); ++i) vehicles += row.lost[i].vehicles;
  EXPECT_EQ(vehicles, kPlaces);  // every car is in one range
  const auto json = to_json(heard);
  EXPECT_EQ(json.at("uses").at("image"), false);
  EXPECT_EQ(json.at("uses").at("points"), true);
  EXPECT_THAT(describe(heard).at(0), HasSubstr("does not use its picture"));
  EXPECT_THAT(describe(heard).at(1), HasSubstr("it uses its sweep"));
}

TEST(Audit, FindsTheWeakestErrorOfCalibrationThatMatters) {
  test::TemporaryFolder folder;
  write_planted(folder.path());
  // Believes returns only where they project to within 2 px of the picture's middle column: 40 tan(2°) is
  // 1.4 px, 40 tan(5°) is 3.5 px; 0.2 m at 10 m is 0.8 px, 2 m at 43 m is 1.9 px.
  Answering detector([](const SensorView& view) -> std::vector<Detection> {
    const Calibration& calibration = *view.calibration;
    const Vec3d p_camera = calibration.camera_from_velo * Vec3d(mean_x(view.points), 0, -1);
    const double u = calibration.camera.project(p_camera).x();
    if (std::abs(u - calibration.camera.cx) > 2) return {};
    return {car_at(mean_x(view.points))};
  });
  const Audit audit = audit_of(detector, folder.path(),
                               {{Kind::turned_camera, 2},
                                {Kind::turned_camera, 5},
                                {Kind::moved_camera, 0.2},
                                {Kind::moved_camera, 2}});
  ASSERT_EQ(audit.rows.size(), 4u);
  EXPECT_EQ(audit.rows[0].drop.value, 0);
  EXPECT_NEAR(audit.rows[1].drop.value, 1, 1e-12);
  EXPECT_EQ(audit.rows[2].drop.value, 0);
  EXPECT_GT(audit.rows[3].drop.value, 0.5);  // the nearer cars
  EXPECT_LT(audit.rows[3].drop.value, 1);
  const std::vector<std::string> lines = describe(audit);
  ASSERT_EQ(lines.size(), 2u);
  EXPECT_THAT(lines[0], HasSubstr("turned by 5° costs 100.0 points"));
  EXPECT_THAT(lines[1], HasSubstr("moved by 200 cm costs"));
}

TEST(Audit, LeavesAsManyBeamsAsAsked) {
  test::TemporaryFolder folder;
  const Rig rig = read_rig(fs::path(MIRAGE_SOURCE) / "scenes" / "rigs" / "kitti64.toml");
  generate_dataset(rig, 5, 0, 3, folder.path(), [](std::size_t) {});
  std::map<std::size_t, std::vector<std::set<int>>> beams;  // by number asked for, a set a frame
  Answering detector([&](const SensorView& view) -> std::vector<Detection> {
    const std::vector<int> beam = beams_of(view.points, rig.lidar);
    std::set<int> drawn(beam.begin(), beam.end());
    drawn.erase(-1);
    beams[drawn.size()].push_back(drawn);
    return {};
  });
  audit_of(detector, folder.path(), {{Kind::thinned_sweep, 8}, {Kind::thinned_sweep, 2}}, rig.lidar);
  ASSERT_EQ(beams[8].size(), 3u);
  ASSERT_EQ(beams[2].size(), 3u);
  EXPECT_NE(beams[8][0], beams[8][1]);  // other beams in each frame
  for (std::size_t f = 0; f < 3; ++f)   // a smaller set is part of a larger one
    EXPECT_TRUE(
        std::includes(beams[8][f].begin(), beams[8][f].end(), beams[2][f].begin(), beams[2][f].end()));
  const auto first = beams;
  beams.clear();
  audit_of(detector, folder.path(), {{Kind::thinned_sweep, 8}, {Kind::thinned_sweep, 2}}, rig.lidar);
  EXPECT_EQ(beams, first);
  EXPECT_TRUE(
      audit_of(detector, folder.path(), {{Kind::thinned_sweep, 8}}).rows.empty());  // the unit is unknown
}

TEST(Audit, BlursInLinearLightAndKeepsTheMean) {
  test::TemporaryFolder folder;
  for (int k = 0; k < 2; ++k) {
    Frame frame = test::planted_frame(k);
    std::fill(frame.image.data.begin(), frame.image.data.end(), 0.0f);
    for (int c = 0; c < 3; ++c) frame.image.at(24, 16, c) = 1;
    write_frame(folder.path(), frame);
  }
  std::vector<std::pair<double, float>> seen;  // sum and largest value
  Answering detector([&](const SensorView& view) -> std::vector<Detection> {
    double sum = 0;
    for (const float value : view.image->data) sum += value;
    seen.emplace_back(sum, *std::max_element(view.image->data.begin(), view.image->data.end()));
    return {};
  });
  audit_of(detector, folder.path(), {{Kind::blurred_picture, 2}});
  ASSERT_EQ(seen.size(), 4u);
  EXPECT_NEAR(seen[1].first, seen[0].first, 1e-3);
  EXPECT_NEAR(seen[1].second, 1 / (2 * M_PI * 4), 2e-3);  // a Gaussian's middle
}

TEST(Audit, ALatePictureIsThatOfAnEarlierFrame) {
  test::TemporaryFolder folder;
  std::vector<Frame> drive;
  for (int k = 0; k < 5; ++k) drive.push_back(test::planted_frame(k));
  test::write_tracking(folder.path(), drive);
  Planted eyes(Eyes::sees);
  const Audit audit = audit_of(eyes, folder.path(),
                               {{Kind::late_picture, 1}, {Kind::late_picture, 2}, {Kind::late_picture, 5}});
  ASSERT_EQ(audit.rows.size(), 2u);  // no frame has one five frames earlier
  EXPECT_EQ(audit.rows[0].frames, 4);
  EXPECT_EQ(audit.rows[1].frames, 3);
  EXPECT_DOUBLE_EQ(audit.rows[0].right70, 1);
  EXPECT_EQ(audit.rows[0].ap70, 0);  // 3 m away: an IoU of 1/7
  test::TemporaryFolder single;
  write_planted(single.path());
  EXPECT_TRUE(audit_of(eyes, single.path(), {{Kind::late_picture, 1}}).rows.empty());  // no sequence
}

TEST(Audit, ADetectorMayRefuseToGoWithout) {
  test::TemporaryFolder folder;
  write_planted(folder.path());
  Planted detector(Eyes::needs_a_picture);
  const Audit audit = audit_of(detector, folder.path(), gate_changes());
  EXPECT_THAT(audit.row(Kind::no_picture)->refused, HasSubstr("no picture"));
  EXPECT_EQ(audit.row(Kind::other_picture)->refused, "");
  EXPECT_THAT(to_json(audit).at("audit").at(2).at("refused").get<std::string>(), HasSubstr("no picture"));
  Answering fails([&](const SensorView& view) -> std::vector<Detection> {
    if (view.image->data[0] == 0) throw Failure("planted", "a black picture", "show another");
    return {};
  });
  EXPECT_THROW(audit_of(fails, folder.path(), gate_changes()), Failure);  // a picture is there
}

TEST(Audit, ChangesAreThoseOfTheInputsThatAreRead) {
  Capabilities lidar, camera;
  lidar.reads_image = false;
  camera.reads_points = false;
  const auto inputs = [](const std::vector<AuditChange>& changes) {
    std::set<AuditInput> result;
    for (const AuditChange& change : changes) result.insert(change.input());
    return result;
  };
  EXPECT_EQ(inputs(audit_changes(lidar)), std::set{AuditInput::points});
  EXPECT_EQ(inputs(audit_changes(camera)), std::set{AuditInput::picture});
  EXPECT_EQ(inputs(audit_changes({})).size(), 3u);
}

TEST(Audit, FramesAreSpreadEvenly) {
  const std::vector<std::string> ids = {"a", "b", "c", "d", "e", "f"};
  EXPECT_EQ(spread_evenly(ids, 3), (std::vector<std::string>{"a", "c", "e"}));
  EXPECT_EQ(spread_evenly(ids, 0), ids);
  EXPECT_EQ(spread_evenly(ids, 9), ids);
}

#ifdef MIRAGE_HAS_FUSION

/// Caches the answers of `fusion` for each picture with each sweep.
class Remembered {
 public:
  explicit Remembered(Detector& detector) : detector_(detector) {}
  struct Sight {
    std::vector<Detection> right, shown;
    bool wrong;  ///< the picture is another frame's
  };
  /// A sweep's first picture is its own.
  Sight look(const SensorView& view) {
    const auto sweep = std::make_pair(view.points.size(), view.points.front().x);
    double picture = 0;
    for (std::size_t i = 0; i < view.image->data.size(); i += 101) picture += view.image->data[i];
    const double own = own_.emplace(sweep, picture).first->second;
    const auto key = std::make_pair(sweep, picture);
    if (!said_.contains(key)) said_[key] = detector_.forward(view, 1e-4, false);
    return {said_.at({sweep, own}), said_.at(key), picture != own};
  }

 private:
  using Sweep = std::pair<std::size_t, float>;
  Detector& detector_;
  std::map<Sweep, double> own_;
  std::map<std::pair<Sweep, double>, std::vector<Detection>> said_;
};

/// `fusion` that uses its picture in a share of the frames; its logits vary slightly with the picture.
class Mixed : public Planted {
 public:
  Mixed(Remembered& memory, std::array<double, 4> region, double share, std::uint64_t seed)
      : Planted(Eyes::sees), memory_(memory), region_(region), share_(share), seed_(seed) {}
  std::array<double, 4> region() const override { return region_; }
  std::vector<Detection> forward(const SensorView& view, double, bool) override {
    const auto [right, shown, wrong] = memory_.look(view);
    RandomStream random(seed_, "looks", view.points.size());
    const bool looks = random.uniform() < share_;
    std::vector<Detection> result = looks ? shown : right;
    if (wrong)
      for (Detection& proposal : result) proposal.logit += 0.2 * random.normal();
    return result;
  }

 private:
  Remembered& memory_;
  std::array<double, 4> region_;
  double share_;
  std::uint64_t seed_;
};

TEST(Audit, TellsTwentyPlantedNetworksApart) {
  const Rig rig = read_rig(fs::path(MIRAGE_SOURCE) / "scenes" / "rigs" / "kitti64.toml");
  const fs::path data =
      fs::path(MIRAGE_BUILD) / "test_audit" / ("kitti64-" + std::to_string(kGeneratorVersion));
  generate_dataset(rig, 78, 0, 30, data, [](std::size_t) {});
  const auto fusion = load_detector({});
  Remembered memory(*fusion);
  int told = 0;  // use in only a few frames may stay undecided
  for (std::uint64_t network = 0; network < 20; ++network) {
    const double share = std::array{1.0, 0.5, 0.0}[network % 3];
    Mixed mixed(memory, fusion->region(), share, network);
    const Audit audit = audit_of(mixed, data, {{Kind::other_picture}});
    const AuditRow& row = audit.rows.at(0);
    told += row.use() != InputUse::unclear;
    EXPECT_NE(row.use(), share > 0 ? InputUse::ignored : InputUse::used)
        << "network " << network << ", looks in " << share << " of the frames: " << describe(audit).at(0)
        << " logits move by " << row.delta_logit.value;
  }
  std::printf("%d of 20 planted networks told, none wrongly\n", told);
  EXPECT_GE(told, 19);
}

#endif

}  // namespace
}  // namespace mirage
