// A generated frame counts as complete if its content matches its record; a full disk leaves no incomplete
// frame.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mount.h>
#include <unistd.h>

#include <cmath>
#include <map>

#include "base/error.h"
#include "base/files.h"
#include "base/sizes.h"
#include "generator/dataset.h"
#include "generator/generator.h"
#include "generator/street.h"
#include "scene/data/read_frames.h"
#include "sensors/ray_camera.h"
#include "support/files.h"
#include "support/small_rig.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using test::small_rig;
using test::TemporaryFolder;

DatasetSummary generate(const fs::path& out, int frames, Truth truth = Truth::none) {
  return generate_dataset(
      small_rig(), 3, 0, frames, out, [](std::size_t) {}, truth);
}

std::string training(const fs::path& out, const std::string& name) {
  return read_file(out / "training" / name);
}

/// Every file below training/ by name, with its content.
std::map<std::string, std::string> contents(const fs::path& out) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(out / "training"))
    if (entry.is_regular_file()) files[fs::relative(entry.path(), out)] = read_file(entry.path());
  return files;
}

// A frame with several cameras: everything is read back, and everything is in the record.
TEST(FrameRecord, SeveralCamerasComeBackAsTheyWereWritten) {
  const TemporaryFolder folder;
  const Rig rig = test::surround_rig();
  const auto make = [&] {
    return generate_dataset(
        rig, 7, 0, 2, folder.path(), [](std::size_t) {}, Truth::all);
  };
  const DatasetSummary sum = make();
  EXPECT_EQ(sum.written, 2);
  int behind = 0;
  for (std::uint64_t i = 0; i < 2; ++i) {
    const Frame made = generate_frame(rig, 7, i);
    ASSERT_EQ(made.others.size(), 2u);
    const Frame all = read_frame(folder.path(), made.id, Cameras::all),
                first = read_frame(folder.path(), made.id);
    EXPECT_EQ(all.camera, "CAM_FRONT");
    EXPECT_TRUE(first.others.empty());
    ASSERT_EQ(all.others.size(), 2u);
    ASSERT_EQ(all.labels.size(), made.labels.size());
    for (std::size_t k = 0; k < 2; ++k) {
      EXPECT_EQ(all.others[k].name, made.others[k].name);
      EXPECT_TRUE(all.others[k].calibration.camera_from_velo.isApprox(
          made.others[k].calibration.camera_from_velo, 1e-12));
      const ImageF &read = all.others[k].image.get(), &drawn = made.others[k].image.get();
      ASSERT_EQ(read.data.size(), drawn.data.size());
      EXPECT_NE(read.data, all.image.data);
      for (std::size_t p = 0; p < read.data.size(); p += 97)
        ASSERT_NEAR(read.data[p], std::min(1.0f, drawn.data[p]), 0.02);
    }
    std::size_t own = 0;
    for (std::size_t l = 0; l < all.labels.size(); ++l) {
      const Label &read = all.labels[l], &is = made.labels[l];
      EXPECT_EQ(read.type, is.type);
      EXPECT_EQ(read.camera, is.camera);
      EXPECT_NEAR(read.box.bev.x, is.box.bev.x, 0.02);
      EXPECT_NEAR(read.bottom, is.bottom, 0.02);
      own += is.camera == 0;
      EXPECT_TRUE(is.camera > 0 || l + 1 == own) << "the first camera's come first";
      behind += is.camera > 0 && is.box.bev.x < -10;
    }
    EXPECT_EQ(first.labels.size(), own);
  }
  EXPECT_GT(behind, 0) << "the street goes on behind the car";
  const DatasetSummary again = make();
  EXPECT_EQ(again.existing, 2);
  EXPECT_EQ(again.cars, sum.cars);
  EXPECT_EQ(again.others, sum.others);
  const std::string hash = open_data_set(folder.path())->hash("000000"),
                    whole = open_data_set(folder.path(), Cameras::all)->hash("000000");
  const fs::path about = folder / "training/cameras/000000.json",
                 picture = folder / "training/cameras/CAM_BACK/000000.png";
  fs::copy_file(folder / "training/cameras/CAM_LEFT/000000.png", picture,
                fs::copy_options::overwrite_existing);
  EXPECT_FALSE(is_as_recorded(folder.path(), "000000", Truth::all));
  EXPECT_EQ(open_data_set(folder.path())->hash("000000"), hash);
  EXPECT_NE(open_data_set(folder.path(), Cameras::all)->hash("000000"), whole);
  EXPECT_EQ(make().written, 1);
  EXPECT_EQ(open_data_set(folder.path(), Cameras::all)->hash("000000"), whole);
  std::string text = read_file(about);
  text.replace(text.find("camera_from_velo"), 16, "camera_from_Velo");
  write_file(about, text);
  EXPECT_THAT(
      test::error_text<InputError>([&] { read_frame(folder.path(), "000000", Cameras::all); }),
      testing::AllOf(testing::HasSubstr("000000.json"), testing::HasSubstr("others[0].camera_from_velo")));
}

