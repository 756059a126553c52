// The order in which an attack meets its hosts.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>
#include <string>

#include "attack/host_order.h"
#include "attack/rank_steps.h"

namespace mirage {
namespace {

/// Frame f has counts[f] hosts.
std::vector<Host> hosts_in_frames(const std::vector<int>& counts) {
  std::vector<Host> hosts;
  for (std::size_t f = 0; f < counts.size(); ++f)
    for (int k = 0; k < counts[f]; ++k) hosts.push_back({{"frame" + std::to_string(f), k}, {}});
  return hosts;
}

/// What place `place` of the batches meets, `n` times.
std::vector<std::size_t> met(const HostOrder& order, std::size_t place, long n) {
  std::vector<std::size_t> hosts;
  for (long i = 0; i < n; ++i) hosts.push_back(order.batch(i).at(place));
  return hosts;
}

TEST(HostOrder, EveryPassOfALaneMeetsEveryHostOnce) {
  const auto hosts = hosts_in_frames(std::vector<int>(10, 3));
  const HostOrder order(hosts, 2, 5);
  ASSERT_EQ(order.lanes(), 2u);
  std::set<std::vector<std::size_t>> passes;
  std::set<std::size_t> all;
  for (const std::size_t place : {0u, 1u}) {
    const auto two = met(order, place, 30);
    for (const std::size_t pass : {0u, 1u}) {
      const std::vector<std::size_t> one(two.begin() + static_cast<long>(15 * pass),
                                         two.begin() + static_cast<long>(15 * pass + 15));
      EXPECT_EQ(std::set<std::size_t>(one.begin(), one.end()).size(), 15u);
      EXPECT_TRUE(passes.insert(one).second) << "another pass in the same order";
    }
    all.insert(two.begin(), two.end());
  }
  EXPECT_EQ(all.size(), hosts.size()) << "lanes do not share hosts";
}

TEST(HostOrder, LanesAndTheProcessesThatHaveThemShareNoFrame) {
  const auto hosts = hosts_in_frames({9, 1, 4, 7, 2, 2, 6, 3, 5, 8});
  const HostOrder order(hosts, 4, 1);
  ASSERT_EQ(order.lanes(), 4u);
  std::map<std::string, std::set<std::size_t>> processes;  // of each frame, if there are two
  for (long i = 0; i < 60; ++i) {
    const auto batch = order.batch(i);
    for (std::size_t k = 0; k < batch.size(); ++k) processes[hosts[batch[k]].id.frame].insert(k % 2);
  }
  EXPECT_EQ(processes.size(), 10u);
  for (const auto& [frame, of] : processes) EXPECT_EQ(of.size(), 1u) << frame;
}

TEST(HostOrder, AFrameIsOpenedOnceAPassAndFewAreOpenAtATime) {
  const std::size_t frames = 60;
  const auto hosts = hosts_in_frames(std::vector<int>(frames, 8));
  const HostOrder order(hosts, 2, 3);
  const auto pass = met(order, 0, static_cast<long>(hosts.size() / 2));
  std::map<std::string, std::pair<std::size_t, std::size_t>> span;  // where a frame is met first and last
  for (std::size_t i = 0; i < pass.size(); ++i) {
    const auto [known, fresh] = span.try_emplace(hosts[pass[i]].id.frame, i, i);
    known->second.second = i;
  }
  ASSERT_EQ(span.size(), frames / 2);
  std::size_t most = 0, neighbours = 0;
  for (std::size_t i = 0; i < pass.size(); ++i) {
    std::size_t open = 0;
    for (const auto& [frame, of] : span) open += of.first <= i && i <= of.second;
    most = std::max(most, open);
    neighbours += i > 0 && hosts[pass[i]].id.frame == hosts[pass[i - 1]].id.frame;
  }
  EXPECT_LE(most, kOpenFrames / 2);
  EXPECT_GT(most, 1u) << "hosts of a frame come mixed with others";
  EXPECT_LT(neighbours, pass.size() / 3) << "and not one after another";
}

TEST(HostOrder, ABatchLargerThanTheFramesOrUnevenFramesMakeFewerLanes) {
  EXPECT_EQ(HostOrder(hosts_in_frames({3, 3}), 8, 0).lanes(), 2u);
  EXPECT_EQ(HostOrder(hosts_in_frames({5}), 2, 0).lanes(), 1u);
  const auto uneven = hosts_in_frames({10, 1, 1});  // dealt to two, hosts of the small frames came five times
  const HostOrder one(uneven, 2, 0);
  EXPECT_EQ(one.lanes(), 1u);
  std::map<std::size_t, int> times;
  for (long i = 0; i < 12; ++i)
    for (const std::size_t host : one.batch(i)) ++times[host];
  ASSERT_EQ(times.size(), 12u);
  for (const auto& [host, n] : times) EXPECT_EQ(n, 2) << host;
}

TEST(HostOrder, ABatchMeetsNoHostTwice) {
  for (const auto& counts : {std::vector<int>{1, 1, 1}, std::vector<int>{7}, std::vector<int>{9, 1, 2}}) {
    const auto hosts = hosts_in_frames(counts);
    for (const int batch : {2, 3}) {
      if (hosts.size() < 3 * static_cast<std::size_t>(batch - 1)) continue;
      for (std::uint64_t seed = 0; seed < 20; ++seed) {
        const HostOrder order(hosts, batch, seed);
        std::map<std::size_t, int> times;
        for (long i = 0; i < static_cast<long>(hosts.size()); ++i) {
          const auto met = order.batch(i);
          EXPECT_EQ(std::set<std::size_t>(met.begin(), met.end()).size(), met.size());
          for (const std::size_t host : met) ++times[host];
        }
        if (order.lanes() > 1) continue;
        for (const auto& [host, n] : times) EXPECT_EQ(n, batch) << "every pass is whole";
      }
    }
  }
}

TEST(HostOrder, TheSeedDecidesTheOrder) {
  const auto hosts = hosts_in_frames(std::vector<int>(12, 4));
  const auto first = met(HostOrder(hosts, 2, 1), 0, 24);
  EXPECT_EQ(met(HostOrder(hosts, 2, 1), 0, 24), first);
  EXPECT_NE(met(HostOrder(hosts, 2, 2), 0, 24), first);
  EXPECT_EQ(HostOrder(hosts, 2, 1).batch(17).at(0), first[17])
      << "any iteration by itself, as a resumed run asks";
}

}  // namespace
}  // namespace mirage
