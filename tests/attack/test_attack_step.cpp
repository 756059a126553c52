// What a step tells besides its gradient, and checkpoints of before it told.
#include <gtest/gtest.h>

#include "attack/attack_step.h"
#include "attack/tiny_world.h"
#include "base/files.h"
#include "support/files.h"

namespace mirage {
namespace {

/// Answers with the same proposals to anything.
class FixedDetector : public test::StandInDetector {
 public:
  explicit FixedDetector(std::vector<Proposal> answer) : answer_(std::move(answer)) {}
  std::vector<Proposal> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    StandInDetector::forward(input, score_threshold, keep_graph);
    return answer_;
  }

 private:
  std::vector<Proposal> answer_;
};

AttackSettings settings_for(const test::TemporaryFolder& folder, const char* out, int iterations) {
  AttackSettings settings;
  settings.data = folder / "data";
  settings.out = folder / out;
  settings.iterations = iterations;
  settings.rooftop = "box";
  settings.quiet = true;
  return settings;
}

TEST(AttackStep, AHostIsHiddenWhereNoProposalFindsIt) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box"});
  const Host host = find_hosts(store, "000000", {0, 50, -25, 25}, {}).at(0);
  const auto prepared = store.get("000000");
  const BevBox box = prepared->frame.labels[0].box.bev;
  const auto hidden = [&](double score, double shift) {
    BevBox found = box;
    found.x += shift;
    FixedDetector detector({{found, std::log(score / (1 - score))}});
    return attack_host(detector, *prepared, host, initial_adversary(), AttackTarget::both, AttackSettings())
        .hidden;
  };
  EXPECT_FALSE(hidden(0.9, 0));
  EXPECT_FALSE(hidden(0.31, 0));
  EXPECT_TRUE(hidden(0.29, 0));                  // below the score of a detection
  EXPECT_FALSE(hidden(0.9, 0.15 * box.length));  // IoU 0.74
  EXPECT_TRUE(hidden(0.9, 0.2 * box.length));    // IoU 0.67
  EXPECT_TRUE(hidden(0.9, 10));
}

TEST(AttackStep, StagesAddUpToTheHostsTime) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  DetectorPool one;
  one.push_back(std::make_unique<test::StandInDetector>());
  auto settings = settings_for(folder, "run", 3);
  settings.expectation = parse_expectation("all");
  const auto stages = run_attack(settings, one).stages;
  double threads = 0;
  for (const auto& [name, seconds] : stages.at("thread_seconds").items()) {
    EXPECT_GE(seconds.get<double>(), 0) << name;
    threads += seconds.get<double>();
  }
  // One thread does all, so its stages are the wall's `hosts`, but for what lies around them.
  EXPECT_LE(threads, stages.at("wall_seconds").at("hosts").get<double>());
  EXPECT_GT(stages.at("thread_seconds").at("worlds").get<double>(), 0);
  EXPECT_EQ(stages.at("iterations"), 3);
  EXPECT_EQ(stages.at("threads"), 1);
}

TEST(AttackStep, CheckpointsWithoutTheCountGoOnToTheSameMesh) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  DetectorPool detectors;
  detectors.push_back(std::make_unique<test::StandInDetector>());
  run_attack(settings_for(folder, "whole", 5), detectors);
  run_attack(settings_for(folder, "parts", 2), detectors);
  auto checkpoint = read_json(folder / "parts/checkpoint.json");
  ASSERT_EQ(checkpoint.at("hidden").size(), 2u);
  checkpoint.erase("hidden");
  write_file(folder / "parts/checkpoint.json", checkpoint.dump());
  run_attack(settings_for(folder, "parts", 5), detectors);
  EXPECT_EQ(read_file(folder / "parts/adversary.glb"), read_file(folder / "whole/adversary.glb"));
  // The losses are the same; the count is empty where nobody counted.
  std::istringstream parts(read_file(folder / "parts/loss.csv")), whole(read_file(folder / "whole/loss.csv"));
  std::string a, b;
  for (int row = -1; std::getline(parts, a) && std::getline(whole, b); ++row) {
    EXPECT_EQ(a.substr(0, a.rfind(',')), b.substr(0, b.rfind(',')));
    EXPECT_EQ(a.back() == ',', row == 0 || row == 1) << a;
  }
}

}  // namespace
}  // namespace mirage
