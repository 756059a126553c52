// The gate for the data at hand is measured once.
#include <gtest/gtest.h>

#include <cstdlib>
#include <utility>

#include "attack/cached_reliance.h"
#include "base/files.h"
#include "support/files.h"
#include "support/planted.h"

namespace mirage {
namespace {

using test::Eyes;
using test::Planted;

/// With a cache folder of its own.
class CachedReliance : public testing::Test {
 protected:
  void SetUp() override {
    test::write_planted(data_.path());
    setenv("MIRAGE_CACHE", cache_.path().c_str(), 1);
    for (const Eyes eyes : {Eyes::sees, Eyes::sees}) detectors_.push_back(std::make_unique<Planted>(eyes));
  }
  void TearDown() override { setenv("MIRAGE_CACHE", "off", 1); }
  Reliance ask(const std::string& identity) { return cached_reliance(detectors_, identity, data_.path()); }
  /// Passes through the detectors since the last question.
  int passes() {
    int sum = 0;
    for (const auto& detector : detectors_) sum += std::exchange(static_cast<Planted&>(*detector).passes, 0);
    return sum;
  }
  test::TemporaryFolder data_, cache_;
  DetectorPool detectors_;
};

TEST_F(CachedReliance, IsMeasuredOnceForADetectorAndItsData) {
  const nlohmann::json first = to_json(ask("planted 1"));
  EXPECT_EQ(passes(), 4 * test::kPlaces);
  EXPECT_NEAR(first.at("drop").get<double>(), 1, 1e-12);
  EXPECT_EQ(to_json(ask("planted 1")), first);
  EXPECT_EQ(passes(), 0);
  ask("planted 2");  // another detector
  EXPECT_GT(passes(), 0);
  ask("");  // one whose answers are not to be kept
  EXPECT_GT(passes(), 0);
  Frame other = test::planted_frame(3);  // another frame
  other.sweep.push_back({20, 3, -1, 0});
  write_frame(data_.path(), other);
  ask("planted 1");
  EXPECT_GT(passes(), 0);
  write_file(data_ / "training/track_2/00000a.txt", "7\n");  // who is who decides on the clusters
  EXPECT_EQ(ask("planted 1").clusters.by, "vehicle");
  EXPECT_GT(passes(), 0);
}

TEST_F(CachedReliance, ADamagedEntryIsMeasuredAgain) {
  const nlohmann::json first = to_json(ask("planted 1"));
  passes();
  for (const auto& entry : std::filesystem::recursive_directory_iterator(cache_.path()))
    if (entry.is_regular_file()) write_file(entry.path(), "no entry");
  EXPECT_EQ(to_json(ask("planted 1")), first);
  EXPECT_GT(passes(), 0);
}

TEST_F(CachedReliance, ADetectorWithoutACameraIsNotRun) {
  detectors_.clear();
  detectors_.push_back(std::make_unique<Planted>(Eyes::ignores, "lidar"));
  EXPECT_FALSE(ask("planted 1").reads_picture);
  EXPECT_EQ(passes(), 0);
}

}  // namespace
}  // namespace mirage
