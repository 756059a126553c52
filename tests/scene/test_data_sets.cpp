// The layouts other than KITTI's object benchmark, on generated frames written in each of them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <set>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/sizes.h"
#include "scene/data/data_rig.h"
#include "scene/data/kitti_rows.h"
#include "scene/data/layouts.h"
#include "scene/data/read_frames.h"
#include "support/files.h"
#include "support/layouts.h"
#include "support/small_rig.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

const std::vector<Frame>& frames() {
  static const std::vector<Frame> made = [] {
    std::vector<Frame> two;
    for (std::size_t i = 0; i < 2; ++i) {
      Frame frame = generate_frame(test::small_rig(), 5, i);
      for (std::size_t k = 0; k < frame.labels.size(); ++k) frame.labels[k].track = static_cast<int>(k);
      two.push_back(std::move(frame));
    }
    return two;
  }();
  return made;
}

struct Layout {
  const char* name;
  void (*write)(const std::filesystem::path&, const std::vector<Frame>&);
  std::vector<std::string> ids;
  const char* rig;
  double accuracy;  // of positions (m) and reflectances: the resolution of the layout's numbers
};

const Layout kLayouts[] = {
    {"kitti-tracking", test::write_tracking, {"0000_000000", "0000_000001"}, "kitti64", 2e-6},
    {"kitti-raw",
     test::write_raw,
     {"2011_09_26_drive_0001_sync_0000000000", "2011_09_26_drive_0001_sync_0000000001"},
     "kitti64",
     2e-6},
    {"nuscenes", test::write_nuscenes, {"sample0", "sample1"}, "nuscenes", 2e-5}};

class DataSets : public testing::TestWithParam<Layout> {
 protected:
  DataSets() { GetParam().write(folder_.path(), frames()); }
  TemporaryFolder folder_;
};

// A tag of four bytes takes 165 bytes of memory.
TEST(Tracklets, MoreTagsThanAnyDriveHasAreRefused) {
  TemporaryFolder folder;
  std::string text = "<boost_serialization><tracklets>";
  for (int i = 0; i < 1000000; ++i) text += "<a/>";
  write_file(folder / "tags.xml", text + "</tracklets></boost_serialization>");
  EXPECT_THAT(error_text<InputError>([&] { read_tracklets(folder / "tags.xml", 0, 0, Calibration()); }),
              AllOf(HasSubstr("tags.xml"), HasSubstr("more than 400000 tags")));
}

TEST_P(DataSets, IsKnownByItsFolder) {
  const auto set = open_data_set(folder_.path());
  EXPECT_STREQ(set->layout(), GetParam().name);
  EXPECT_EQ(set->frames(), GetParam().ids);
  EXPECT_EQ(data_rig(folder_.path()), GetParam().rig);
  EXPECT_EQ(recorded_lidar_effects(folder_.path()),
            std::string(GetParam().rig) == "kitti64" ? "noise,dark-loss,divergence" : "unit");
  const std::string rig = read_file(shipped_file("scenes/rigs/xenith.toml"));
  write_file(folder_ / "rig.toml", rig);
  EXPECT_EQ(recorded_lidar_effects(folder_.path()), "unit");
  std::string told = rig;
  write_file(folder_ / "rig.toml",
             told.replace(told.find("[lidar]"), 7, "[lidar]\nrecorded_effects = \"noise\""));
  EXPECT_EQ(recorded_lidar_effects(folder_.path()), "noise");
  const TemporaryFolder other;
  write_file(other / "mine.toml", rig);
  EXPECT_EQ(recorded_lidar_effects(folder_.path(), other / "mine.toml"), "unit");
  write_file(folder_ / "dataset.json", R"({"rig": "xenith"})");
  EXPECT_EQ(data_rig(folder_.path()), "xenith");
}

