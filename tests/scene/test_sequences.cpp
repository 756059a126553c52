// Sequences: times of frames, poses of the ego vehicle, and velocities of labelled vehicles, in each layout
// that has them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "base/error.h"
#include "base/files.h"
#include "base/sizes.h"
#include "base/types.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/layouts.h"
#include "scene/data/read_frames.h"
#include "support/files.h"
#include "support/layouts.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;

constexpr int kFrames = 4;
constexpr double kStep = 0.1, kHeading = 0.3, kSpeed = 8;  // s, rad, m/s of the ego vehicle
const Vec3d kOther(-5, 1, 0);                              // m/s in the world, of the labelled car

/// The ego vehicle's pose in the world (east, north).
Transform world_from_ego(int i) {
  Transform pose = Transform::Identity();
  pose.linear() = Eigen::AngleAxisd(kHeading, Vec3d::UnitZ()).toRotationMatrix();
  pose.translation() = kSpeed * kStep * i * Vec3d(std::cos(kHeading), std::sin(kHeading), 0);
  return pose;
}

std::vector<Frame> drive_frames() {
  std::vector<Frame> all;
  for (int i = 0; i < kFrames; ++i) {
    Frame frame;
    frame.id = std::to_string(i);
    frame.calibration.camera = {144, 144, 122, 35, 248, 75};
    Eigen::Matrix3d axes;
    axes << 0, -1, 0, 0, 0, -1, 1, 0, 0;
    frame.calibration.camera_from_velo.linear() = axes;
    frame.calibration.camera_from_velo.translation() = Vec3d(0, -0.08, -0.27);
    frame.image = ImageF(248, 75, 3, 0.3f);
    for (int k = 0; k < 8; ++k) frame.sweep.push_back({10.f + static_cast<float>(k), 1, -1, 0.3f});
    const Vec3d start = world_from_ego(0) * Vec3d(25, 2, -1.7);
    const Vec3d at = world_from_ego(i).inverse() * (start + kStep * i * kOther);
    Label car;
    car.type = "Van";
    car.box = {{at.x(), at.y(), 4, 1.8, 0.1}, at.z(), 1.5};
    const auto seen = projected(car.box, frame.calibration);
    car.left = seen->left, car.top = seen->top, car.right = seen->right, car.bottom = seen->bottom;
    car.track = 3;
    frame.labels = {car};
    all.push_back(frame);
  }
  return all;
}

/// The OXTS row of a car at that pose in the world, with its unit at the LiDAR.
std::string oxts(int i) {
  constexpr double kRadius = 6378137, kLatitude = 49.01, kLongitude = 8.43;
  const double scale = kRadius * std::cos(kLatitude * kDegree);
  const Vec3d place = world_from_ego(i).translation();
  const double north = scale * std::log(std::tan((90 + kLatitude) * std::numbers::pi / 360)) + place.y();
  std::string row = fmt::format("{:.15g} {:.15g} 112.5 0 0 {:.15g}",
                                360 / std::numbers::pi * std::atan(std::exp(north / scale)) - 90,
                                kLongitude + place.x() / (scale * kDegree), kHeading);
  for (int n = 6; n < 30; ++n) row += " 0";
  return row + "\n";
}

constexpr const char* kImu = "1 0 0 0 0 1 0 0 0 0 1 0";

void write_tracking_drive(const std::filesystem::path& data) {
  test::write_tracking(data, drive_frames());
  const auto calibration = data / "training/calib/0000.txt";
  write_file(calibration, read_file(calibration) + "Tr_imu_velo " + kImu + "\n");
  std::string rows;
  for (int i = 0; i < kFrames; ++i) rows += oxts(i);
  write_file(data / "training/oxts/0000.txt", rows);
}

void write_raw_drive(const std::filesystem::path& data) {
  test::write_raw(data, drive_frames());
  const auto drive = data / "2011_09_26_drive_0001_sync";
  write_file(data / "calib_imu_to_velo.txt", "R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n");
  std::string stamps, poses;
  for (int i = 0; i < kFrames; ++i) {
    write_file(drive / fmt::format("oxts/data/{:010}.txt", i), oxts(i));
    stamps += fmt::format("2011-09-26 23:59:59.{:09}\n", 100000000 * i);
    const Box3 box = drive_frames()[as_size(i)].labels[0].box;
    poses += fmt::format(
        "<item><tx>{:.17g}</tx><ty>{:.17g}</ty><tz>{:.17g}</tz><rx>0</rx><ry>0</ry><rz>{:.17g}</rz>"
        "<state>2</state><occlusion>0</occlusion><truncation>0</truncation></item>",
        box.bev.x, box.bev.y, box.bottom, box.bev.yaw);
  }
  write_file(drive / "velodyne_points/timestamps.txt", stamps);
  write_file(drive / "tracklet_labels.xml",
             "<boost_serialization><tracklets><item><objectType>Van</objectType><h>1.5</h><w>1.8</w><l>4</l>"
             "<first_frame>0</first_frame><poses>" +
                 poses + "</poses></item></tracklets></boost_serialization>");
}

