// Hosts of an evaluation in its file, and back.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attack/evaluation_outcomes.h"
#include "attack/false_positives.h"
#include "base/error.h"
#include "support/files.h"

namespace mirage {
namespace {

constexpr int kMeshes = 2;

/// A host that every field tells from a default one, under two meshes, and one of which nothing is known.
std::vector<HostOutcome> outcomes(Matching matching) {
  HostOutcome host;
  host.id = {"000012", 3};
  host.matching = matching;
  host.track = 40;
  host.from_box = false;
  host.range = 12.5;
  host.occluded = 2;
  host.truncated = 0.25;
  host.kind = "hatchback";
  host.clean_iou = 0.9, host.attacked_iou = 0.2;
  host.clean_score = 0.8, host.attacked_score = 0.4;
  if (!matching.in_picture()) host.clean_distance = 0.1;
  host.detected = host.hidden = host.false_positive = true;
  host.false_positive_distance = 30;
  host.new_boxes = {{{}, 0.5, 30, 20}, {{}, 0.6, 4, 10}};
  HostOutcome other = host, plain;
  other.mesh = 1;
  other.new_boxes.pop_back();
  plain.matching = matching;
  plain.id = {"000013", 0};
  return {host, plain, other};
}

nlohmann::json file_of(const std::vector<HostOutcome>& hosts) {
  return {{"outcomes", outcomes_json(hosts, kMeshes)}, {"false_positives", false_positives_json(hosts)}};
}

TEST(EvaluationOutcomes, AreReadAsTheyWereWritten) {
  for (const Matching matching : {kFromAbove, kInPicture}) {
    const nlohmann::json written = file_of(outcomes(matching));
    const std::vector<HostOutcome> read = read_outcomes({"result.json", written, "fix"});
    ASSERT_EQ(read.size(), 3u);
    EXPECT_EQ(outcomes_json(read, kMeshes), written.at("outcomes"));
    EXPECT_EQ(read[0].matching.in_picture(), matching.in_picture());
    ASSERT_EQ(read[0].new_boxes.size(), 2u);
    EXPECT_EQ(read[0].new_boxes[1].distance, 4);
    EXPECT_TRUE(read[1].new_boxes.empty());
    EXPECT_EQ(read[1].track, -1);
    EXPECT_EQ(read[2].new_boxes.size(), 1u);
  }
}

TEST(EvaluationOutcomes, ADamagedFileIsNamedByItsField) {
  const nlohmann::json written = file_of(outcomes(kFromAbove));
  const auto error = [](const nlohmann::json& file) {
    return test::error_text<InputError>([&] { read_outcomes({"result.json", file, "fix"}); });
  };
  nlohmann::json file = written;
  file["outcomes"][1].erase("hidden");
  EXPECT_THAT(error(file), testing::HasSubstr("outcomes[1].hidden"));
  file = written;
  file["outcomes"][0]["label"] = -1;
  EXPECT_THAT(error(file), testing::HasSubstr("outcomes[0].label"));
  file = written;
  file["false_positives"]["list"][2]["distance_from_host"] = nullptr;
  EXPECT_THAT(error(file), testing::HasSubstr("false_positives.list[2].distance_from_host"));
  file["false_positives"] = 3;
  EXPECT_THAT(error(file), testing::HasSubstr("false_positives"));
}

}  // namespace
}  // namespace mirage
