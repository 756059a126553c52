#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/error.h"
#include "base/files.h"
#include "base/shipped_plugins.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;
using testing::ElementsAre;
using testing::HasSubstr;

TEST(ShippedPlugins, AreWhatTheirDescriptionsSay) {
  const TemporaryFolder folder;
  write_file(folder / "b.json", R"({"kind": "detector", "words": ["one", "two"], "weights": "data"})");
  write_file(folder / "c.json", R"({"kind": "depth", "words": ["three"], "weights": "code"})");
  write_file(folder / "a.json", R"({"kind": "detector", "words": ["four"], "weights": "code"})");
  write_file(folder / "notes.txt", "nothing");
  const auto detectors = read_shipped_plugins(folder.path(), "detector");
  ASSERT_EQ(detectors.size(), 2u);
  EXPECT_EQ(detectors[0].file, folder / "a.so");
  EXPECT_TRUE(detectors[0].weights_are_code);
  EXPECT_THAT(detectors[1].words, ElementsAre("one", "two"));
  EXPECT_FALSE(detectors[1].weights_are_code);
  EXPECT_EQ(read_shipped_plugins(folder.path(), "depth").size(), 1u);
  EXPECT_TRUE(read_shipped_plugins(folder / "nowhere", "depth").empty());
}

TEST(ShippedPlugins, ADescriptionThatIsNoneIsNamed) {
  const TemporaryFolder folder;
  for (const char* text :
       {"[]", R"({"words": [], "weights": "data"})", R"({"kind": "depth", "weights": "data"})",
        R"({"kind": "depth", "words": [1], "weights": "data"})",
        R"({"kind": "depth", "words": [], "weights": "any"})"}) {
    write_file(folder / "x.json", text);
    EXPECT_THAT(error_text<InputError>([&] { read_shipped_plugins(folder.path(), "depth"); }),
                HasSubstr("x.json"))
        << text;
  }
}

}  // namespace
}  // namespace mirage
