// The cache keys of a detector's answers.
#include <gtest/gtest.h>

#include "base/files.h"
#include "frames/frame_provenance.h"
#include "scene/frame_source.h"
#include "support/files.h"

namespace mirage {
namespace {

TEST(DetectorIdentity, OfAProgramHasTheSeedThatItIsTold) {
  DetectorOptions options;
  options.detector = "exec:true";
  const auto with_seed = [&](std::uint64_t seed) {
    options.seed = seed;
    return detector_identity(options, "version 1");
  };
  EXPECT_EQ(with_seed(1), with_seed(1));
  EXPECT_NE(with_seed(1), with_seed(2));
}

TEST(DetectorIdentity, UnderACeilingHasTheHeightOfTheDatasUnit) {
  const test::TemporaryFolder folder;
  std::string tall = read_file(shipped_file("scenes/rigs/kitti64.toml"));
  tall.replace(tall.find("height = 1.73"), 13, "height = 2.60");
  write_file(folder / "tall.toml", tall);
  write_file(folder / "dataset.json", R"({"rig": "kitti64"})");
  DetectorOptions options;
  options.detector = "exec:true";
  options.defense = "ceiling:1.6";
  FrameSource source;
  source.data = folder.path();
  const std::string shipped = detector_identity(for_data(options, source), "version 1");
  source.rig = (folder / "tall.toml").string();
  EXPECT_NE(detector_identity(for_data(options, source), "version 1"), shipped);
}

}  // namespace
}  // namespace mirage
