// Drives: what follows from detections of hand-made vehicles, the motion of the carrier, and whole drives
// with a stand-in for a network.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <atomic>
#include <cmath>
#include <iterator>
#include <random>
#include <sstream>

#include "attack/adversary.h"
#include "attack/drive.h"
#include "attack/tiny_world.h"
#include "attack/vehicle_drive.h"
#include "attack/zoo.h"
#include "base/error.h"
#include "base/files.h"
#include "base/names.h"
#include "base/sizes.h"
#include "base/types.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/read_frames.h"
#include "support/files.h"
#include "support/tiny_drive.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::HasSubstr;

/// One frame each 0.1 s. `found`: f or -, `track`: f, c or l, one letter per frame. The car comes nearer at
/// 10 m/s.
VehicleDrive vehicle(const std::string& found, const std::string& track) {
  VehicleDrive drive;
  drive.sequence = "0003";
  drive.type = "Car";
  drive.track = 7;
  for (std::size_t i = 0; i < found.size(); ++i) {
    DriveFrame frame;
    frame.index = static_cast<int>(i);
    frame.time = 5 + 0.1 * static_cast<double>(i);
    frame.range = 40 - static_cast<double>(i);
    frame.nearest = frame.range - 2;
    frame.closing = 10;
    for (DriveObservation& observation : frame.observations)
      observation = {found[i] == 'f', static_cast<TrackStatus>(track[i])};
    drive.frames.push_back(frame);
  }
  return drive;
}

TEST(VehicleDrive, GapsAndConfirmationOfAHandMadeDrive) {
  const DriveOutcome of = outcome_of(vehicle("--f---ff-f", "llllfcclff"), DriveVersion::attacked);
  EXPECT_EQ(of.found, 4);
  EXPECT_NEAR(of.gap_s, 0.3, 1e-9);
  EXPECT_NEAR(of.track_gap_s, 0.4, 1e-9);
  ASSERT_TRUE(of.confirmed);
  EXPECT_NEAR(of.confirmed->seconds, 0.4, 1e-9);
  EXPECT_NEAR(of.confirmed->metres, 36, 1e-9);
  EXPECT_NEAR(*of.confirmed->time_to_collision, 3.4, 1e-9);
  EXPECT_NEAR(of.confirmed->reserve[0], 34 - 12.5, 1e-9);
  EXPECT_NEAR(of.confirmed->reserve[1], 34 - 100 / 12.0, 1e-9);
  EXPECT_NEAR(of.confirmed->reserve[2], 34 - 6.25, 1e-9);
}

TEST(VehicleDrive, AGapAtTheEndCountsAndAllOfItMayBeOne) {
  EXPECT_NEAR(outcome_of(vehicle("ff----", "ffffff"), DriveVersion::clean).gap_s, 0.4, 1e-9);
  const DriveOutcome blind = outcome_of(vehicle("------", "llllll"), DriveVersion::clean);
  EXPECT_NEAR(blind.gap_s, 0.6, 1e-9);
  EXPECT_FALSE(blind.confirmed);
  EXPECT_EQ(to_json(vehicle("------", "llllll")).at("confirmed_m").at("clean"), nullptr);
}

TEST(VehicleDrive, AFrameStandsUntilTheNextOne) {
  VehicleDrive drive = vehicle("f-f-f", "fffff");
  drive.frames[2].time += 0.05;  // the first gap is longer
  EXPECT_NEAR(outcome_of(drive, DriveVersion::clean).gap_s, 0.15, 1e-9);
}

// Time stamps at 0.1 s are not exact in binary, and neither are their differences.
TEST(VehicleDrive, AGapOfWholeFramesIsNoShorterForItsStamps) {
  VehicleDrive drive = vehicle("ff--ff", "ffffff");
  for (DriveFrame& frame : drive.frames) frame.time = static_cast<float>(frame.time) - 1e-6;
  drive.frames[2].time += 1e-6;
  DriveResult result;
  result.vehicles = {drive};
  for (const nlohmann::json& row : to_json(result).at("survival"))
    EXPECT_EQ(row.at("clean").at("value"), row.at("seconds").get<double>() <= 0.2 ? 1 : 0) << row;
}

