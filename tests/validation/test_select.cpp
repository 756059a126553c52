// Which vehicles a validation takes.
#include <gtest/gtest.h>

#include "base/error.h"
#include "validation/fidelity/validate.h"

namespace mirage {
namespace {

std::vector<std::string> names(const std::vector<HostId>& hosts) {
  std::vector<std::string> result;
  for (const HostId& id : hosts) result.push_back(host_name(id));
  return result;
}

TEST(SelectHosts, TestFramesComeFirstAndWhole) {
  ::mirage::Run run;  // the fixture has a Run of its own
  run.train = {{"000001", 0}, {"000002", 3}};
  run.test = {{"000005", 0}, {"000005", 2}, {"000009", 1}};
  using Names = std::vector<std::string>;
  EXPECT_EQ(select_hosts(run, 0).size(), 5u);  // fewer than a verdict wants
  EXPECT_EQ(names(select_hosts(run, 1)), (Names{"000005_0", "000005_2"}));
  EXPECT_EQ(names(select_hosts(run, 3)), (Names{"000005_0", "000005_2", "000009_1", "000001_0"}));
  EXPECT_EQ(select_hosts(run, 99).size(), 5u);
}

TEST(SelectHosts, AsManyWholeFramesAsAVerdictWants) {
  ::mirage::Run run;
  for (int frame = 0; frame < 60; ++frame)
    for (int label = 0; label < 3; ++label)
      (frame < 20 ? run.test : run.train).push_back({std::to_string(frame), label});
  const std::vector<HostId> hosts = select_hosts(run, 0);
  EXPECT_EQ(hosts.size(), 102u);
  EXPECT_EQ(hosts[59].frame, "19");  // the held-back ones first
  EXPECT_EQ(hosts.back().label, 2);
}

TEST(SelectHosts, WhatIsShownIsAllTestVehiclesAndNoOthers) {
  ::mirage::Run run;
  run.train = {{"000001", 0}, {"000002", 3}};
  run.test = {{"000005", 0}, {"000005", 2}, {"000009", 1}};
  using Names = std::vector<std::string>;
  EXPECT_EQ(names(shown_hosts(run, 0)), (Names{"000005_0", "000005_2", "000009_1"}));
  EXPECT_EQ(names(shown_hosts(run, 1)), (Names{"000005_0", "000005_2"}));
  EXPECT_EQ(shown_hosts(run, 9).size(), 5u);
  EXPECT_TRUE(learned_on(run, {"000002", 3}));
  EXPECT_FALSE(learned_on(run, {"000002", 0}));
  EXPECT_FALSE(learned_on(run, {"000005", 0}));
}

TEST(SelectHosts, TheLadderIsSpreadOverTheFrames) {
  const std::vector<HostId> hosts{{"a", 0}, {"a", 1}, {"a", 4}, {"b", 2}, {"c", 0}, {"c", 1}};
  using Chosen = std::vector<bool>;
  EXPECT_EQ(ladder_hosts(hosts, 0), (Chosen{0, 0, 0, 0, 0, 0}));
  EXPECT_EQ(ladder_hosts(hosts, 2), (Chosen{1, 0, 0, 1, 0, 0}));
  EXPECT_EQ(ladder_hosts(hosts, 4), (Chosen{1, 1, 0, 1, 1, 0}));
  EXPECT_EQ(ladder_hosts(hosts, 99), (Chosen{1, 1, 1, 1, 1, 1}));
  EXPECT_EQ(ladder_hosts(hosts, -1), (Chosen{1, 1, 1, 1, 1, 1}));
}

TEST(SelectHosts, AHostThatTheDataDoesNotHoldIsAnInputError) {
  Frame frame;
  frame.labels.resize(2);
  frame.labels[1].type = "Car";
  EXPECT_NO_THROW(label_of(frame, {"000001", 1}));
  EXPECT_THROW(label_of(frame, {"000001", 2}), InputError);
  frame.labels[1].in_space = false;  // another set of labels than the run's
  EXPECT_THROW(label_of(frame, {"000001", 1}), InputError);
  frame.labels[1] = {};
  frame.labels[1].type = "vehicle.foo";
  EXPECT_THROW(label_of(frame, {"000001", 1}), InputError);
}

}  // namespace
}  // namespace mirage