// A car between two cameras is in the pictures of both, and has one label.
TEST(FrameRecord, ACarOnTheSeamIsInBothCameras) {
  const auto nearest = [](const Frame& frame) {
    const Label* car = nullptr;
    for (const Label& label : frame.labels)
      if (label.type == "Car" && label.occluded == 0 &&
          (!car || label.box.bev.x * label.box.bev.x < car->box.bev.x * car->box.bev.x))
        car = &label;
    return car;
  };
  const Frame any = generate_frame(test::surround_rig(), 7, 1);
  const Label* found = nearest(any);
  ASSERT_TRUE(found);
  const BevBox place = found->box.bev;
  const Rig rig = test::surround_rig(std::atan2(place.y, place.x));
  const Frame frame = generate_frame(rig, 7, 1);
  std::vector<const Label*> same;
  for (const Label& label : frame.labels)
    if (std::hypot(label.box.bev.x - place.x, label.box.bev.y - place.y) < 0.01) same.push_back(&label);
  ASSERT_EQ(same.size(), 1u);
  const generator::Street street = generator::make_street(7, 1, rig.lidar.height, rig.look, 60);
  const RayScene scene(street.surfaces);
  const auto shown = [&](const Calibration& calibration) {  // pixels of the car
    const RayImage picture = render(scene, calibration.camera, calibration.camera_from_velo,
                                    generator::make_light(7, 1), {1, 1, 0});
    int pixels = 0;
    for (const int id : picture.object.data) {
      if (id < 0) continue;
      const BevBox& box = street.placed[as_size(id)].box.bev;
      pixels += std::hypot(box.x - place.x, box.y - place.y) < 0.01;
    }
    return pixels;
  };
  EXPECT_GT(shown(frame.calibration), 20);
  EXPECT_GT(shown(frame.others[1].calibration), 20);
  EXPECT_EQ(shown(frame.others[0].calibration), 0);
}

TEST(FrameRecord, AFileThatIsNotWhatWasWrittenIsMadeAgain) {
  const TemporaryFolder folder;
  EXPECT_EQ(generate(folder.path(), 2, Truth::all).written, 2);
  const auto good = contents(folder.path());
  for (const char* name : {"image_2/000001.png", "velodyne/000001.bin", "calib/000001.txt",
                           "label_2/000001.txt", "lighting/000001.json", "depth/000001.png",
                           "instance_2/000001.png", "instance_velodyne/000001.label"}) {
    const std::string whole = training(folder.path(), name);
    EXPECT_TRUE(is_as_recorded(folder.path(), "000001", Truth::all)) << name;
    write_file(folder.path() / "training" / name, whole.substr(0, whole.size() / 2));  // as a full disk would
    EXPECT_FALSE(is_as_recorded(folder.path(), "000001", Truth::all)) << name;
    fs::remove(folder.path() / "training" / name);
    EXPECT_FALSE(is_as_recorded(folder.path(), "000001", Truth::all)) << name;
    write_file(folder.path() / "training" / name, whole);
  }
  write_file(folder.path() / "training/image_2/000001.png", "");
  const DatasetSummary again = generate(folder.path(), 2, Truth::all);
  EXPECT_EQ(again.existing, 1);
  EXPECT_EQ(again.written, 1);
  EXPECT_EQ(contents(folder.path()), good);
  EXPECT_EQ(generate(folder.path(), 2, Truth::all).existing, 2);
  EXPECT_EQ(generate(folder.path(), 2, Truth::none).existing, 2);
}

TEST(FrameRecord, WithoutARecordOrWithADamagedOneTheFrameIsMadeAgain) {
  const TemporaryFolder folder;
  generate(folder.path(), 1);
  const auto good = contents(folder.path());
  const fs::path record = folder.path() / "training/written/000000.json";
  const std::string whole = read_file(record);
  for (const char* text : {"", "[", "[1]", "5", "{\"image_2/000000.png\": 5}", "{}"}) {
    write_file(record, text);
    EXPECT_FALSE(is_as_recorded(folder.path(), "000000", Truth::none)) << text;
  }
  write_file(record, whole);
  EXPECT_TRUE(is_as_recorded(folder.path(), "000000", Truth::none));
  EXPECT_FALSE(is_as_recorded(folder.path(), "000000", Truth::depth));
  fs::remove(record);
  EXPECT_EQ(generate(folder.path(), 1).written, 1);
  EXPECT_EQ(contents(folder.path()), good);
}

/// A disk of a given size at a folder, for as long as it lives.
class SmallDisk {
 public:
  SmallDisk(fs::path folder, const char* size) : folder_(std::move(folder)) {
    mounted_ = geteuid() == 0 && mount("none", folder_.c_str(), "tmpfs", 0, size) == 0;
  }
  ~SmallDisk() {
    if (mounted_) umount2(folder_.c_str(), MNT_DETACH);
  }
  SmallDisk(const SmallDisk&) = delete;
  SmallDisk& operator=(const SmallDisk&) = delete;
  bool mounted() const { return mounted_; }
  bool resize(const char* size) const {
    return mount("none", folder_.c_str(), "tmpfs", MS_REMOUNT, size) == 0;
  }

 private:
  fs::path folder_;
  bool mounted_ = false;
};

// Frames are made in parallel: when one fails, the others must not be written half done.
TEST(FrameRecord, AFullDiskIsSaidAndWhatIsThereIsWhole) {
  const TemporaryFolder folder, elsewhere;
  const SmallDisk disk(folder.path(), "size=192k");
  if (!disk.mounted()) GTEST_SKIP() << "needs root to mount a small disk";
  generate(elsewhere.path(), 2, Truth::all);
  const std::string said = test::error_text<Failure>([&] { generate(folder.path(), 2, Truth::all); });
  EXPECT_THAT(said,
              testing::AllOf(testing::HasSubstr("No space left"), testing::Not(testing::HasSubstr("\n"))));
  const auto whole = contents(elsewhere.path());
  std::size_t there = 0;
  for (const auto& [name, content] : contents(folder.path())) {
    EXPECT_TRUE(name.starts_with("training/written/") || content == whole.at(name))
        << name << ": " << content.size() << " bytes, " << whole.at(name).size();
    ++there;
  }
  EXPECT_GT(there, 2u);
  EXPECT_LT(there, whole.size());
  EXPECT_TRUE(disk.resize("size=64m"));
  generate(folder.path(), 2, Truth::all);
  EXPECT_EQ(contents(folder.path()), whole);
}

}  // namespace
}  // namespace mirage