TEST(VehicleDrive, AStretchWithoutALabelEndsAGap) {
  VehicleDrive drive = vehicle("ff----ff", "ffllllff");
  for (std::size_t i = 4; i < drive.frames.size(); ++i) drive.frames[i].time += 3;
  const DriveOutcome of = outcome_of(drive, DriveVersion::clean);
  EXPECT_NEAR(of.gap_s, 0.2, 1e-9);
  EXPECT_NEAR(of.track_gap_s, 0.2, 1e-9);
  // The strip, which the pages draw, shows the same.
  const nlohmann::json strip = to_json(drive).at("strip");
  EXPECT_EQ(strip.at("away"), (nlohmann::json{0, 0, 0, 1, 0, 0, 0, 0}));
  for (const nlohmann::json& seconds : strip.at("stands_s")) EXPECT_NEAR(seconds.get<double>(), 0.1, 1e-9);
}

TEST(VehicleDrive, WhatGoesAwayHasNoCollisionAndKeepsItsDistance) {
  VehicleDrive drive = vehicle("fff", "fff");
  for (DriveFrame& frame : drive.frames) frame.closing = -3;
  const DriveOutcome of = outcome_of(drive, DriveVersion::random);
  EXPECT_FALSE(of.confirmed->time_to_collision);
  EXPECT_NEAR(of.confirmed->reserve[0], 38, 1e-9);
}

TEST(VehicleDrive, PhantomsAreCountedInFramesAndSeconds) {
  VehicleDrive drive = vehicle("ffffff", "ffffff");
  drive.frames[1].observations[1].phantoms = 2;
  drive.frames[2].observations[1].phantoms = 1;
  drive.frames[2].observations[1].phantom_in_lane = true;
  const DriveOutcome of = outcome_of(drive, DriveVersion::attacked);
  EXPECT_EQ(of.phantom_frames, 2);
  EXPECT_NEAR(of.phantom_s, 0.2, 1e-9);
  EXPECT_NEAR(of.phantom_lane_s, 0.1, 1e-9);
  EXPECT_EQ(outcome_of(drive, DriveVersion::clean).phantom_frames, 0);
}

TEST(VehicleDrive, ComesBackFromItsFile) {
  VehicleDrive drive = vehicle("f-f-", "flcf");
  drive.phantom_tracks[2] = 3;
  drive.frames[3].observations[2] = {true, TrackStatus::coasting, 2, true};
  drive.roof.residual_m = 0.02;
  drive.deaths[1].track_gap_s[2] = 0.7;
  drive.deaths[4].phantom_frames[1] = 3;
  const nlohmann::json written = to_json(drive);
  EXPECT_EQ(to_json(read_vehicle_drive(JsonFields("file", written, "fix"))), written);
  nlohmann::json bad = written;
  bad["strip"]["clean"]["track"] = "flxf";
  EXPECT_THAT(error_text<InputError>([&] { read_vehicle_drive(JsonFields("file", bad, "fix")); }),
              HasSubstr("strip.clean.track"));
}

TEST(Drive, FlatMovesTakePlaceAndHeadingAlone) {
  Transform pose = Transform::Identity();
  pose.linear() =
      (Eigen::AngleAxisd(0.8, Vec3d::UnitZ()) * Eigen::AngleAxisd(0.05, Vec3d::UnitY())).toRotationMatrix();
  pose.translation() = Vec3d(100, -20, 3);
  const Box3 box{{30, 5, 4, 1.7, 0.2}, -1.7, 1.5};
  const Box3 world = moved_flat(box, laid_flat(pose)), back = moved_flat(world, laid_flat(pose).inverse());
  EXPECT_NEAR(world.bev.yaw, 1.0, 1e-9);
  EXPECT_NEAR(world.bottom, -1.7, 1e-12);
  EXPECT_NEAR(back.bev.x, 30, 1e-9);
  EXPECT_NEAR(back.bev.y, 5, 1e-9);
  EXPECT_NEAR(back.bev.yaw, 0.2, 1e-9);
}