void write_nuscenes_scene(const std::filesystem::path& data) {
  test::write_nuscenes(data, drive_frames());
  const auto tables = data / "v1.0-mini";
  // All annotations are of one instance; the samples are 0.1 s apart.
  nlohmann::json annotations = read_json(tables / "sample_annotation.json"),
                 samples = nlohmann::json::array();
  for (auto& row : annotations) row["instance_token"] = "instance-0000-00";
  for (int i = 0; i < kFrames; ++i)
    samples.push_back({{"token", fmt::format("sample{}", i)},
                       {"timestamp", 1532402927000000 + 100000 * i},
                       {"scene_token", "scene"}});
  write_json(tables / "sample_annotation.json", annotations);
  write_json(tables / "sample.json", samples);
  write_json(tables / "scene.json", nlohmann::json::array({{{"token", "scene"}, {"name", "scene-0061"}}}));
}

/// The scene with sweeps between key frames: the second and third of its four frames. The ego vehicle drives
/// straight ahead, and the car ahead turns; the third sweep has no picture of its time.
void write_nuscenes_between(const std::filesystem::path& data) {
  write_nuscenes_scene(data);
  const auto tables = data / "v1.0-mini";
  nlohmann::json rows = nlohmann::json::array(), annotations = nlohmann::json::array(),
                 samples = nlohmann::json::array();
  for (auto row : read_json(tables / "sample_data.json")) {
    const auto token = row["token"].get<std::string>();  // "lidar-1"
    const int i = token.back() - '0';
    row["timestamp"] = 1532402927000000 + 100000 * i;
    if (i == 1 || i == 2) row["is_key_frame"] = false, row["sample_token"] = "sample3";
    if (token != "camera-2") rows.push_back(row);
  }
  const auto at_key = [](const nlohmann::json& row, const char* field) {
    const char last = row[field].get<std::string>().back();
    return last == '0' || last == '3';
  };
  const auto turned = [](double yaw) -> nlohmann::json {
    return {std::cos(yaw / 2), 0, 0, std::sin(yaw / 2)};
  };
  for (auto row : read_json(tables / "sample_annotation.json")) {
    if (!at_key(row, "sample_token")) continue;
    const bool later = row["sample_token"] == "sample3";
    row["translation"] = {1035.0 - 2 * later, 612.0 + later, 1.0};
    row["rotation"] = turned(later ? 0.5 : 0.1);
    annotations.push_back(row);
  }
  nlohmann::json poses = read_json(tables / "ego_pose.json");
  for (auto& row : poses) {
    row["translation"] = {1010.0 + 2 * (row["token"].get<std::string>().back() - '0'), 611.0, 0.0};
    row["rotation"] = turned(0);
  }
  write_json(tables / "ego_pose.json", poses);
  for (const auto& row : read_json(tables / "sample.json"))
    if (at_key(row, "token")) samples.push_back(row);
  write_json(tables / "sample_data.json", rows);
  write_json(tables / "sample_annotation.json", annotations);
  write_json(tables / "sample.json", samples);
}

struct DriveLayout {
  const char* sequence;
  const char* category;
  void (*write)(const std::filesystem::path&);
};
class Sequences : public testing::TestWithParam<DriveLayout> {
 protected:
  Sequences() { GetParam().write(folder_.path()); }
  TemporaryFolder folder_;
};

