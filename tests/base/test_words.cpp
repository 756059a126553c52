#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "base/files.h"
#include "base/words.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

TEST(Words, SlipsAreCountedAsTheyAreMade) {
  EXPECT_EQ(slips_between("attack", "attack"), 0);
  EXPECT_EQ(slips_between("atack", "attack"), 1);    // one left out
  EXPECT_EQ(slips_between("attacck", "attack"), 1);  // one too many
  EXPECT_EQ(slips_between("attaxk", "attack"), 1);   // another
  EXPECT_EQ(slips_between("atatck", "attack"), 1);   // two swapped
  EXPECT_EQ(slips_between("min_veiw", "min-view"), 1);
  EXPECT_EQ(slips_between("Fusion", "fusion"), 0);
  EXPECT_EQ(slips_between("", "abc"), 3);
  EXPECT_EQ(slips_between("kitten", "sitting"), 3);
  EXPECT_EQ(slips_between("ca", "abc"), 3);  // swapped letters stay together: optimal string alignment
}

TEST(Words, OnlyWhatIsNearIsMeant) {
  const std::vector<std::string> known = {"lidar", "camera", "painted", "fusion", "late", "refined"};
  EXPECT_THAT(meant_by("fusoin", known), ElementsAre("fusion"));
  EXPECT_THAT(meant_by("lat", known), ElementsAre("late"));
  EXPECT_THAT(meant_by("pointpillars", known), IsEmpty());
  EXPECT_THAT(meant_by("", known), IsEmpty());
  EXPECT_THAT(meant_by("iter", {"batch", "iterations"}), ElementsAre("iterations"));
  EXPECT_THAT(meant_by("kitti", {"nuscenes", "kitti64", "xenith"}), ElementsAre("kitti64"));
  EXPECT_THAT(meant_by("frame", {"frame-rate", "farm", "frames"}), ElementsAre("frames", "frame-rate"));
  EXPECT_THAT(meant_by("a", {"b"}), IsEmpty());
}

TEST(Words, AllThatThereIsIsNamedTheNearestFirst) {
  EXPECT_EQ(use_one_of("visibel", {"plain", "visible"}), "did you mean visible? use visible or plain");
  EXPECT_EQ(use_one_of("armour", {"adversarial", "denoising"}, "a file"),
            "use adversarial, denoising or a file");
  const FieldError error = unknown_word("light", "visibel", {"plain", "visible"});
  EXPECT_STREQ(error.what(), "light: visibel: unknown; did you mean visible? use visible or plain");
  std::vector<std::string> many;
  for (int i = 0; i < 150; ++i) many.push_back("word-" + std::to_string(i));
  const std::string all = unknown_word("setting", "nothing", many).what();
  for (const std::string& word : many) EXPECT_THAT(all, HasSubstr(word));
}

TEST(Words, ShippedFilesAreTheirFoldersOwn) {
  test::TemporaryFolder folder;
  write_file(folder / "scenes/rigs/one.toml", "");
  write_file(folder / "scenes/rigs/other.toml", "");
  write_file(folder / "scenes/rigs/notes.txt", "");
  setenv("MIRAGE_HOME", folder.path().c_str(), 1);
  EXPECT_THAT(shipped_names("scenes/rigs", ".toml"), ElementsAre("one", "other"));
  EXPECT_EQ(shipped_choice("scenes/rigs", ".toml", "one", "rig"), folder / "scenes/rigs/one.toml");
  EXPECT_THAT(test::error_text<FieldError>([] { shipped_choice("scenes/rigs", ".toml", "onne", "rig"); }),
              HasSubstr("did you mean one? use one or other"));
  EXPECT_THAT(shipped_names("scenes/no-such-folder", ".toml"), IsEmpty());
  EXPECT_THAT(
      test::error_text<InputError>([] { shipped_choice("scenes/no-such-folder", ".toml", "one", "rig"); }),
      HasSubstr("MIRAGE_HOME"));
  unsetenv("MIRAGE_HOME");
}

TEST(Words, RangesHaveOneNotation) {
  EXPECT_EQ(Range{}.words(), "a number");
  EXPECT_EQ(kPositive.words(), "above 0");
  EXPECT_EQ((Range{kPositive.low, 10}).words(), "above 0, at most 10");
  EXPECT_EQ(kNotNegative.words(), "at least 0");
  EXPECT_EQ((Range{0, 1024}).words(), "0 to 1024");
  EXPECT_EQ((Range{1e-4, 1 << 20}).words(), "0.0001 to 1048576");
  EXPECT_EQ((Range{-Range::kMost, 3}).words(), "at most 3");
}

}  // namespace
}  // namespace mirage