/// A car that drives ahead of the ego vehicle, with noisy fitted roofs; every fifth roof is the box's.
std::vector<RoofTrackFrame> noisy_ride(int frames, std::vector<Transform>& truth) {
  std::mt19937 random(2);
  std::normal_distribution<double> draw;
  std::vector<RoofTrackFrame> all;
  for (int i = 0; i < frames; ++i) {
    RoofTrackFrame frame;
    frame.moment.time = 0.1 * i;
    frame.moment.world_from_ego.translation() = Vec3d(1.2 * i, 0.01 * i, 0);
    Label label;
    label.box = {{15 - 0.02 * i, 0.5, 4, 1.7, 0.05}, -1.7, 1.5};
    Transform roof = velo_from_box(label.box);
    roof.translate(Vec3d(-0.3, 0, 1.45));
    truth.push_back(roof);
    frame.carrier = BoxRoofFinder().find(Frame(), label);
    if (i % 5 != 4) {
      frame.carrier.from_box = false;
      frame.carrier.velo_from_roof =
          Eigen::Translation3d(0.05 * draw(random), 0.05 * draw(random), 0.02 * draw(random)) * roof *
          Eigen::AngleAxisd(1.5 * kDegree * draw(random), Vec3d::UnitZ());
      Mesh mesh;
      mesh.vertices = {frame.carrier.velo_from_roof * Vec3d(1, 0, 0)};
      frame.carrier.shape = std::make_shared<const Mesh>(mesh);
    }
    all.push_back(frame);
  }
  return all;
}

TEST(RoofTrack, TheObjectRidesOnASmoothRoof) {
  std::vector<Transform> truth;
  const auto frames = noisy_ride(60, truth);
  const RoofTrack track = roof_track(frames);
  ASSERT_EQ(track.carriers.size(), 60u);
  EXPECT_EQ(track.fit.fitted, 48);
  double squares = 0, turns = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const Carrier& carrier = track.carriers[i];
    const Transform off = truth[i].inverse() * carrier.velo_from_roof;
    squares += off.translation().squaredNorm();
    turns += std::pow(std::atan2(off(1, 0), off(0, 0)), 2);
    EXPECT_EQ(carrier.from_box, frames[i].carrier.from_box);
    if (carrier.shape) {  // it moves with its roof
      EXPECT_LT((carrier.velo_from_roof.inverse() * carrier.shape->vertices[0] - Vec3d(1, 0, 0)).norm(),
                1e-9);
    }
    // So does the box: the roof's pose in it is the same in all frames.
    const auto in_box = [&](std::size_t k) {
      return Transform(velo_from_box(track.carriers[k].label.box).inverse() *
                       track.carriers[k].velo_from_roof);
    };
    EXPECT_TRUE(in_box(i).isApprox(in_box(0), 1e-9));
    EXPECT_NEAR(track.velocities[i].x(), 11.8, 1);
  }
  EXPECT_LT(std::sqrt(squares / 60), 0.045);  // 3 cm an axis would be 5.2
  EXPECT_LT(std::sqrt(turns / 60), 1 * kDegree);
  EXPECT_GT(track.fit.fit_jitter_m, 0.05);
  EXPECT_LT(track.fit.jitter_m, 0.02);
  EXPECT_LT(track.fit.in_box_m, 0.045);  // these boxes are true
  EXPECT_GT(track.fit.in_box_m, 0.005);
  EXPECT_LT(track.fit.in_box_deg, 1);
  EXPECT_GT(track.fit.residual_m, 0.04);
  EXPECT_LT(track.fit.residual_m, 0.10);
}

