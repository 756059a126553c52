// A generated frame is taken for whole by what was recorded of its content; a full disk leaves no frame that
// is not.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mount.h>
#include <unistd.h>

#include <map>

#include "base/error.h"
#include "base/files.h"
#include "generator/dataset.h"
#include "scene/data/read_frames.h"
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
  EXPECT_EQ(again.kept, 1);
  EXPECT_EQ(again.written, 1);
  EXPECT_EQ(contents(folder.path()), good);
  EXPECT_EQ(generate(folder.path(), 2, Truth::all).kept, 2);
  EXPECT_EQ(generate(folder.path(), 2, Truth::none).kept, 2);
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

// Frames are made side by side: what the others were at when one failed must not be written half done.
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