TEST_P(DataSets, GivesTheFrameThatWasWritten) {
  int cars = 0;
  for (std::size_t i = 0; i < frames().size(); ++i) {
    const Frame& meant = frames()[i];
    const Frame frame = read_frame(folder_.path(), GetParam().ids[i]);
    EXPECT_EQ(frame.id, GetParam().ids[i]);
    ASSERT_EQ(frame.sweep.size(), meant.sweep.size());
    for (std::size_t k = 0; k < frame.sweep.size(); ++k) {
      ASSERT_LT((frame.sweep[k].position() - meant.sweep[k].position()).norm(), GetParam().accuracy);
      ASSERT_NEAR(frame.sweep[k].reflectance, meant.sweep[k].reflectance, GetParam().accuracy);
    }
    const auto file = folder_ / "as-kitti";
    write_frame(file, meant);
    EXPECT_EQ(frame.image.data, read_frame(file, meant.id).image.data);
    EXPECT_LT((frame.calibration.camera_from_velo.matrix() - meant.calibration.camera_from_velo.matrix())
                  .cwiseAbs()
                  .maxCoeff(),
              1e-9);
    EXPECT_DOUBLE_EQ(frame.calibration.camera.fx, meant.calibration.camera.fx);
    EXPECT_DOUBLE_EQ(frame.calibration.camera.cy, meant.calibration.camera.cy);
    // Sets without boxes in the picture leave out labels that the camera does not see.
    std::vector<Label> seen;
    for (const Label& label : meant.labels)
      if (projected(label.box, meant.calibration)) seen.push_back(label);
    ASSERT_EQ(frame.labels.size(), seen.size());
    for (std::size_t k = 0; k < seen.size(); ++k) {
      const Label &read = frame.labels[k], &known = seen[k];
      EXPECT_EQ(read.type, known.type);
      EXPECT_EQ(read.occluded, known.occluded);
      EXPECT_NEAR(read.box.bev.x, known.box.bev.x, GetParam().accuracy);
      EXPECT_NEAR(read.box.bev.y, known.box.bev.y, GetParam().accuracy);
      EXPECT_NEAR(read.box.bottom, known.box.bottom, GetParam().accuracy);
      EXPECT_NEAR(read.box.height, known.box.height, 1e-6);
      EXPECT_NEAR(read.box.bev.length, known.box.bev.length, 1e-6);
      EXPECT_NEAR(read.box.bev.width, known.box.bev.width, 1e-6);
      EXPECT_NEAR(std::remainder(read.box.bev.yaw - known.box.bev.yaw, 2 * std::numbers::pi), 0, 2e-6);
      EXPECT_GE(read.track, 0);
      cars += read.type == "Car";
    }
  }
  EXPECT_GE(cars, 4);  // otherwise the loop above compares nothing
}

TEST_P(DataSets, TellsVehiclesApart) {
  std::vector<int> all;
  for (const std::string& id : GetParam().ids) {
    const auto tracks = open_data_set(folder_.path())->tracks(id);
    all.insert(all.end(), tracks.value().begin(), tracks.value().end());
  }
  std::sort(all.begin(), all.end());
  const bool differ = std::adjacent_find(all.begin(), all.end()) == all.end();
  // In the tracking benchmark a number identifies one vehicle in the whole sequence.
  EXPECT_EQ(differ, std::string(GetParam().name) != "kitti-tracking");
}

TEST_P(DataSets, HashTellsOfWhatChanged) {
  const std::string id = GetParam().ids[0], before = open_data_set(folder_.path())->hash(id);
  EXPECT_EQ(open_data_set(folder_.path())->hash(id), before);
  std::vector<Frame> edited = frames();
  edited[0].labels.at(0).box.bev.x += 0.5;
  TemporaryFolder other;
  GetParam().write(other.path(), edited);
  EXPECT_NE(open_data_set(other.path())->hash(id), before);
  edited = frames();
  edited[0].sweep.pop_back();
  GetParam().write(other.path(), edited);
  EXPECT_NE(open_data_set(other.path())->hash(id), before);
}