TEST_P(Sequences, SayWhenAndWhereEachFrameWasTaken) {
  const auto sequences = read_sequences(folder_.path());
  ASSERT_EQ(sequences.size(), 1u);
  EXPECT_EQ(sequences[0].name, GetParam().sequence);
  ASSERT_EQ(sequences[0].frames.size(), as_size(kFrames));
  for (int i = 0; i < kFrames; ++i) {
    const auto& [id, moment] = sequences[0].frames[as_size(i)];
    EXPECT_EQ(moment.index, i);
    EXPECT_NEAR(moment.time, kStep * i, 1e-6);
    const Frame frame = read_frame(folder_.path(), id);
    ASSERT_TRUE(frame.moment);
    EXPECT_TRUE(frame.moment->world_from_ego.isApprox(moment.world_from_ego));
    EXPECT_EQ(frame.labels.at(0).category, GetParam().category);
  }
}

TEST_P(Sequences, AVelocityIsTheDifferenceOfPlacesInTheWorld) {
  const auto sequence = read_sequences(folder_.path()).at(0).frames;
  std::vector<Vec3d> places;
  for (const auto& [id, moment] : sequence) {
    const Box3 box = read_frame(folder_.path(), id).labels.at(0).box;
    places.push_back(moment.world_from_ego * Vec3d(box.bev.x, box.bev.y, box.bottom + box.height / 2));
  }
  for (int i = 0; i < kFrames; ++i) {
    const auto& [id, moment] = sequence[as_size(i)];
    const auto velocity = read_frame(folder_.path(), id).labels.at(0).velocity;
    ASSERT_TRUE(velocity) << i;
    const int before = std::max(0, i - 1), after = std::min(kFrames - 1, i + 1);
    const Vec3d expected = (places[as_size(after)] - places[as_size(before)]) / (kStep * (after - before));
    EXPECT_LT((moment.world_from_ego.linear() * *velocity - expected).norm(), 3e-6);
  }
}

TEST_P(Sequences, APartIsAskedForByNameAndNumbers) {
  const auto part = [&](const std::string& sequence, const std::string& range) {
    return read_sequences(folder_.path(), {sequence, range});
  };
  EXPECT_EQ(part(GetParam().sequence, "1:2").at(0).frames.size(), 2u);
  EXPECT_EQ(part("", "2:").at(0).frames.size(), 2u);
  EXPECT_EQ(part("", ":0").at(0).frames.size(), 1u);
  EXPECT_THAT(error_text<InputError>([&] { part("other", ""); }),
              AllOf(HasSubstr("sequence"), HasSubstr(GetParam().sequence)));
  EXPECT_THAT(error_text<InputError>([&] { part("", "90:"); }), HasSubstr("no sequence has a frame"));
  for (const char* bad : {"5", "3:1", "a:b", "-1:2", "1:2:3"})
    EXPECT_THAT(error_text<InputError>([&] { part("", bad); }), HasSubstr("not a range")) << bad;
}

INSTANTIATE_TEST_SUITE_P(All, Sequences,
                         testing::Values(DriveLayout{"0000", "Van", write_tracking_drive},
                                         DriveLayout{"2011_09_26_drive_0001_sync", "Van", write_raw_drive},
                                         DriveLayout{"scene-0061", "vehicle.emergency.ambulance",
                                                     write_nuscenes_scene}));