TEST(RoofTrack, WithoutAnyFitItIsTheBoxsRoof) {
  std::vector<Transform> truth;
  auto frames = noisy_ride(10, truth);
  for (RoofTrackFrame& frame : frames) frame.carrier = BoxRoofFinder().find(Frame(), frame.carrier.label);
  const RoofTrack track = roof_track(frames);
  EXPECT_EQ(track.fit.fitted, 0);
  for (std::size_t i = 0; i < frames.size(); ++i)
    EXPECT_LT(
        (track.carriers[i].velo_from_roof.translation() - frames[i].carrier.velo_from_roof.translation())
            .norm(),
        0.01);
}

/// Eight frames of one car in the tracking layout; the detector's box stands on it.
class Drives : public testing::Test {
 protected:
  static constexpr int kFrames = 8;
  Drives() {
    setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
    test::write_tiny_drive(data(), folder_ / "object", kFrames);
  }
  std::filesystem::path data() const { return folder_ / "drive"; }
  DriveRequest request() const {
    DriveRequest request;
    request.data = data();
    request.sequences = read_sequences(data());
    request.object = initial_adversary({});
    request.random = random_adversary(1, {});
    request.settings.least_frames = 5;
    request.evaluation.quiet = true;
    request.provenance.set("what", "test");
    return request;
  }
  static DetectorPool pool(int detectors) {
    DetectorPool all;
    for (int i = 0; i < detectors; ++i) all.push_back(std::make_unique<test::StandInDetector>());
    return all;
  }
  nlohmann::json judged(const DriveRequest& asked, int detectors = 1) {
    FrameStore store(data(), read_lidar_model(shipped_file("scenes/rigs/kitti64.toml")));
    return to_json(judge_drive(pool(detectors), store, asked));
  }
  TemporaryFolder folder_;
};

TEST_F(Drives, OneVehicleThroughItsDrive) {
  const nlohmann::json drive = judged(request());
  EXPECT_EQ(drive.at("frames"), kFrames);
  ASSERT_EQ(drive.at("vehicles").size(), 1u);
  const nlohmann::json& car = drive.at("vehicles").at(0);
  EXPECT_EQ(car.at("sequence"), "0000");
  EXPECT_EQ(car.at("frames"), kFrames);
  EXPECT_EQ(car.at("found").at("clean"), kFrames);
  EXPECT_NEAR(car.at("gap_s").at("clean").get<double>(), 0, 1e-12);
  // The third detection confirms it.
  EXPECT_NEAR(car.at("confirmed_s").at("clean").get<double>(), 0.2, 1e-9);
  EXPECT_NEAR(car.at("confirmed_m").at("clean").get<double>(), std::hypot(11.48, 0.04), 1e-3);
  EXPECT_NEAR(drive.at("tracker").at("mota").get<double>(), 1 - 2.0 / kFrames, 1e-9);
  EXPECT_EQ(drive.at("never_confirmed").at("clean"), 0);
  EXPECT_EQ(drive.at("near").at("vehicles"), 1);
  // The settings' own `death` is one of the tested values.
  EXPECT_EQ(drive.at("deaths").at(1).at("death"), 2);
  EXPECT_EQ(drive.at("deaths").at(1).at("track_gap_s"), [&] {
    nlohmann::json gaps;
    for (const char* v : kDriveVersions) gaps[v] = drive.at("track_gap_s").at(v);
    return gaps;
  }());
  EXPECT_EQ(drive.at("near").at("clean"), 0);
  // The car stands still; only a vehicle that comes nearer can be confirmed later.
  EXPECT_EQ(drive.at("later_m").at("vehicles"), 0);
  EXPECT_FALSE(drive.at("later_m").contains("than_clean"));
}

TEST_F(Drives, LabelsOfOtherTypesAreJudgedWhereTheyAreAskedFor) {
  DriveRequest asked = request();
  asked.types = {"Pedestrian"};
  EXPECT_THAT(error_text<InputError>([&] { judged(asked); }), HasSubstr("no Pedestrian is followed"));
}