TEST_P(DataSets, MissingAndDamagedFilesAreNamed) {
  const auto set = open_data_set(folder_.path());
  const std::string id = GetParam().ids[1];
  const auto one_line = AllOf(Not(HasSubstr("\n")));
  for (const DataSet::SourceFile& part : set->source_files(id)) {
    const std::string whole = read_file(part.file);
    std::filesystem::remove(part.file);
    if (std::string(part.what) == "the labels") {  // an unlabelled frame
      EXPECT_FALSE(set->read(id).labelled);
    } else
      EXPECT_THAT(error_text<InputError>([&] { set->read(id); }),
                  AllOf(HasSubstr(part.file.filename().string()), HasSubstr("missing"), one_line));
    write_file(part.file, whole.substr(0, whole.size() / 2 + 1));
    EXPECT_THAT(error_text<InputError>([&] { set->read(id); }),
                AllOf(HasSubstr(part.file.filename().string()), one_line));
    write_file(part.file, whole);
  }
  EXPECT_NO_THROW(set->read(id));
  for (const char* none : {"", "no", "../x_1", "0000_99x", "a_b_1"})
    EXPECT_THAT(error_text<InputError>([&] { set->read(none); }), one_line) << none;
}

INSTANTIATE_TEST_SUITE_P(, DataSets, testing::ValuesIn(kLayouts), [](const auto& one) {
  std::string name = one.param.name;
  name.erase(std::remove(name.begin(), name.end(), '-'), name.end());
  return name;
});

TEST(DataSet, IsKittisObjectBenchmarkElse) {
  const TemporaryFolder folder;
  EXPECT_STREQ(open_data_set(folder.path())->layout(), "kitti-object");
  EXPECT_THAT(error_text<InputError>([&] { list_frames(folder.path()); }),
              AllOf(HasSubstr("training/velodyne"), HasSubstr("nuScenes"), HasSubstr("holds nothing")));
  EXPECT_STREQ(open_data_set(folder / "nothing")->layout(), "kitti-object");
}

TEST(KittiTracking, TruncationIsTheObjectBenchmarks) {
  const TemporaryFolder folder;
  std::vector<Frame> edited = {frames()[0]};
  ASSERT_GE(edited[0].labels.size(), 3u);
  edited[0].labels[0].truncated = 0, edited[0].labels[1].truncated = 0.2, edited[0].labels[2].truncated = 0.9;
  test::write_tracking(folder.path(), edited);
  const auto labels = read_annotations(folder.path(), "0000_000000").labels;
  EXPECT_EQ(labels[0].truncated, 0);
  EXPECT_EQ(labels[1].truncated, 0.3);
  EXPECT_EQ(labels[2].truncated, 0.8);
}

// Vehicles of two sequences are different, whatever the sequences are called.
TEST(KittiTracking, SequencesWithoutANumberHaveVehiclesOfTheirOwn) {
  const TemporaryFolder folder;
  test::write_tracking(folder.path(), frames());
  for (const char* kind : {"image_02", "velodyne", "calib", "label_02"}) {
    const auto part = folder / "training" / kind;
    const std::string end = std::filesystem::exists(part / "0000.txt") ? ".txt" : "";
    for (const char* name : {"alpha", "beta"})
      std::filesystem::copy(part / ("0000" + end), part / (name + end),
                            std::filesystem::copy_options::recursive);
  }
  std::set<int> groups;
  for (const char* id : {"0000_000000", "alpha_000000", "beta_000000"})
    groups.insert(open_data_set(folder.path())->tracks(id)->front());
  EXPECT_EQ(groups.size(), 3u);
}

TEST(KittiTracking, AVehicleStandsOnceInAFrame) {
  const TemporaryFolder folder;
  test::write_tracking(folder.path(), frames());
  const auto file = folder / "training/label_02/0000.txt";
  const std::string rows = read_file(file), first = rows.substr(0, rows.find('\n') + 1);
  const auto error = [&](const std::string& more) {
    write_file(file, rows + more);
    return error_text<InputError>([&] { read_frame(folder.path(), "0000_000000"); });
  };
  EXPECT_THAT(error(first), AllOf(HasSubstr("0000.txt"), HasSubstr("identity")));
  EXPECT_THAT(error("0 99" + first.substr(first.find(' ', 2))),
              AllOf(HasSubstr("0000.txt"), HasSubstr("stands where one of an earlier row does")));
}