TEST(Between, SweepsOfNuScenesAreFramesWithBoxesOnTheWay) {
  TemporaryFolder folder;
  write_nuscenes_between(folder.path());
  SequencePart part;
  EXPECT_EQ(read_sequences(folder.path(), part).at(0).frames.size(), 2u);
  part.between = true;
  const auto frames = read_sequences(folder.path(), part).at(0).frames;
  ASSERT_EQ(frames.size(), 4u);
  std::vector<std::string> ids;
  for (const auto& [id, moment] : frames) ids.push_back(id);
  EXPECT_EQ(ids, (std::vector<std::string>{"sample0", "lidar-1", "lidar-2", "sample3"}));
  std::vector<Vec3d> places;
  std::vector<double> headings;
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_NEAR(frames[i].moment.time, kStep * static_cast<double>(i), 1e-6);
    const Frame frame = read_frame(folder.path(), ids[i]);
    ASSERT_EQ(frame.labels.size(), 1u) << ids[i];
    const Box3& box = frame.labels[0].box;
    places.push_back(frame.moment->world_from_ego * Vec3d(box.bev.x, box.bev.y, box.bottom + box.height / 2));
    const Vec3d along(std::cos(box.bev.yaw), std::sin(box.bev.yaw), 0);
    const Vec3d in_world = frame.moment->world_from_ego.linear() * along;
    headings.push_back(std::atan2(in_world.y(), in_world.x()));
    EXPECT_EQ(frame.sweep.size(), drive_frames()[i].sweep.size());
  }
  const double turn = std::remainder(headings[3] - headings[0], 2 * std::numbers::pi);
  EXPECT_GT(std::abs(turn), 0.1);
  for (std::size_t i = 1; i < 3; ++i) {
    const double share = static_cast<double>(i) / 3;
    EXPECT_LT((places[i] - (places[0] + share * (places[3] - places[0]))).norm(), 1e-6);
    EXPECT_NEAR(std::remainder(headings[i] - headings[0] - share * turn, 2 * std::numbers::pi), 0, 1e-3);
  }
  // The picture nearest in time, at its own pose: sweep 2 has no picture of its time and gets sample 3's.
  const auto set = open_data_set(folder.path());
  const auto picture = [&](std::size_t i) {
    return set->source_files(ids[i]).at(1).file.filename().string();
  };
  EXPECT_EQ(picture(1), "1.png");
  EXPECT_EQ(picture(2), "3.png");
  const auto place = [&](std::size_t i) { return read_frame(folder.path(), ids[i]).calibration; };
  EXPECT_GT((place(2).camera_from_velo.translation() - place(1).camera_from_velo.translation()).norm(), 1);
  // Neighbours are the next sweeps, and velocity is the displacement between them over time.
  EXPECT_EQ(set->beside("lidar-1", 1), "lidar-2");
  EXPECT_EQ(set->beside("lidar-1", -1), "sample0");
  EXPECT_EQ(set->beside("sample0", 1), "sample3");
  EXPECT_EQ(set->beside("lidar-2", 2), std::nullopt);
  const Frame middle = read_frame(folder.path(), "lidar-1");
  ASSERT_TRUE(middle.labels[0].velocity);
  EXPECT_LT((middle.moment->world_from_ego.linear() * *middle.labels[0].velocity -
             (places[3] - places[0]) / (3 * kStep))
                .norm(),
            1e-4);
  EXPECT_THAT(error_text<InputError>([&] { read_frame(folder.path(), "lidar-9"); }),
              HasSubstr("no such frame; use sample0 or sample3"));
  const auto sweep = set->source_files("lidar-1").at(0).file;
  write_file(sweep, read_file(sweep).substr(0, 20 * 3 + 1));
  EXPECT_THAT(error_text<InputError>([&] { read_frame(folder.path(), "lidar-1"); }),
              AllOf(HasSubstr(sweep.filename().string()), HasSubstr("truncated")));
}

// Detectors get it (SensorView::moment), and their answers are cached.
TEST(Moments, AreOfAFramesContent) {
  TemporaryFolder folder;
  write_raw_drive(folder.path());
  const std::string id = list_frames(folder.path()).at(1), before = open_data_set(folder.path())->hash(id);
  const auto drive = folder / "2011_09_26_drive_0001_sync";
  const auto stamps = drive / "velodyne_points/timestamps.txt", pose = drive / "oxts/data/0000000001.txt";
  const std::string times = read_file(stamps), row = read_file(pose);
  std::string late = times;
  late.replace(late.find("59.100000000"), 12, "59.150000000");
  write_file(stamps, late);
  EXPECT_NE(open_data_set(folder.path())->hash(id), before);
  write_file(stamps, times);
  write_file(pose, read_file(drive / "oxts/data/0000000002.txt"));
  EXPECT_NE(open_data_set(folder.path())->hash(id), before);
  write_file(pose, row);
  EXPECT_EQ(open_data_set(folder.path())->hash(id), before);
}

// Part of a data set is a data set, too.
TEST(Velocities, AreOfTheNeighboursThatAreThere) {
  TemporaryFolder folder;
  write_raw_drive(folder.path());
  const std::vector<std::string> ids = list_frames(folder.path());
  const auto poses = folder / "2011_09_26_drive_0001_sync/oxts/data";
  ASSERT_TRUE(read_frame(folder.path(), ids[1]).labels.at(0).velocity);
  std::filesystem::remove(poses / "0000000002.txt");
  EXPECT_TRUE(read_frame(folder.path(), ids[1]).labels.at(0).velocity) << "of the frame before";
  EXPECT_THAT(error_text<InputError>([&] { read_frame(folder.path(), ids[2]); }),
              HasSubstr("0000000002.txt"));
}