TEST_F(Drives, AVehicleWithoutRoomForTheObjectInOneFrameIsLeftOut) {
  DriveRequest asked = request();
  set_from_text("trailer", asked.place);
  EXPECT_EQ(judged(asked).at("left_out").at("no_room"), 0);
  // A pedestrian is close behind the car in one frame.
  const auto file = data() / "training/label_02/0000.txt";
  std::string rows = read_file(file), other;
  const std::size_t start = rows.find("\n3 4 ") + 1;
  std::istringstream words(rows.substr(start, rows.find('\n', start) - start));
  std::vector<std::string> row{std::istream_iterator<std::string>(words), {}};
  ASSERT_EQ(row.size(), 17u);
  row[1] = "5", row[2] = "Pedestrian";
  row[15] = std::to_string(std::stod(row[15]) - 4);
  for (const std::string& word : row) other += word + (&word == &row.back() ? "\n" : " ");
  write_file(file, rows + other);
  EXPECT_THROW(judged(asked), FieldError);
  set_from_text("roof", asked.place);
  EXPECT_EQ(judged(asked).at("left_out").at("no_room"), 0);
}

TEST_F(Drives, WhatWasSeenBeforeTheVehicleIsFollowedConfirmsNothing) {
  const auto labels = data() / "training/label_02/0000.txt";
  std::string text;
  for (const std::string& line : test::lines_of(labels)) {
    const auto words = split(line, " ");
    const bool early = words.at(0) == "0" || words.at(0) == "1" || words.at(0) == "2";
    text += early ? fmt::format("{} -1 {}\n", words[0], fmt::join(words.begin() + 2, words.end(), " "))
                  : line + "\n";
  }
  write_file(labels, text);
  const nlohmann::json car = judged(request()).at("vehicles").at(0);
  EXPECT_EQ(car.at("frames"), kFrames - 3);
  EXPECT_EQ(car.at("strip").at("clean").at("track"), "llfff");
  EXPECT_NEAR(car.at("confirmed_s").at("clean").get<double>(), 0.2, 1e-9);
}

TEST_F(Drives, ResultsDependNeitherOnThreadsNorOnAnInterruption) {
  const nlohmann::json once = judged(request());
  EXPECT_EQ(judged(request(), 3), once);
  DriveRequest kept = request();
  kept.folder = folder_ / "vehicles";
  EXPECT_EQ(judged(kept), once);
  // A finished vehicle is read from its file and not judged again.
  const auto file =
      kept.folder / fmt::format("0000_{}.json", once.at("vehicles").at(0).at("track").get<int>());
  nlohmann::json stored = read_json(file);
  stored["type"] = "Van";
  write_json(file, stored);
  EXPECT_EQ(judged(kept).at("vehicles").at(0).at("type"), "Van");
  // A file with other settings or with damage is judged anew.
  kept.provenance.set("what", "another");
  EXPECT_EQ(judged(kept), once);
  write_file(file, "{");
  EXPECT_EQ(judged(kept), once);
}

TEST_F(Drives, WhatIsNotToBeKeptIsWrittenAndNotRead) {
  DriveRequest asked = request();
  asked.folder = folder_ / "vehicles";
  asked.goes_on = false;
  const nlohmann::json once = judged(asked);
  nlohmann::json stored = read_json(asked.folder / "0000_4.json");
  stored["type"] = "Van";
  write_json(asked.folder / "0000_4.json", stored);
  EXPECT_EQ(judged(asked), once);
  EXPECT_EQ(read_json(asked.folder / "0000_4.json").at("type"), "Car");
}

/// Finds the car, and a false positive 9 m behind it and 3 m to its left.
class TwoThings : public test::StandInDetector {
 public:
  std::vector<Detection> forward(const SensorView& input, double threshold, bool keep) override {
    auto found = StandInDetector::forward(input, threshold, keep);
    found.push_back({{20.5, 3, 4, 1.7, 0}, 1});
    return found;
  }
};