TEST(KittiRaw, DaysMayLieInOneFolder) {
  const TemporaryFolder folder;
  test::write_raw(folder / "2011_09_26", frames());
  const auto set = open_data_set(folder.path());
  EXPECT_STREQ(set->layout(), "kitti-raw");
  EXPECT_EQ(set->frames().size(), 2u);
  EXPECT_NO_THROW(set->read(set->frames()[1]));
}

TEST(KittiRaw, TruncationIsWhatThePictureCutsOff) {
  const TemporaryFolder folder;
  std::vector<Frame> edited = {frames()[0]};
  Label& label = edited[0].labels.at(0);
  label.box.bev = {6, 6.0, 4, 1.7, 0};  // the small rig's camera sees 40 degrees to each side
  test::write_raw(folder.path(), edited);
  const Label read = read_annotations(folder.path(), open_data_set(folder.path())->frames()[0]).labels.at(0);
  EXPECT_GT(read.truncated, 0.1);
  EXPECT_LT(read.truncated, 0.95);
  EXPECT_EQ(read.left, 0);
}

TEST(NuScenes, NamesNoFileOutsideItsFolder) {
  const TemporaryFolder folder;
  test::write_nuscenes(folder / "set", frames());
  const auto table = folder / "set" / "v1.0-mini" / "sample_data.json";
  const nlohmann::json good = read_json(table);
  for (const char* name : {"/etc/passwd", "../secret.png", "samples/../../secret.png", ""}) {
    nlohmann::json bad = good;
    bad[1]["filename"] = name;
    write_json(table, bad);
    EXPECT_THAT(error_text<InputError>([&] { list_frames(folder / "set"); }),
                AllOf(HasSubstr("sample_data.json"), HasSubstr("[1].filename")));
  }
}

TEST(NuScenes, FieldsAreChecked) {
  const TemporaryFolder folder;
  test::write_nuscenes(folder.path(), frames());
  const auto bad = [&](const char* name, const char* key, const nlohmann::json& value) {
    const auto table = folder / "v1.0-mini" / (std::string(name) + ".json");
    const nlohmann::json good = read_json(table);
    nlohmann::json edited = good;
    edited[0][key] = value;
    write_json(table, edited);
    const std::string error = error_text<InputError>([&] { read_frame(folder.path(), "sample0"); });
    EXPECT_THAT(error, AllOf(HasSubstr(std::string(name) + ".json"), HasSubstr(key), Not(HasSubstr("\n"))));
    write_json(table, good);
  };
  bad("ego_pose", "rotation", {1, 1, 0, 0});
  bad("ego_pose", "translation", {1, 2});
  bad("calibrated_sensor", "rotation", "none");
  bad("sample_data", "is_key_frame", 1);
  bad("sample_data", "sample_token", "a/b");
  bad("sample_annotation", "size", {-1, 2, 3});
  bad("sample_annotation", "instance_token", "nobody");
  bad("instance", "category_token", "nothing");
  const auto twice = [&](const char* name, const char* key) {
    const auto table = folder / "v1.0-mini" / (std::string(name) + ".json");
    const nlohmann::json good = read_json(table);
    nlohmann::json edited = good;
    edited.push_back(good.front());
    edited.back()["token"] = "another";
    write_json(table, edited);
    EXPECT_THAT(error_text<InputError>([&] { read_frame(folder.path(), "sample0"); }),
                AllOf(HasSubstr(std::string(name) + ".json"), HasSubstr(key), HasSubstr("another")));
    write_json(table, good);
  };
  twice("sample_annotation", "instance_token");
  twice("sample_data", "sample_token");
  EXPECT_NO_THROW(read_frame(folder.path(), "sample0"));
}

