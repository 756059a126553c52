// Which rig a data set says it is from.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/error.h"
#include "base/files.h"
#include "scene/data/data_rig.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;

TEST(DataRig, IsWhatTheSetSaysElseKitti) {
  const TemporaryFolder folder;
  EXPECT_EQ(data_rig(folder.path()), "kitti64");
  write_file(folder / "dataset.json", R"({"rig": "xenith", "seed": 1})");
  EXPECT_EQ(data_rig(folder.path()), "xenith");
  for (const char* text : {R"({"seed": 1})", R"({"rig": 3})", "[]"}) {
    write_file(folder / "dataset.json", text);
    EXPECT_THAT(error_text<InputError>([&] { data_rig(folder.path()); }),
                ::testing::HasSubstr("dataset.json: rig"));
  }
}

}  // namespace
}  // namespace mirage