TEST_F(Drives, APhantomStandsOnNoRoadUserAndWithAnObjectOnNoRecordedDetection) {
  const auto labels = data() / "training/label_02/0000.txt";
  const std::vector<std::string> cars = test::lines_of(labels);
  const auto phantoms = [&](const std::string& type) {
    std::string text;
    for (const std::string& line : cars) {
      std::istringstream words(line);
      std::vector<std::string> row{std::istream_iterator<std::string>(words), {}};
      text += line + "\n";
      row[1] = "5", row[2] = type;
      row[13] = std::to_string(std::stod(row[13]) - 3);
      row[15] = std::to_string(std::stod(row[15]) + 9);
      text += fmt::format("{}\n", fmt::join(row, " "));
    }
    write_file(labels, text);
    FrameStore store(data(), read_lidar_model(shipped_file("scenes/rigs/kitti64.toml")));
    return to_json(judge_drive(test::one_of<TwoThings>(), store, request()))
        .at("vehicles")
        .at(0)
        .at("phantoms");
  };
  const nlohmann::json on_look_alike = phantoms("Misc");
  EXPECT_EQ(on_look_alike.at("clean").at("frames"), kFrames - 2);  // from the third detection on
  EXPECT_EQ(on_look_alike.at("attacked").at("frames"), 0);         // new tracks alone
  EXPECT_EQ(phantoms("Cyclist").at("clean").at("frames"), 0);
}

/// Finds the car 2 m to the left of its true place.
template <MatchBy kBy>
class Beside : public test::StandInDetector {
 public:
  Capabilities capabilities() const override {
    Capabilities can;
    can.judged_by = kBy;
    return can;
  }
  std::vector<Detection> forward(const SensorView& input, double threshold, bool keep) override {
    auto found = StandInDetector::forward(input, threshold, keep);
    for (Detection& one : found) one.box.bev.y += 2;
    return found;
  }
};

TEST_F(Drives, BoxesAreComparedAsTheDetectorIsJudged) {
  const auto judge = [&]<MatchBy kBy>() {
    FrameStore store(data(), read_lidar_model(shipped_file("scenes/rigs/kitti64.toml")));
    return to_json(judge_drive(test::one_of<Beside<kBy>>(), store, request())).at("vehicles").at(0);
  };
  const nlohmann::json from_above = judge.operator()<MatchBy::own>(),
                       by_centre = judge.operator()<MatchBy::centre>();
  EXPECT_EQ(from_above.at("found").at("clean"), 0);
  EXPECT_EQ(from_above.at("confirmed_s").at("clean"), nullptr);
  EXPECT_EQ(by_centre.at("found").at("clean"), kFrames);
  EXPECT_EQ(by_centre.at("strip").at("clean").at("track"), "llffffff");
  EXPECT_THAT(error_text<FieldError>([&] { judge.operator()<MatchBy::picture>(); }),
              HasSubstr("matching: picture: compares boxes in the picture"));
}

// Two equal .gltf files can name different geometry, which lies in a second file.
TEST(DrivenObjects, AreKnownByTheirMeshesAndNotByTheirFiles) {
  Provenance one, other;
  add_objects(one, {{"a", "a.gltf", random_adversary(1, {})}});
  add_objects(other, {{"a", "a.gltf", random_adversary(2, {})}});
  EXPECT_NE(one.input("mesh"), other.input("mesh"));
}

TEST_F(Drives, TooShortATrackAndBoxesOfThePictureAreRefused) {
  DriveRequest asked = request();
  asked.settings.least_frames = kFrames + 1;
  EXPECT_THAT(error_text<InputError>([&] { judged(asked); }), HasSubstr("followed through 9 frames"));
  FrameStore store(data(), read_lidar_model(shipped_file("scenes/rigs/kitti64.toml")));
  DetectorPool picture;
  picture.push_back(std::make_unique<test::PictureStandIn>());
  EXPECT_THAT(error_text<InputError>([&] { judge_drive(picture, store, request()); }),
              HasSubstr("in the picture alone"));
}