TEST(NuScenes, AllCamerasWithTheLabelsThatOnlyTheySee) {
  const TemporaryFolder folder;
  const Frame meant = test::surround_frame(test::small_rig(), 5, 0);
  test::write_nuscenes(folder.path(), {meant});
  const Frame first = read_frame(folder.path(), "sample0"),
              all = read_frame(folder.path(), "sample0", Cameras::all);
  EXPECT_EQ(first.camera, "CAM_FRONT");
  EXPECT_TRUE(first.others.empty());
  ASSERT_EQ(all.others.size(), 2u);
  EXPECT_EQ(all.image.data, first.image.data);
  EXPECT_EQ(all.sweep.size(), first.sweep.size());
  for (std::size_t k = 1; k < all.cameras(); ++k) {
    EXPECT_EQ(all.name_of(k), meant.name_of(k));
    EXPECT_NEAR(
        (all.calibration_of(k).camera_from_velo.matrix() - meant.calibration_of(k).camera_from_velo.matrix())
            .norm(),
        0, 1e-9);
    const TemporaryFolder written;
    write_srgb(written / "x.png", meant.image_of(k));
    EXPECT_EQ(all.image_of(k).data, read_srgb(written / "x.png").data);
  }
  // The first camera's labels keep their numbers; the others have their 2-D box in another camera's picture.
  ASSERT_GT(all.labels.size(), first.labels.size());
  for (std::size_t i = 0; i < all.labels.size(); ++i) {
    const Label& label = all.labels[i];
    if (i < first.labels.size()) {
      EXPECT_EQ(label.camera, 0);
      EXPECT_EQ(label.box.bev.x, first.labels[i].box.bev.x);
      EXPECT_EQ(label.left, first.labels[i].left);
      continue;
    }
    ASSERT_GT(label.camera, 0);
    const Calibration& calibration = all.calibration_of(as_size(label.camera));
    const auto box = projected_label(label.type, label.box, calibration);
    ASSERT_TRUE(box);
    EXPECT_EQ(label.left, box->left);
    EXPECT_FALSE(projected_label(label.type, label.box, first.calibration));
  }
  EXPECT_EQ(open_data_set(folder.path(), Cameras::all)->tracks("sample0")->size(), all.labels.size());
}

TEST(NuScenes, OtherCamerasCountWhereTheyAreAskedFor) {
  const TemporaryFolder folder;
  test::write_nuscenes(folder.path(), {test::surround_frame(test::small_rig(), 5, 0)});
  const auto hash = [&](Cameras cameras) { return open_data_set(folder.path(), cameras)->hash("sample0"); };
  const std::string first = hash(Cameras::first), all = hash(Cameras::all);
  EXPECT_NE(first, all);
  EXPECT_EQ(hash(Cameras::all), all);
  const auto picture = folder / "samples/CAM_FRONT_LEFT/0.png";
  write_srgb(picture, ImageF(310, 94, 3, 0.5f));
  EXPECT_EQ(hash(Cameras::first), first);
  EXPECT_NE(hash(Cameras::all), all);
  std::filesystem::remove(picture);
  EXPECT_NO_THROW(read_frame(folder.path(), "sample0"));
  EXPECT_EQ(open_data_set(folder.path())->tracks("sample0")->size(),
            read_frame(folder.path(), "sample0").labels.size());
  EXPECT_THAT(error_text<InputError>([&] { read_frame(folder.path(), "sample0", Cameras::all); }),
              AllOf(HasSubstr("CAM_FRONT_LEFT/0.png"), HasSubstr("--cameras first"), Not(HasSubstr("\n"))));
}

TEST(NuScenes, AVersionIsChosenByItsFolder) {
  const TemporaryFolder folder;
  test::write_nuscenes(folder.path(), frames());
  EXPECT_EQ(list_frames(folder / "v1.0-mini").size(), 2u);
  EXPECT_NO_THROW(read_frame(folder / "v1.0-mini", "sample1"));
  EXPECT_NO_THROW(read_frame(folder / "v1.0-mini/", "sample1"));
  EXPECT_NO_THROW(read_frame(folder / "v1.0-mini/.", "sample1"));
  std::filesystem::copy(folder / "v1.0-mini", folder / "v1.0-other",
                        std::filesystem::copy_options::recursive);
  EXPECT_THAT(error_text<InputError>([&] { list_frames(folder.path()); }), HasSubstr("2 versions"));
}

