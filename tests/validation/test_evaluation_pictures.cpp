// Which hosts `mirage evaluate --pictures` draws.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "validation/report/pages.h"

namespace mirage {
namespace {

HostOutcome outcome(const char* frame, double left, double clean_score, double distance) {
  HostOutcome host;
  host.id = {frame, 0};
  host.detected = true;
  host.hidden = left <= 0.7;
  host.attacked_iou = left;
  host.clean_score = clean_score;
  host.false_positive = distance > 0;
  host.false_positive_distance = distance;
  return host;
}

TEST(EvaluationPictures, ShowOtherFramesFirstAndTheClearestOnes) {
  std::vector<HostOutcome> hosts = {
      outcome("0", 0.6, 0.9, 0),   // still found, if badly
      outcome("1", 0, 0.5, 3),     //
      outcome("1", 0, 0.8, 40),    // gone, and surest before
      outcome("2", 0.9, 0.9, 20),  // found
      outcome("3", 0, 0.9, 50),    //
  };
  hosts[4].detected = false;  // counts in no share
  const PicturedHosts some = pictured_hosts(hosts, 2);
  EXPECT_THAT(some.hidden, testing::ElementsAre(2, 0));  // a second frame before the same one again
  EXPECT_THAT(some.false_positives, testing::ElementsAre(2, 3));
  const PicturedHosts all = pictured_hosts(hosts, 9);
  EXPECT_THAT(all.hidden, testing::ElementsAre(2, 0, 1));
  EXPECT_THAT(all.false_positives, testing::ElementsAre(2, 3, 1));
  EXPECT_TRUE(pictured_hosts(hosts, 0).hidden.empty());
  EXPECT_TRUE(pictured_hosts({}, 3).false_positives.empty());
}

}  // namespace
}  // namespace mirage