/// Tracks by one number; detects nothing by itself.
class OneTrack : public test::StandInDetector {
 public:
  std::string name() const override { return "one track"; }
  Capabilities capabilities() const override {
    Capabilities can;
    can.reads_image = can.reads_points = false;
    can.remembers = remembers;
    can.reads = {kDetections};
    return can;
  }
  std::vector<Detection> forward(const SensorView& input, double, bool) override {
    const SensorData& told = input.others.at(0);
    EXPECT_EQ(told.values.size(), as_size(8 * told.shape[0]));
    EXPECT_EQ(input.frame->moment->sequence, "0000");
    continues.push_back(input.continues);
    std::vector<Detection> boxes;
    for (std::size_t i = 0; i < told.values.size(); i += 8) {
      const float* row = told.values.data() + i;
      boxes.push_back({BevBox{row[0], row[1], row[3], row[4], row[6]}, 1});
      boxes.back().identity = identity;
    }
    return boxes;
  }
  bool remembers = true;
  int identity = 5;
  std::vector<bool> continues;
};

TEST_F(Drives, ATrackerOfTheUsersConfirmsByItsOwnRule) {
  OneTrack tracker;
  DriveRequest asked = request();
  asked.tracker = &tracker;
  const nlohmann::json car = judged(asked).at("vehicles").at(0);
  EXPECT_NEAR(car.at("confirmed_s").at("clean").get<double>(), 0, 1e-12);  // the built-in tracker needs three
  EXPECT_EQ(car.at("strip").at("clean").at("track"), "ffffffff");
  // Three versions of the sequence, each from its start.
  ASSERT_EQ(tracker.continues.size(), 3u * kFrames);
  for (std::size_t i = 0; i < tracker.continues.size(); ++i)
    EXPECT_EQ(tracker.continues[i], i % kFrames != 0) << i;
  tracker.identity = -1;
  EXPECT_THAT(error_text<InputError>([&] { judged(asked); }), HasSubstr("identities: a box has none"));
  tracker.remembers = false;
  EXPECT_THAT(error_text<InputError>([&] { judged(asked); }), HasSubstr("remembers nothing"));
  test::StandInDetector none;
  asked.tracker = &none;
  EXPECT_THAT(error_text<InputError>([&] { judged(asked); }), HasSubstr("does not read detections alone"));
}

/// Finds the car from the second frame of a sequence on, and keeps its identity.
class Remembering : public test::StandInDetector {
 public:
  Capabilities capabilities() const override {
    Capabilities can;
    can.remembers = true;
    return can;
  }
  std::vector<Detection> forward(const SensorView& input, double threshold, bool keep) override {
    auto found = StandInDetector::forward(input, threshold, keep);
    for (Detection& one : found) one.identity = 3;
    points.push_back(input.points.size());
    return input.continues ? found : std::vector<Detection>();
  }
  std::vector<std::size_t> points;  ///< number of points in each pass
};

TEST_F(Drives, ADetectorThatRemembersSeesEveryFrameInItsOrder) {
  DetectorPool pool;
  for (int i = 0; i < 2; ++i) pool.push_back(std::make_unique<Remembering>());
  FrameStore store(data(), read_lidar_model(shipped_file("scenes/rigs/kitti64.toml")));
  const nlohmann::json car = to_json(judge_drive(pool, store, request())).at("vehicles").at(0);
  EXPECT_EQ(car.at("strip").at("clean").at("track"), "lfffffff");
  EXPECT_EQ(car.at("strip").at("clean").at("found"), "-fffffff");
  EXPECT_EQ(dynamic_cast<Remembering&>(*pool[0]).points.size(), 3u * kFrames);
}

