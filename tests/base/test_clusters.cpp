#include <gtest/gtest.h>

#include "base/clusters.h"

namespace mirage {
namespace {

TEST(Clusters, AVehicleIsOneInAllItsFramesAndTheUnknownAreTheirFrames) {
  EXPECT_EQ(cluster_of("000003", 17), cluster_of("000008", 17));
  EXPECT_NE(cluster_of("000003", 17), cluster_of("000003", 18));
  EXPECT_EQ(cluster_of("000003", -1), "000003");
  Clusters clusters;
  clusters.add("000003", -1);
  clusters.add("000003", -1);
  clusters.add("000008", -1);
  EXPECT_EQ(clusters.count().by, "frame");
  EXPECT_EQ(clusters.count().count, 2);
  for (const char* frame : {"000003", "000008", "000009"}) clusters.add(frame, 17);
  EXPECT_EQ(to_json(clusters.count()), (nlohmann::json{{"by", "vehicle"}, {"count", 3}}));
  const nlohmann::json json = to_json(clusters.count());
  EXPECT_EQ(cluster_count_from_json({"file", json, ""}).count, 3);
  EXPECT_EQ(cluster_count_from_json({"file", json, ""}).by, "vehicle");
}

// A vehicle's number is never taken for a frame of that name.
TEST(Clusters, VehiclesAndFramesOfEqualNumbersAreApart) {
  EXPECT_NE(cluster_of("000017", -1), cluster_of("000003", 17));
}

}  // namespace
}  // namespace mirage