TEST(Oxts, PosesAndVelocitiesAreTheWorlds) {
  TemporaryFolder folder;
  write_tracking_drive(folder.path());
  for (int i = 0; i < kFrames; ++i) {
    const Frame frame = read_frame(folder.path(), fmt::format("0000_{:06}", i));
    EXPECT_LT((frame.moment->world_from_ego.matrix() - world_from_ego(i).matrix()).cwiseAbs().maxCoeff(),
              1e-4);
    const Vec3d velocity = frame.moment->world_from_ego.linear() * *frame.labels.at(0).velocity;
    EXPECT_LT((velocity - kOther).norm(), 2e-3) << i;
  }
}

TEST(Oxts, TheUnitsMountIsTakenOff) {
  const OxtsRow row{49, 8.4, 110, 0.01, -0.02, 1.2};
  const Transform world = world_from_imu(row, row);
  EXPECT_LT(world.translation().norm(), 1e-9);
  // Pitch is about the left axis: positive is down. Roll is about the forward axis: positive is left side up.
  EXPECT_GT((world.linear() * Vec3d::UnitX()).z(), 0.019);
  EXPECT_GT((world.linear() * Vec3d::UnitY()).z(), 0.009);
  TemporaryFolder folder;
  write_tracking_drive(folder.path());
  const auto calibration = folder / "training/calib/0000.txt";
  std::string text = read_file(calibration);
  text.replace(text.find(kImu), std::string(kImu).size(), "1 0 0 -0.8 0 1 0 0.3 0 0 1 -0.8");
  write_file(calibration, text);
  const auto moment = open_data_set(folder.path())->moment("0000_000000");
  EXPECT_LT((moment->world_from_ego.inverse().translation() - Vec3d(-0.8, 0.3, -0.8)).norm(), 1e-9);
}

TEST(Oxts, RefusesWhatIsNoPoseAndNoTime) {
  TemporaryFolder folder;
  write_tracking_drive(folder.path());
  const auto file = folder / "training/oxts/0000.txt";
  const std::string good = read_file(file);
  const auto said = [&](const std::string& text) {
    write_file(file, text);
    return error_text<InputError>([&] { read_sequences(folder.path()); });
  };
  EXPECT_THAT(said(oxts(0)), AllOf(HasSubstr("0000.txt"), HasSubstr("row 2"), HasSubstr("missing")));
  EXPECT_THAT(said("49 8\n" + good), AllOf(HasSubstr("row 1"), HasSubstr("2 numbers where 30 belong")));
  EXPECT_THAT(said("x" + good), AllOf(HasSubstr("row 1"), HasSubstr("number 1")));
  EXPECT_THAT(said("9" + good), AllOf(HasSubstr("row 1"), HasSubstr("not a place on a road")));
  write_file(file, good);
  write_file(folder / "training/times/0000.txt", "2011-09-26 13:02:25.5\n2011-13-26 13:02:25.6\n");
  EXPECT_THAT(error_text<InputError>([&] { read_sequences(folder.path()); }),
              AllOf(HasSubstr("times"), HasSubstr("row 2"), HasSubstr("not a time")));
  write_file(folder / "training/times/0000.txt",
             "2011-09-26 23:59:59.5\n2011-09-27 00:00:00.25\n2011-09-27 00:00:00.25\n2011-09-27 00:00:01\n");
  EXPECT_THAT(error_text<InputError>([&] { read_sequences(folder.path()); }),
              AllOf(HasSubstr("0000_000002"), HasSubstr("at the time of 0000_000001")));
  EXPECT_NEAR(open_data_set(folder.path())->moment("0000_000001")->time, 0.75, 1e-6);
  write_file(folder / "training/times/0000.txt",
             "2011-09-27 00:00:00\n2011-09-27 00:00:02\n2011-09-27 00:00:01\n2011-09-27 00:00:03\n");
  EXPECT_THAT(error_text<InputError>([&] { read_sequences(folder.path()); }),
              AllOf(HasSubstr("0000_000002"), HasSubstr("was taken before 0000_000001")));
}

TEST(SequencesOfASet, WithoutPosesAreRefused) {
  TemporaryFolder folder;
  test::write_tracking(folder.path(), drive_frames());
  EXPECT_FALSE(read_frame(folder.path(), "0000_000000").moment);
  EXPECT_FALSE(read_frame(folder.path(), "0000_000000").labels.at(0).velocity);
  EXPECT_THAT(error_text<InputError>([&] { read_sequences(folder.path()); }),
              HasSubstr("says of no frame when it was taken"));
}

}  // namespace
}  // namespace mirage