TEST_F(Drives, SweepsBeforeTheFramesAreMovedByTheCarsPose) {
  const auto points_of = [&](int sweeps) {
    DetectorPool pool;
    pool.push_back(std::make_unique<Remembering>());
    FrameStore store(data(), read_lidar_model(shipped_file("scenes/rigs/kitti64.toml")));
    DriveRequest asked = request();
    asked.settings.sweeps = sweeps;
    judge_drive(pool, store, asked);
    return dynamic_cast<Remembering&>(*pool[0]).points;
  };
  const auto one = points_of(1), three = points_of(3);
  ASSERT_EQ(one.size(), three.size());
  for (std::size_t i = 0; i < one.size(); ++i) {
    std::size_t sum = 0;
    for (std::size_t k = i - std::min<std::size_t>(2, i % kFrames); k <= i; ++k) sum += one[k];
    EXPECT_EQ(three[i], sum) << i;
  }
}

/// Draws every pixel of the object white.
class White : public ObjectRenderer {
 public:
  Window draw(const HostInWorld&, const TexturedMesh&, const Simulated& simulated, std::uint64_t) override {
    ++drawn;
    Window window{simulated.rect, ImageF(simulated.rect.width(), simulated.rect.height(), 3)};
    for (float& value : window.picture.data) value = 1;
    return window;
  }
  nlohmann::json identity() const override { return "white"; }
  std::atomic<int> drawn = 0;
};

TEST_F(Drives, AnotherRendererDrawsTheObjectsOfTheVehiclesThatAreAskedFor) {
  White white;
  DriveRequest asked = request();
  asked.renderer = &white;
  asked.only = DriveVehicles{{"0000", 4}};
  asked.folder = folder_ / "vehicles";
  judged(asked);
  EXPECT_EQ(white.drawn, 2 * kFrames);  // the object and the random one
  const nlohmann::json file = read_json(asked.folder / "0000_4.json");
  for (const char* version : kDriveVersions) {
    const nlohmann::json& shown = file.at("shown").at(version);
    ASSERT_EQ(shown.at("boxes").size(), as_size(kFrames));
    EXPECT_EQ(shown.at("boxes").at(0).at(0).size(), 8u);
    EXPECT_EQ(shown.at("tracks").at(kFrames - 1).at(0).size(), 9u);
  }
  asked.only = DriveVehicles{{"0000", 5}};
  EXPECT_THAT(error_text<InputError>([&] { judged(asked); }), HasSubstr("no Car or Van"));
}

TEST(DriveByRenderer, KeptIsTheShareOfTheAddedGaps) {
  DriveResult plain, other;
  for (int i = 0; i < 3; ++i) {
    VehicleDrive one = vehicle("ffffffffff", "llffffffff");
    one.track = i;
    const auto hide = [&](VehicleDrive& of, int frames) {
      for (int k = 0; k < frames; ++k)
        of.frames[as_size(3 + k)].observations[as_size(DriveVersion::attacked)].found = false;
    };
    VehicleDrive in_plain = one, in_other = one;
    hide(in_plain, 2 * i);  // the first frame is not hidden
    hide(in_other, i);
    plain.vehicles.push_back(in_plain);
    if (i > 0) other.vehicles.push_back(in_other);
  }
  std::vector<int> order;
  for (const VehicleDrive* one : by_added_gap(plain.vehicles)) order.push_back(one->track);
  EXPECT_EQ(order, (std::vector<int>{2, 1, 0}));
  EXPECT_EQ(longest_hidden(plain, 5), (DriveVehicles{{"0003", 1}, {"0003", 2}}));
  EXPECT_EQ(longest_hidden(plain, 1), (DriveVehicles{{"0003", 2}}));
  const nlohmann::json json = by_renderer(other, plain);
  EXPECT_NEAR(json.at("kept").at("value").get<double>(), 0.5, 1e-9);
  EXPECT_EQ(json.at("vehicles").size(), 2u);
  EXPECT_NEAR(json.at("raster_gap_s").at("attacked").at("value").get<double>(), 0.3, 1e-9);
  EXPECT_NEAR(json.at("gap_s").at("attacked").at("value").get<double>(), 0.15, 1e-9);
}

}  // namespace
}  // namespace mirage