/// Archives come in parts: the set lists the samples whose files exist.
TEST(NuScenes, APartOfTheArchiveWillDo) {
  const TemporaryFolder folder;
  test::write_nuscenes(folder.path(), frames());
  EXPECT_EQ(open_data_set(folder.path())->incomplete(), "");
  std::filesystem::remove(folder / "samples/LIDAR_TOP/0.pcd.bin");
  EXPECT_EQ(list_frames(folder.path()), std::vector<std::string>{"sample1"});
  EXPECT_THAT(open_data_set(folder.path())->incomplete(), HasSubstr("1 of 2 samples"));
  for (const char* table : {"category", "instance", "sample_annotation"})
    std::filesystem::remove(folder / "v1.0-mini" / (std::string(table) + ".json"));
  const Frame frame = read_frame(folder.path(), "sample1");
  EXPECT_FALSE(frame.labelled);
  EXPECT_EQ(frame.sweep.size(), frames()[1].sweep.size());
  std::filesystem::remove_all(folder / "samples/CAM_FRONT");
  EXPECT_THAT(error_text<InputError>([&] { list_frames(folder.path()); }),
              AllOf(HasSubstr("1 have their file of LIDAR_TOP"), HasSubstr("0 that of CAM_FRONT")));
}

TEST(KittiTracking, AndRawNeedNoLabels) {
  const TemporaryFolder tracking, raw;
  test::write_tracking(tracking.path(), frames());
  std::filesystem::remove_all(tracking / "training/label_02");
  std::filesystem::rename(tracking / "training", tracking / "testing");
  test::write_raw(raw.path(), frames());
  std::filesystem::remove(raw / "2011_09_26_drive_0001_sync/tracklet_labels.xml");
  for (const auto& data : {tracking.path(), raw.path()}) {
    const std::vector<std::string> ids = list_frames(data);
    ASSERT_EQ(ids.size(), 2u);
    const Frame frame = read_frame(data, ids[1]);
    EXPECT_FALSE(frame.labelled);
    EXPECT_EQ(frame.sweep.size(), frames()[1].sweep.size());
  }
}

TEST(KittiRaw, DrivesWithoutLabelsStandBesideOthers) {
  const TemporaryFolder folder;
  test::write_raw(folder.path(), frames());
  const auto other = folder / "2011_09_26_drive_0002_sync";
  std::filesystem::copy(folder / "2011_09_26_drive_0001_sync", other,
                        std::filesystem::copy_options::recursive);
  std::filesystem::remove(other / "tracklet_labels.xml");
  const std::vector<std::string> ids = list_frames(folder.path());
  ASSERT_EQ(ids.size(), 4u);
  EXPECT_TRUE(read_frame(folder.path(), ids.front()).labelled);
  EXPECT_FALSE(read_frame(folder.path(), ids.back()).labelled);
}

TEST(DataRig, AMisspeltNameIsLookedForAmongTheShippedOnes) {
  const TemporaryFolder folder;
  write_file(folder / "dataset.json", R"({"rig": "kitti46"})");
  EXPECT_THAT(error_text<InputError>([&] { lidar_of(folder.path()); }),
              AllOf(HasSubstr("dataset.json"), HasSubstr("kitti46"), HasSubstr("did you mean kitti64")));
}

TEST(NuScenes, SweepsBetweenKeyframesAreNotTaken) {
  const TemporaryFolder folder;
  test::write_nuscenes(folder.path(), frames());
  nlohmann::json table = read_json(folder / "v1.0-mini" / "sample_data.json");
  EXPECT_EQ(list_frames(folder.path()).size(), 2u);
  // A sweep between keyframes and a camera that is not selected change nothing.
  nlohmann::json between = table[0];
  between["is_key_frame"] = false, between["filename"] = "sweeps/LIDAR_TOP/x.pcd.bin";
  table.insert(table.begin(), between);
  write_json(folder / "v1.0-mini" / "sample_data.json", table);
  EXPECT_EQ(open_data_set(folder.path())->source_files("sample0")[0].file.filename(), "0.pcd.bin");
}

}  // namespace
}  // namespace mirage
